"""Messages from a car to its controller, and the state that a fault keeps about them."""

from collections import deque
from typing import Any, NamedTuple

ODOM, STEERING, PATH, NODE = "odom", "steering_state", "reference_path", "controller"
"""Targets of a fault; the last one is the controller itself, which has no messages."""
MAP = "map"
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

    def holds(self, now_ns: int) -> bool:
        """Check whether the fault is active at a time [ns]."""
        return self.start_ns <= now_ns < self.end_ns

    def share(self, now_ns: int) -> float:
        """Return the elapsed share of the interval, in [0, 1)."""
        return (now_ns - self.start_ns) / (self.end_ns - self.start_ns)


class Memory:
    """State of one fault: interval, amount, random generator, and earlier messages."""

    def __init__(self, window: Window, amount: float, field: str, rng: Any) -> None:
        """Start without messages.

        Args:
            window: Interval of the fault.
            amount: Size of the fault; meaning and unit depend on its kind.
            field: Field of the state, for kinds that change a single number.
            rng: numpy Generator, the only source of randomness.
        """
        self.window, self.amount, self.field, self.rng = window, amount, field, rng
        self.history: dict[str, deque[Message]] = {}
        """Newest earlier messages by topic; shared by all faults of an injector."""
        self.held: dict[str, Message] = {}
        """Last message before the fault, by topic."""
        self.latest_ns = 0
        """Arrival of the last message that was delivered in order [ns]."""
        self.begun = False

    def last(self, message: Message) -> Message:
        """Return the last message of this topic before the fault, or this one if it is first."""
        before = self.history.get(message.topic)
        return self.held.setdefault(message.topic, before[-1] if before else message)
