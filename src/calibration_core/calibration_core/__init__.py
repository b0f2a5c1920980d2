"""Elastostatic compliance calibration of articulated industrial robots (CWA 17384), without ROS."""

__version__ = "0.1.0"
