"""ROS nodes that serve every package: base class, recorder, markers."""

from ampc_msgs_config.signals import end_while_importing

end_while_importing(__file__)
