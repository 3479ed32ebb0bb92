"""ROS nodes of the scripts: fault injector, drive watch."""
