"""The cell as it lives: a robot sent along trajectories, in simulated time, as a ROS node."""
