"""Monitors of a drive: deviation from the path, end of the path, and the request to stop.

They use position and speed only, and are independent of controller and solver.
"""

import math
from collections import deque
from typing import NamedTuple

from ampc_msgs_config.types import NANOSECONDS
from ampc_ros.mpc.tick_result import HOLD_BELOW
from ampc_ros.supervision.progress import Location

APPROACH_TIME, APPROACH_TIME_PER_METRE = 4.0, 2.0
"""Time in which a car may approach its path, and its part for each metre of distance [s, s/m]."""
GROWTH_TIME = 2.0
"""Time over which an error that grows means that the car does not return [s]."""
MIN_GROWTH = 0.2
"""Smallest growth in that time [m]."""
LONGEST_STEP = 0.5
"""Longest time that counts from one observation to the next [s]."""
REACTION = 0.1
"""Time from a stop request to the begin of braking [s]."""
WARNING_TIME = 1.0
"""Time of the warning before a stop request at the end of the path [s]."""
CRAWL = 1.5
"""Speed below which a car that has not passed the end of its path needs no request [m/s]."""
SPEED_CHANGE_SHARE = 0.3
"""Share of a new difference of speeds that enters the estimated acceleration."""
RESUME_TIME = 2.0
"""Time of complete inputs after which a stop request due to missing ones may be withdrawn [s]."""


class Motion(NamedTuple):
    """Time and speed of a state."""

    stamp_ns: int
    v_x: float
    """Speed [m/s]."""


class Stopwatch:
    """Time from one state to the next."""

    def __init__(self) -> None:
        """Start before the first state."""
        self.last_ns: int | None = None

    def elapsed(self, motion: Motion) -> float:
        """Return the time since the last call, in [0, LONGEST_STEP] [s]."""
        last_ns, self.last_ns = self.last_ns, motion.stamp_ns
        if last_ns is None:
            return 0.0
        return min(max((motion.stamp_ns - last_ns) / NANOSECONDS, 0.0), LONGEST_STEP)


class DeviationMonitor:
    """Detects a car that is off its path, or that moves away from it.

    A car may start beside its path, or be given a path beside it, and approach it. The bound holds
    once the error was below half of it, or after the time that a return to the path needs. An error
    beyond the bound that grows for GROWTH_TIME is detected also during the approach.
    """

    def __init__(self) -> None:
        """Start with an approach."""
        self.clock = Stopwatch()
        self.approach()

    def approach(self) -> None:
        """Allow an approach from the present position."""
        self.is_armed = False
        self.left = math.inf
        self.time = 0.0
        self.history: deque[tuple[float, float]] = deque()

    def observe(self, motion: Motion, location: Location, bound: float) -> bool:
        """Return whether the car is off its path.

        Args:
            motion: Time and speed.
            location: Position relative to the path.
            bound: Largest cross-track error [m].
        """
        error, elapsed = abs(location.cross_track_error), self.clock.elapsed(motion)
        if motion.v_x < HOLD_BELOW:
            elapsed = 0.0
        if self.is_armed and abs(location.step) > bound / 2:
            self.approach()
        if abs(location.step) > MIN_GROWTH:
            self.history.clear()
        if not self.is_armed:
            allowed = APPROACH_TIME + APPROACH_TIME_PER_METRE * error
            self.left = min(self.left, allowed) - elapsed
            self.is_armed = error < bound / 2 or self.left <= 0.0
        return error > bound and (self.is_armed or self._grows(error, elapsed))

    def _grows(self, error: float, elapsed: float) -> bool:
        """Return whether the error has grown during the last GROWTH_TIME."""
        self.time += elapsed
        while self.history and self.history[-1][1] >= error:
            self.history.pop()  # the error falls: growth is counted from here
        self.history.append((self.time, error))
        while len(self.history) > 1 and self.history[1][0] <= self.time - GROWTH_TIME:
            self.history.popleft()
        since, least = self.history[0]
        return self.time - since >= GROWTH_TIME and error - least >= MIN_GROWTH


class PathEndMonitor:
    """Requests a stop in time before the end of an open path."""

    def __init__(self) -> None:
        """Start far from any end."""
        self.clock = Stopwatch()
        self.remaining = math.inf
        """Distance to the end of the path; infinite if it is closed [m]."""
        self.is_near = False
        """Whether a request is due within WARNING_TIME at the present acceleration."""
        self.is_due = False
        """Whether the car has to brake now."""
        self.acceleration, self.v_x = 0.0, 0.0

    def observe(self, motion: Motion, remaining: float, deceleration: float) -> None:
        """Compare the distance to the end with the braking distance.

        Args:
            motion: Time and speed.
            remaining: Distance to the end of the path [m].
            deceleration: Of a car that brakes; infinite: no request is made [m/s^2].
        """
        v, elapsed = motion.v_x, self.clock.elapsed(motion)
        if elapsed > 0.0:
            change = (v - self.v_x) / elapsed
            self.acceleration += SPEED_CHANGE_SHARE * (change - self.acceleration)
        self.remaining, self.v_x = remaining, v
        if deceleration == math.inf:
            return
        later = max(v + min(self.acceleration, 0.0) * WARNING_TIME, 0.0)
        left = remaining - (v + later) / 2 * WARNING_TIME
        self.is_near = later > CRAWL and left < stopping_distance(later, deceleration)
        moves = v > CRAWL or (remaining < 0.0 and v > HOLD_BELOW)
        self.is_due = moves and remaining < stopping_distance(v, deceleration)


def stopping_distance(v: float, deceleration: float) -> float:
    """Return the distance of a stop from a speed, with the time of reaction [m]."""
    return v**2 / (2 * deceleration) + REACTION * v


class StopRequest:
    """Causes of the request to stop."""

    def __init__(self) -> None:
        """Start without a request."""
        self.no_path = False
        """Whether the newest path is empty; withdrawn with the next valid one."""
        self.complete_ns: int | None = None
        self.clear()

    @property
    def requested(self) -> bool:
        """Whether a stop is requested."""
        return self.no_path or self.inputs or self.drive

    def clear(self) -> None:
        """Take back the latched requests."""
        self.inputs = False
        """Whether inputs were missing."""
        self.drive = False
        """Whether the drive itself had to stop."""

    def resumes(self, now_ns: int, *, complete: bool) -> bool:
        """Return whether inputs were missing, and have been complete for RESUME_TIME since.

        Args:
            now_ns: Time of the node's clock [ns].
            complete: Whether all inputs are fresh now.
        """
        if not complete:
            self.complete_ns = None
            return False
        if self.complete_ns is None or now_ns < self.complete_ns:
            self.complete_ns = now_ns
        lasted = now_ns - self.complete_ns >= RESUME_TIME * NANOSECONDS
        return self.inputs and not self.drive and lasted
