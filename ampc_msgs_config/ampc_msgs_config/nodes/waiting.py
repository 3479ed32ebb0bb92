"""Log of a node about inputs that do not arrive: which, and why."""

import time
from collections.abc import Callable, Sequence

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription

from ampc_msgs_config.nodes.qos import profile_text

WAIT_PATIENCE = 5.0
"""Wall time of waiting after which the reason is logged [s]."""
LOOK_PERIOD = 1.0
"""Wall time between two looks [s]."""
SILENCE_OF_STOPPED = 2.0
"""Silence after which an input has stopped [s]."""


class WaitLog:
    """Logs once what a node waits for, again when the reason changes, and the end of the wait."""

    def __init__(
        self, node: Node, reason: Callable[[], str], patience: float = WAIT_PATIENCE
    ) -> None:
        """Start to look once a second, on the clock that no other clock can stop.

        Args:
            node: Owner.
            reason: Returns what the node waits for and why, without changing numbers; empty: it
                does not wait.
            patience: Wall time of waiting after which the reason is logged [s].
        """
        self.node, self.reason, self.patience = node, reason, patience
        self.since, self.logged = 0.0, ""
        node.create_timer(LOOK_PERIOD, self.look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def look(self) -> None:
        """Log a new reason."""
        reason, now = self.reason(), time.monotonic()
        if not reason and getattr(self.node, "wait_for_recorder", False):
            reason = "a recorder that subscribes to this node"
        if not reason:
            if self.logged:
                self.node.get_logger().info("no longer waiting: all inputs arrive")
            self.since, self.logged = 0.0, ""
            return
        self.since = self.since or now
        if reason != self.logged and now - self.since >= self.patience:
            self.node.get_logger().warning(f"waiting for {reason}")
            self.logged = reason


def why_silent(
    node: Node, subscriptions: Sequence[Subscription], arrived_at: float | None = None
) -> str:
    """Return which input is missing and why: no publisher, QoS, silence, or rejected messages.

    Args:
        node: Owner of the subscriptions.
        subscriptions: All subscriptions of one topic.
        arrived_at: Arrival of the newest message, steady time [s]; None: there was none.
    """
    topic = subscriptions[0].topic_name
    publishers = node.get_publishers_info_by_topic(topic)
    if not publishers:
        return f"{topic}: it has no publisher"
    names = " and ".join(
        sorted({f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in publishers})
    )
    requested = [each.qos_profile for each in subscriptions]
    offered = [each.qos_profile for each in publishers]
    if all(is_incompatible(one, other) for one in offered for other in requested):
        texts = " or ".join(sorted(set(map(profile_text, requested))))
        return f"{topic}: {names} offers {profile_text(offered[0])}, but this node requests {texts}"
    if arrived_at is None:
        return f"{topic}: {names} publishes nothing"
    if time.monotonic() - arrived_at > SILENCE_OF_STOPPED:
        return f"{topic}: {names} has stopped publishing"
    return f"{topic}: the messages of {names} are rejected, for the reason in /diagnostics"


def is_incompatible(offered: QoSProfile, requested: QoSProfile) -> bool:
    """Return whether a subscription with a profile cannot receive from a publisher."""
    compatibility, _ = qos_check_compatible(offered, requested)
    return bool(compatibility == QoSCompatibility.ERROR)
