"""Bags: rosbag2 directories and files, read and written."""
