"""Controller node and planner node."""

from ampc_msgs_config.signals import end_while_importing

end_while_importing(__file__)
