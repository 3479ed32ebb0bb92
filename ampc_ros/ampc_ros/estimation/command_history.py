"""Commands sent, and the road-wheel angle that they have led to."""

import math
from collections import deque
from typing import NamedTuple

from ampc_msgs_config.types import NANOSECONDS
from ampc_ros.assumed_car import SteeringResponse

SETTLED = 5.0
"""Time after which a first-order lag has settled, in time constants."""


class SentCommand(NamedTuple):
    """A command and the time from which it holds."""

    time_ns: int
    steering: float


class CommandHistory:
    """Commands of the last seconds."""

    def __init__(self, steering: float, longest_ns: int) -> None:
        """Start with an angle in force [rad]; commands are kept for the longest time [ns]."""
        self.longest_ns = longest_ns
        self.reset(steering)

    def reset(self, steering: float) -> None:
        """Forget the commands sent; `steering` is the angle in force [rad]."""
        self.sent: deque[SentCommand] = deque()
        self.before = steering
        """Angle in force before the oldest command [rad]."""

    def store(self, steering: float, now_ns: int) -> None:
        """Store the command [rad] that is sent now [ns].

        After a clock that was set back the times of the earlier commands mean nothing: the newest
        of them counts as in force since long ago.
        """
        if self.sent and now_ns < self.sent[-1].time_ns:
            self.reset(self.sent[-1].steering)
        if self.sent and now_ns == self.sent[-1].time_ns:
            self.sent.pop()
        while self.sent and self.sent[0].time_ns < now_ns - self.longest_ns:
            self.before = self.sent.popleft().steering
        self.sent.append(SentCommand(now_ns, steering))

    def correct(self, steering: float) -> None:
        """Replace the newest command: another angle [rad] was sent."""
        if self.sent:
            self.sent[-1] = self.sent[-1]._replace(steering=steering)
        else:
            self.before = steering

    def between(self, begin_ns: int, end_ns: int, delay: float) -> list[tuple[float, float]]:
        """Return the commands that leave a delay [s] between two times [rad], and how long [s]."""
        commands, delay_ns = [], round(delay * NANOSECONDS)
        for time_ns, steering in reversed(self.sent):
            if begin_ns >= end_ns:
                break
            since_ns = max(time_ns + delay_ns, begin_ns)
            if since_ns < end_ns:
                commands.append((steering, (end_ns - since_ns) / NANOSECONDS))
                end_ns = since_ns
        if begin_ns < end_ns:
            commands.append((self.before, (end_ns - begin_ns) / NANOSECONDS))
        return commands[::-1]

    def wheel(self, time_ns: int, response: SteeringResponse) -> float:
        """Return the road-wheel angle at a time, after delay and lag [rad]."""
        begin_ns = time_ns - round(SETTLED * response.lag * NANOSECONDS)
        commands = self.between(begin_ns, time_ns, response.delay)
        angle = commands[0][0] if commands else self.before
        for command, elapsed in commands:
            angle = command + (angle - command) * math.exp(-elapsed / response.lag)
        return angle
