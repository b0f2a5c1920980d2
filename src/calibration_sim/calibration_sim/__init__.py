"""A simulated measurement cell with physics of its own.

MuJoCo holds the robot: joints that are springs about the commanded angle, links with weight, a wrench at the wrench
point.  Sensors with noise and faults look at it.  Nothing here knows the kinematics or statics of the identification,
so that recovering what was put in is a test and not a mirror.
"""
