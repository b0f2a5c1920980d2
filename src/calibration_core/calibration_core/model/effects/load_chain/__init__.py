"""Effects of the load chain: what lies between the load at the robot and the wrench as recorded."""
