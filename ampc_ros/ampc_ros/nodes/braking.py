"""Requests to stop, and the target speed under them: gentle braking, and acceleration after."""

import math
from collections import deque

from ampc_msgs_config.types import NANOSECONDS, VehicleState

COMFORTABLE = 2.0
"""Comfortable deceleration, and acceleration after the request is taken back [m/s^2]."""

OLD = 1.0
"""Age from which a request was published before this node could hear it [s]."""
OTHERS = 16
"""Number of publishers without a request whose last number is remembered."""


class Braking:
    """Limits a planned speed: falling while a stop is requested, rising again afterwards."""

    def __init__(self) -> None:
        """Start without a limit."""
        self.most = math.inf
        """Largest speed now [m/s]."""
        self.at_ns = 0

    def limited(self, planned: float, state: VehicleState, *, stop: bool) -> float:
        """Return the target speed [m/s].

        Args:
            planned: Speed of the drive [m/s].
            state: State of the car; braking begins at its speed.
            stop: Whether a stop is requested.
        """
        step = COMFORTABLE * max(state.stamp_ns - self.at_ns, 0) / NANOSECONDS
        self.at_ns = state.stamp_ns
        if stop and self.most == math.inf:
            self.most = max(state.v_x, 0.0)
        elif stop:
            self.most = max(self.most - step, 0.0)
        elif self.most < planned:
            self.most += step
        else:
            self.most = math.inf
        return min(planned, self.most)


class StopRequests:
    """Requests of all publishers, of which one takes back only its own.

    rclpy does not tell publishers apart, but each numbers its messages. A `False` takes back the
    `True` with the number before. It takes back nothing where that is ambiguous, or where it is the
    first message of its publisher, or an old one that a latched topic delivers late. So a node that
    was started again does not take back the stop that it requested in its earlier life.
    """

    def __init__(self) -> None:
        """Start without a request."""
        self.requests: deque[int] = deque()
        """Number of the newest message of each publisher that requests a stop."""
        self._others: deque[int] = deque(maxlen=OTHERS)

    @property
    def in_force(self) -> bool:
        """Whether a publisher requests a stop."""
        return bool(self.requests)

    def receive(self, requested: bool, number: int, age: float) -> None:
        """Use a message.

        Args:
            requested: Its content.
            number: Its number among the messages of its publisher, from 1 on.
            age: Time from its publication to its arrival [s].
        """
        for known in (self._others, self.requests):
            if age <= OLD and number - 1 in known:
                known.remove(number - 1)
                break
        (self.requests if requested else self._others).append(number)
