"""Report of simulated time that does not start, or stops."""

import time

from rclpy.node import Node
from rclpy.time_source import USE_SIM_TIME_NAME

from ampc_msgs_config.topics import CLOCK
from ampc_msgs_config.types import NANOSECONDS

CLOCK_PATIENCE = 5.0
"""Wall time after which a clock that has not started is reported [s]."""
STOPPED_CLOCK = 2.0
"""Wall time after which a clock that has stopped is reported [s]."""


class SilentClock:
    """Reports once in the log, and in every diagnostics, that simulated time does not advance."""

    def __init__(self, node: Node, patience: float = CLOCK_PATIENCE) -> None:
        """Start to wait.

        Args:
            node: Node that follows the clock.
            patience: Wall time after which it is reported [s].
        """
        self.node, self.limit = node, time.monotonic() + patience
        self.is_logged = False
        self.newest_ns, self.changed_at = 0, time.monotonic()

    def problem(self) -> str:
        """Return one sentence; empty: time runs, or may still start."""
        if not self.node.get_parameter(USE_SIM_TIME_NAME).value:
            return ""
        now, now_ns = time.monotonic(), self.node.get_clock().now().nanoseconds
        if now_ns != self.newest_ns:
            self.newest_ns, self.changed_at, self.is_logged = now_ns, now, False
        if now < self.limit if not now_ns else now - self.changed_at < STOPPED_CLOCK:
            return ""
        clock = self.node.resolve_topic_name(CLOCK)
        publishers = self.node.count_publishers(clock)
        silent = "has no publisher" if not publishers else "sends nothing"
        silent = f"has stopped at {now_ns / NANOSECONDS:.1f} s" if now_ns else silent
        text = f"{USE_SIM_TIME_NAME} is set but {clock} {silent}: play a bag with --clock 1000"
        if not self.is_logged:
            self.node.get_logger().error(text)
        self.is_logged = True
        return text
