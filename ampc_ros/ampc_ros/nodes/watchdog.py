"""Watchdog of the controller: a steady clock detects that no command is published.

It runs in the control thread, so it detects a clock that stops or goes back, a timer that is not
called, and a tick that fails; not a callback that hangs, which gate and planner detect.
"""

import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.time_source import USE_SIM_TIME_NAME

from ampc_msgs_config.topics import CLOCK
from ampc_msgs_config.types import NANOSECONDS

WATCH_PERIOD = 0.05
"""Period of the watchdog [s]."""
MOST_COUNTED = 0.1
"""Longest part of the time between two checks that counts as silence [s]. A process that gets no
CPU publishes its command as soon as it continues."""
SILENCE_LIMIT = 0.2
"""Silence beyond two periods of the controller, or `state_late` if that is longer [s]."""
JUMP = 0.1
"""Difference between system clock and steady clock that counts as a jump [s]."""


def silence_limit(period: float, state_late: float) -> float:
    """Return the time without a command that is a fault [s]."""
    return max(SILENCE_LIMIT, state_late) + 2.0 * period


class Watchdog:
    """Measures the time without a command.

    In real time, wall time counts. With `use_sim_time` the clock may run slower than real time: a
    clock that advances is no fault. Silence is then the wall time for which the clock has not
    changed. If it advances, a command is missing only where simulated time since the last command
    exceeds the limit, too.
    """

    def __init__(self, node: Node, now_ns: Callable[[], int]) -> None:
        """Start to count.

        Args:
            node: Node with the parameter `use_sim_time`.
            now_ns: Return the time of the node's clock [ns].
        """
        self.is_simulated = bool(node.get_parameter(USE_SIM_TIME_NAME).value)
        self.now_ns = now_ns
        self.problem = ""
        """Why there is no command, in one sentence; empty: commands are published."""
        self.restart()

    def restart(self, wait: float = 0.0) -> None:
        """Count from now, or from some time later [s]."""
        self.silence, self.stopped = -wait, -wait
        self.checked_at = time.monotonic()
        self.clock_ns = self.commanded_ns = self.now_ns()
        self.jump = 0.0
        self.problem = ""

    def on_command(self) -> None:
        """Count from this command."""
        self.silence, self.commanded_ns, self.jump, self.problem = 0.0, self.now_ns(), 0.0, ""

    def check(self, limit: float) -> str:
        """Return why there is no command, in one sentence; empty: there is no fault.

        Args:
            limit: Silence that is a fault [s].
        """
        now, now_ns = time.monotonic(), self.now_ns()
        passed, advanced = now - self.checked_at, now_ns - self.clock_ns
        counted = min(passed, MOST_COUNTED)
        self.silence += counted
        self.stopped = 0.0 if advanced else self.stopped + counted
        self.commanded_ns = min(self.commanded_ns, now_ns)
        if abs(advanced / NANOSECONDS - passed) > JUMP:
            self.jump = advanced / NANOSECONDS - passed
        self.checked_at, self.clock_ns = now, now_ns
        self.problem = self._problem(limit, (now_ns - self.commanded_ns) / NANOSECONDS)
        return self.problem

    def _problem(self, limit: float, simulated: float) -> str:
        if self.is_simulated and self.stopped > limit:
            return f"no command for {max(self.silence, 0.0):.1f} s: {CLOCK} has stopped"
        if self.silence <= limit or (self.is_simulated and simulated <= limit):
            return ""
        missing = f"no command for {max(self.silence, 0.0):.1f} s"
        if self.jump and not self.is_simulated:
            return f"{missing}: the system clock jumped by {self.jump:+.1f} s"
        return missing
