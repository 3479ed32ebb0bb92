"""Messages from a car to its controller, and the state that a fault keeps about them."""

import dataclasses
from collections import deque
from typing import Any, NamedTuple

from ampc_msgs_config.topics import MAP

ODOM_INPUT, STEERING_INPUT, PATH, NODE = "odom", "steering_state", "reference_path", "controller"
"""Targets of a fault; the last one is the controller itself, which has no messages."""
KEPT = 1000
"""Number of messages in the history of a topic."""


class Message(NamedTuple):
    """A message to the controller."""

    topic: str
    arrival_ns: int
    """Time of arrival [ns]."""
    stamp_ns: int
    """Stamp of the header [ns]; the stamp in the value is ignored."""
    value: Any
    """VehicleState, points (n, 2) of a path [m], or road-wheel angle [rad]."""
    frame_id: str = MAP
    length: float = 1.0
    """Norm of the quaternion of a pose."""


class Window(NamedTuple):
    """Half-open time interval of a fault [ns]."""

    start_ns: int
    end_ns: int


@dataclasses.dataclass
class FaultState:
    """State of one fault: interval, amount, random generator, and earlier messages."""

    kind: str
    window: Window
    amount: float
    """Size of the fault; meaning and unit depend on its kind."""
    field: str
    """Field of the vehicle state, for kinds that change a single number."""
    rng: Any
    """numpy Generator, the only source of randomness."""
    history: dict[str, deque[Message]]
    """Newest earlier messages by topic; shared by all faults of an injector."""
    held: dict[str, Message] = dataclasses.field(default_factory=dict)
    """Last message before the fault, by topic."""
    latest_ns: int = 0
    """Arrival of the last message that was delivered in order [ns]."""
    begun: bool = False

    def last(self, message: Message) -> Message:
        """Return the last message of this topic before the fault, or this one if it is first."""
        before = self.history.get(message.topic)
        return self.held.setdefault(message.topic, before[-1] if before else message)

    def elapsed(self, message: Message) -> float:
        """Return the elapsed share of the interval when a message arrives, in [0, 1)."""
        start_ns, end_ns = self.window
        return (message.arrival_ns - start_ns) / (end_ns - start_ns)
