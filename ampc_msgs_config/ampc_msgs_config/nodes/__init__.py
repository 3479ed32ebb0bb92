"""ROS nodes that serve every package: base class, recorder, markers."""
