"""How to move: bounded speed, timed trajectories, and the rules of permission and stop."""
