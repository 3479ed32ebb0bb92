"""Messages on their way from a car to its controller, and what a fault remembers of them."""

from collections import deque
from typing import Any, NamedTuple

ODOM, STEERING, PATH, NODE = "odom", "steering_state", "reference_path", "controller"
"""What a fault befalls; the last one is the controller itself, which has no messages."""
MAP = "map"
KEPT = 1000
"""Messages remembered: so many fill a queue."""


class Message(NamedTuple):
    """Something on its way to the controller."""

    topic: str
    arrival_ns: int
    """When it comes in [ns]."""
    stamp_ns: int
    """Which it carries [ns]; that in the value does not count."""
    value: Any
    """A VehicleState, points (n, 2) of a path [m], or a road-wheel angle [rad]."""
    frame_id: str = MAP
    length: float = 1.0
    """Of the quaternion of a pose."""


class Window(NamedTuple):
    """When a fault begins and ends; the end is outside [ns]."""

    start_ns: int
    end_ns: int

    def holds(self, now_ns: int) -> bool:
        """Whether the fault is there."""
        return self.start_ns <= now_ns < self.end_ns

    def share(self, now_ns: int) -> float:
        """How far it has gone, in [0, 1)."""
        return (now_ns - self.start_ns) / (self.end_ns - self.start_ns)


class Memory:
    """What one fault knows on its way: its time, its size, the messages so far, its chance."""

    def __init__(self, window: Window, amount: float, field: str, rng: Any) -> None:
        """Begin without messages.

        Args:
            window: Of the fault.
            amount: How much; each kind has its own meaning and unit.
            field: Of the state, for the kinds that befall one number.
            rng: numpy Generator; all chance comes from it.
        """
        self.window, self.amount, self.field, self.rng = window, amount, field, rng
        self.history: dict[str, deque[Message]] = {}
        """The newest messages before this one, by topic; shared by all faults of a line."""
        self.held: dict[str, Message] = {}
        self.latest_ns = 0
        """Arrival of the last message let through in order [ns]."""
        self.begun = False

    def last(self, message: Message) -> Message:
        """Give the last message of a topic before the fault; where there was none, this one."""
        before = self.history.get(message.topic)
        return self.held.setdefault(message.topic, before[-1] if before else message)
