"""Replay of a recorded run without ROS."""
