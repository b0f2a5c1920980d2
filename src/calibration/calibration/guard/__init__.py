"""The guard: whether the robot may be moved."""
