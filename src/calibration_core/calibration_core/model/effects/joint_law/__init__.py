"""Effects of a joint: how torque and angle belong together beyond a constant stiffness."""
