"""What we believe: the robot, its parameters, and what follows from them."""
