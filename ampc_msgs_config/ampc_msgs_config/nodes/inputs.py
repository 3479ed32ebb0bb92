"""Subscriptions of a node that receive from publishers of any QoS, or name what does not match."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from ampc_msgs_config.nodes.message_loop import PolledGroup, take_message
from ampc_msgs_config.nodes.qos import profile_text
from ampc_msgs_config.nodes.waiting import SILENCE_OF_STOPPED, is_incompatible, why_silent

REMEMBERED = 16
"""Messages that are remembered where several subscriptions receive the same topic."""


class Input:
    """One topic, received by as many subscriptions as the QoS of its publishers requires.

    The first profile is subscribed at once. Each following one is subscribed when a publisher is
    discovered that does not match the one before, so that in the ordinary case every message is
    transported once.
    """

    def __init__(
        self,
        node: Node,
        message_type: type,
        topic: str,
        callback: Callable[[Any], None],
        profiles: tuple[QoSProfile, ...],
        options: dict[str, Any],
        events: Mapping[str, Callable[[Any], None]],
    ) -> None:
        """Subscribe with the first profile.

        Args:
            node: Owner.
            message_type: Type of the message.
            topic: Relative name.
            callback: Receives each message once.
            profiles: Profiles in the order of preference.
            options: Further arguments of `create_subscription`.
            events: Callbacks of QoS events of the first profile, by name.
        """
        self.node, self.message_type, self.topic = node, message_type, topic
        self.callback, self.profiles, self.options = callback, profiles, options
        self.events = events
        self.subscriptions: list[Subscription] = []
        self.has_mismatch = False
        self.info: dict[str, Any] = {}
        """Times and sequence number of the newest message."""
        self.arrived_at: float | None = None
        """Its arrival, steady time [s]."""
        self._seen: deque[tuple[Any, Any, int]] = deque(maxlen=REMEMBERED)
        self._logged: set[str] = set()
        self._subscribe()

    def _subscribe(self) -> None:
        on_event = partial(self.on_incompatible, len(self.subscriptions))
        further: Any = {} if self.subscriptions else self.events
        self.subscriptions.append(
            self.node.create_subscription(
                self.message_type,
                self.topic,
                self.on_message,  # type: ignore[arg-type]  # rclpy looks at the signature
                self.profiles[len(self.subscriptions)],
                event_callbacks=SubscriptionEventCallbacks(incompatible_qos=on_event, **further),
                **self.options,
            )
        )

    def on_message(self, message: Any, info: dict[str, Any]) -> None:
        """Pass a message on unless another subscription has received it before."""
        if len(self.profiles) > 1:
            size = len(message) if isinstance(message, bytes) else 0
            key = (info["source_timestamp"], info["publication_sequence_number"], size)
            if key in self._seen:
                return
            self._seen.append(key)
        self.info, self.arrived_at = info, time.monotonic()
        self.callback(message)

    def read(self) -> None:
        """Pass on the messages that have arrived."""
        for each in self.subscriptions:
            while taken := take_message(each):
                self.on_message(*taken)

    def on_incompatible(self, index: int, _: Any) -> None:
        """Subscribe with the next profile, or report that there is none."""
        if index + 1 == len(self.profiles):
            self.has_mismatch = True
            self.mismatches()
        elif index + 1 == len(self.subscriptions):
            self._subscribe()

    def mismatches(self) -> list[str]:
        """Return a sentence for each publisher that matches no subscription; log new ones."""
        if not self.has_mismatch:
            return []
        requested = [self.profiles[i] for i in range(len(self.subscriptions))]
        sentences = []
        for each in self.node.get_publishers_info_by_topic(self.subscriptions[0].topic_name):
            if all(is_incompatible(each.qos_profile, profile) for profile in requested):
                name = f"{each.node_namespace.rstrip('/')}/{each.node_name}"
                sentences.append(
                    f"{self.topic}: the publisher of {name} offers "
                    f"{profile_text(each.qos_profile)}, but this node requests "
                    f"{' or '.join(map(profile_text, requested))}: none of its messages arrive"
                )
        for sentence in set(sentences) - self._logged:
            self._logged.add(sentence)
            self.node.get_logger().error(sentence)
        return sentences

    def problem(self, *, is_used: bool, is_periodic: bool = True) -> str:
        """Return why this input is missing; empty: it is not.

        Args:
            is_used: Whether the node has accepted a message.
            is_periodic: Whether a message that stays away is missing, too.
        """
        silence = 0.0 if self.arrived_at is None else time.monotonic() - self.arrived_at
        if is_used and not (is_periodic and silence > SILENCE_OF_STOPPED):
            return ""
        return why_silent(self.node, self.subscriptions, self.arrived_at)

    def destroy(self) -> None:
        """Destroy the subscriptions."""
        for each in self.subscriptions:
            self.node.destroy_subscription(each)


class Inputs:
    """All inputs of a node."""

    def __init__(self, node: Node, group: CallbackGroup | None = None) -> None:
        """Start without an input.

        Args:
            node: Owner.
            group: Callback group of the subscriptions; None: the default one of the node.
        """
        self.node, self.group = node, group
        self.topics: dict[str, Input] = {}

    def add(
        self,
        message_type: type,
        topic: str,
        callback: Callable[[Any], None],
        *profiles: QoSProfile,
        raw: bool = False,
        polled: bool = False,
        events: Mapping[str, Callable[[Any], None]] = MappingProxyType({}),
    ) -> None:
        """Subscribe to a topic.

        Args:
            message_type: Type of the message.
            topic: Relative name.
            callback: Receives each message once.
            profiles: QoS in the order of preference, see `Input`.
            raw: The callback receives the serialised message.
            polled: Messages end no wait; the node reads them when it needs them, see `read`.
            events: Callbacks of QoS events of the first profile, by name.
        """
        options = {"callback_group": PolledGroup() if polled else self.group, "raw": raw}
        self.topics[topic] = Input(
            self.node, message_type, topic, callback, profiles, options, events
        )

    def mismatches(self) -> list[str]:
        """Return a sentence for each publisher whose messages cannot arrive."""
        return [sentence for each in self.topics.values() for sentence in each.mismatches()]

    def destroy(self) -> None:
        """Destroy all subscriptions."""
        while self.topics:
            _, each = self.topics.popitem()
            each.destroy()
