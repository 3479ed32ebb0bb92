"""Order and log times of recorded messages.

In real time the log time of a message is the time of its reception. In simulated time it is the
last `/clock` published before the message, or the first `/clock` for earlier messages; a quantity
of the controller gets the stamp of the last command published before it. The same run therefore
gives the same log times.

A latched message may arrive long after it was published and used. Its log time is the time of its
publishing, so that a reader finds it before the first tick that used it.
"""

import struct
import time
from collections import deque
from collections.abc import Collection, Iterator
from typing import NamedTuple

from ampc_msgs_config.types import NANOSECONDS

CLOCKS_KEPT = 10_000
"""Number of times of `/clock` that are kept for messages that arrive late."""


class Arrival(NamedTuple):
    """A serialised message that has arrived."""

    publish_ns: int
    """Wall time of publishing [ns]."""
    receive_ns: int
    """Wall time of reception [ns]."""
    topic: str
    """Full name."""
    data: bytes
    """The message as CDR."""


class Arrivals:
    """Queue of messages, in which a message waits for those that were published before it."""

    def __init__(
        self,
        *,
        simulated: bool,
        clock: str,
        command: str,
        quantities: Collection[str],
        latched: Collection[str] = (),
    ) -> None:
        """Create an empty queue.

        Args:
            simulated: Whether log times are simulated times.
            clock: Full name of the clock topic.
            command: Full name of the command topic.
            quantities: Full names of the topics that describe the command published before them.
            latched: Full names of the topics whose last message a late subscriber receives.
        """
        self.simulated, self.clock, self.command = simulated, clock, command
        self.quantities, self.latched = quantities, latched
        self.waiting: list[Arrival] = []
        """Queue; the recorder appends to it."""
        self.start_ns = time.time_ns()
        self.clock_ns = self.command_ns = 0
        self.clocks: deque[tuple[int, int]] = deque(maxlen=CLOCKS_KEPT)
        self.undated = 0

    def take_undated(self) -> Iterator[Arrival]:
        """Return the messages that wait for the simulated clock to start, each message once."""
        if self.simulated and not self.clock_ns:
            yield from self.waiting[self.undated :]
            self.undated = len(self.waiting)

    def take_before(self, limit_ns: int) -> Iterator[tuple[Arrival, int]]:
        """Remove the messages received before a wall time [ns], in the order of publishing.

        Returns:
            Messages with their log times [ns]; none before the simulated clock has started.
        """
        early = (item for item in self.waiting if item.receive_ns < limit_ns)
        started = self.clock_ns or any(item.topic == self.clock for item in early)
        if started or not self.simulated:
            yield from self.take_all_before(limit_ns)

    def take_all_before(self, limit_ns: int) -> Iterator[tuple[Arrival, int]]:
        """Do the same, with log time 0 if the simulated clock has not started."""
        ready = sorted(item for item in self.waiting if item.receive_ns < limit_ns)
        self.waiting = [item for item in self.waiting if item.receive_ns >= limit_ns]
        clocks = (stamp(item.data) for item in ready if item.topic == self.clock)
        self.clock_ns = self.clock_ns or next(clocks, 0)
        for arrival in ready:
            yield arrival, self.log_time(arrival)

    def log_time(self, arrival: Arrival) -> int:
        """Return the log time of the next message, as stated at the top of this file [ns]."""
        if not self.simulated:
            latched = arrival.topic in self.latched
            published_ns = max(arrival.publish_ns, self.start_ns)
            return min(arrival.receive_ns, published_ns) if latched else arrival.receive_ns
        if arrival.topic == self.clock:
            self.clock_ns = stamp(arrival.data)
            self.clocks.append((arrival.publish_ns, self.clock_ns))
        if arrival.topic in self.latched and self.clocks:
            return self.clock_at(arrival.publish_ns)
        if arrival.topic == self.command:
            self.command_ns = stamp(arrival.data)
        return (self.command_ns if arrival.topic in self.quantities else 0) or self.clock_ns

    def clock_at(self, publish_ns: int) -> int:
        """Return the simulated time at a wall time of publishing [ns]."""
        before = (clock_ns for wall_ns, clock_ns in reversed(self.clocks) if wall_ns <= publish_ns)
        return next(before, self.clocks[0][1])


def stamp(data: bytes) -> int:
    """Return the time at the start of a serialised message [ns]."""
    order = "<" if data[1] & 1 else ">"
    seconds, nanoseconds = struct.unpack_from(order + "iI", data, 4)
    return int(seconds) * NANOSECONDS + int(nanoseconds)
