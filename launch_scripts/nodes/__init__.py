"""ROS nodes of the scripts: fault injector, drive watch."""

from ampc_msgs_config.signals import end_while_importing

end_while_importing(__file__)
