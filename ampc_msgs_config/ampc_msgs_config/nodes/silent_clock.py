"""Report of simulated time that does not start."""

import time

from rclpy.node import Node
from rclpy.time_source import USE_SIM_TIME_NAME

from ampc_msgs_config.topics import CLOCK

CLOCK_PATIENCE = 5.0
"""Wall time after which a clock that has not started is reported [s]."""


class SilentClock:
    """Reports once in the log, and in every diagnostics, that simulated time has not started."""

    def __init__(self, node: Node, patience: float = CLOCK_PATIENCE) -> None:
        """Start to wait.

        Args:
            node: Node that follows the clock.
            patience: Wall time after which it is reported [s].
        """
        self.node, self.limit = node, time.monotonic() + patience
        self.is_logged = False

    def problem(self) -> str:
        """Return one sentence; empty: time runs, or may still start."""
        if not self.node.get_parameter(USE_SIM_TIME_NAME).value:
            return ""
        if self.node.get_clock().now().nanoseconds or time.monotonic() < self.limit:
            return ""
        silent = "sends nothing" if self.node.count_publishers(CLOCK) else "has no publisher"
        text = f"{USE_SIM_TIME_NAME} is set but {CLOCK} {silent}: play a bag with --clock 1000"
        if not self.is_logged:
            self.node.get_logger().error(text)
        self.is_logged = True
        return text
