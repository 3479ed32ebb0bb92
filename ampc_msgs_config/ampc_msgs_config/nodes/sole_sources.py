"""Detection of a second publisher on a topic that must have only one.

rclpy does not tell which publisher a message comes from, and a killed process stays listed as a
publisher for about 20 s. Therefore two facts count:

* Nodes of different names are listed as publishers of the topic.
* The sequence numbers of the messages, which rise for every publisher, fall again and again: the
  messages of two publishers alternate, whatever their names. A restarted node causes a single fall.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time_source import USE_SIM_TIME_NAME

from ampc_msgs_config.nodes.message_loop import PolledGroup
from ampc_msgs_config.topics import CLOCK
from ampc_msgs_config.types import NANOSECONDS

LIST_PERIOD = 0.5
"""Wall time between two looks at the list of publishers [s]."""
FALLS, FALL_WINDOW = 2, 1.0
"""Number of falls of the sequence number within this time from which two publishers are alive."""
EACH = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Every message counts: of those that arrive together, the newest would hide the other ones."""
ANONYMOUS = "_"
"""Begin of the names of publishers whose node is not known (yet)."""
CONFLICT_EXIT = 1
"""Exit code in lock-step."""


class SoleSources:
    """Watches topics of a node; the first second publisher remains the `conflict` until `clear`."""

    def __init__(
        self,
        node: Node,
        heard: Mapping[str, type],
        listed: Sequence[str],
        on_conflict: Callable[[], None],
        *,
        lock_step: bool = False,
    ) -> None:
        """Start to watch.

        Args:
            node: Owner.
            heard: Topics, with their types, whose sequence numbers are watched.
            listed: Further topics, of which only the list of publishers is watched.
            on_conflict: Is called once per conflict.
            lock_step: A conflict ends the node.
        """
        self.node, self.lock_step, self.on_conflict = node, lock_step, on_conflict
        self.conflict = ""
        """One sentence that names topic and nodes; empty: there is none."""
        clock = [CLOCK] if node.get_parameter(USE_SIM_TIME_NAME).value else []
        self.names = {each: node.resolve_topic_name(each) for each in (*heard, *listed, *clock)}
        self.last: dict[str, int] = {}
        self.arrivals: dict[str, tuple[float, int]] = {}
        self.falls: dict[str, deque[float]] = {each: deque(maxlen=FALLS) for each in heard}
        self.subscriptions = []
        for topic, kind in heard.items():
            on_message: Callable[..., None] = partial(self.on_message, topic)
            self.subscriptions.append(
                node.create_subscription(
                    kind, topic, on_message, EACH, raw=True, callback_group=PolledGroup()
                )
            )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.timer = node.create_timer(LIST_PERIOD, self.look_at_lists, clock=steady)

    def destroy(self) -> None:
        """Stop to watch."""
        self.node.destroy_timer(self.timer)
        for each in self.subscriptions:
            self.node.destroy_subscription(each)

    def on_message(self, topic: str, _: bytes, info: dict[str, Any]) -> None:
        """Compare the sequence number of a message with that of the one before."""
        number, now = info["publication_sequence_number"], time.monotonic()
        self.arrivals[topic] = now, self._now_ns()
        if number <= self.last.get(topic, 0):
            falls = self.falls[topic]
            falls.append(now)
            if len(falls) == FALLS and now - falls[0] <= FALL_WINDOW:
                self._report(topic, self._publishers(topic))
        self.last[topic] = number

    def look_at_lists(self) -> None:
        """Compare the names of the publishers of each topic."""
        for topic in self.names:
            names = self._publishers(topic)
            if len(set(names)) > 1:
                self._report(topic, names)

    def silence(self, topic: str) -> float:
        """Return the time since the last message; 0 before the first one [s].

        Where time is simulated, the smaller of wall time and simulated time counts: a simulation
        may be slower than real time.
        """
        if topic not in self.arrivals:
            return 0.0
        steady, node_ns = self.arrivals[topic]
        silent = time.monotonic() - steady
        if self.node.get_parameter(USE_SIM_TIME_NAME).value:
            silent = min(silent, (self._now_ns() - node_ns) / NANOSECONDS)
        return silent

    def clear(self) -> None:
        """Forget the conflict; one that lasts is detected again."""
        self.conflict = ""
        for falls in self.falls.values():
            falls.clear()

    def _now_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def _publishers(self, topic: str) -> list[str]:
        """Return the full names of the nodes that are listed as publishers."""
        listed = self.node.get_publishers_info_by_topic(self.names[topic])
        known = [each for each in listed if not each.node_name.startswith(ANONYMOUS)]
        return sorted(f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in known)

    def _report(self, topic: str, names: list[str]) -> None:
        if self.conflict:
            return
        who = " and ".join(names) if len(names) > 1 else "two nodes"
        self.conflict = f"{topic} is published by {who}, must have one publisher"
        if self.lock_step:
            self.node.get_logger().fatal(self.conflict)
            raise SystemExit(CONFLICT_EXIT)
        self.node.get_logger().error(f"{self.conflict}: a stop is requested")
        self.on_conflict()
