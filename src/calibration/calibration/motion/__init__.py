"""Motion back ends: how a trajectory gets to the robot, one file per way."""
