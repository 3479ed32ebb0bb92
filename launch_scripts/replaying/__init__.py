"""Repeating a recorded drive without ROS."""
