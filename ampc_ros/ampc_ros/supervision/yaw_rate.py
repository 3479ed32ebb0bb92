"""Consistency of the measured yaw rate with the measured heading."""

import math
from collections import deque
from typing import NamedTuple

from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.types import VehicleState
from ampc_ros.supervision.plausibility import CHECK_WINDOW, MAX_YAW_RATE, time_between

MISSING, STUCK, CONTRADICTS = "yaw_rate_missing", "yaw_rate_stuck", "yaw_rate_contradicts_heading"
YAW_RATE_CAUSES = (MISSING, STUCK, CONTRADICTS)
"""Why a yaw rate is replaced: it is always zero, or constant, or another one than the heading's."""
ALLOWED = 0.02
"""Difference between the rates that is not summed [rad/s]..."""
ALLOWED_SHARE = 0.05
"""... plus this share of the measured yaw rate."""
MOST = 0.1
"""Largest sum of the differences; white noise `x1` reaches about 0.07 in an hour [rad]..."""
MOST_DEVIATIONS = 10.0
"""... or this number of standard deviations of the heading, if that is more."""
NOISE_STATES = 100
"""Number of states over which the standard deviation of the heading is averaged."""
STEP_SHARE = 0.5
"""Share of it that counts in one state at most, unless the yaw rate itself has changed: the heading
of a localisation that is corrected jumps, and the yaw rate is right."""
CONSTANT_STATES = 3
"""Number of states with exactly the same yaw rate from which it is called constant."""
SLOPE_TIME = 0.3
"""Time over which the slope of the heading is fitted [s]."""
SHORTEST_SLOPE = 0.05
"""Shortest time with a slope; before, the last one is used [s]."""
SLOPE_STATES = 1000
"""Largest number of states in that time."""
LARGEST_CHANGE = 0.3
"""Largest change of the measured yaw rate that is added to the slope of the heading [rad/s]."""
AGREEMENT_TIME = 5.0
"""Time of agreement after which the measured yaw rate is used again [s]."""
IMPOSSIBLE = 40.0
"""Lateral acceleration of no car: its yaw rate is replaced at once unless the heading turns at half
of it at least [m/s^2]."""
SLOWEST = 0.5
"""Speed below which heading and yaw rate are not compared [m/s]."""


class Turn(NamedTuple):
    """Heading and yaw rate of a state."""

    time: float
    """Since the beginning of the window [s]."""
    heading: float
    """Continuous, not wrapped [rad]."""
    yaw_rate: float
    """Measured [rad/s]."""


class YawRateCheck:
    """Replaces a yaw rate that contradicts the heading by the slope of the heading.

    What the heading turns beyond the integrated yaw rate is summed to either side, less what is
    allowed, and never below zero (CUSUM, Page 1954). A sum beyond MOST is a contradiction. The
    states of a consistent car are returned unchanged.
    """

    def __init__(self) -> None:
        """Start without states."""
        self.replaced = dict.fromkeys(YAW_RATE_CAUSES, 0)
        """Number of replaced yaw rates, by cause."""
        self.reset()

    def reset(self) -> None:
        """Forget all states; the counts continue."""
        self.last: VehicleState | None = None
        self.turns: deque[Turn] = deque(maxlen=SLOPE_STATES)
        self.is_replaced = False
        self.expected = 0.0
        """Yaw rate of the heading, while it replaces the measured one [rad/s]."""
        self.above = self.below = 0.0
        self.constant = 1
        """Number of states with the same yaw rate, up to the newest."""
        self.previous = self.variance = 0.0
        """Difference of the last state, and mean square of the second differences [rad, rad^2]."""
        self.states = 0
        """Number of compared states."""
        self._begin_comparison()

    @property
    def measured(self) -> float:
        """Yaw rate of the newest state [rad/s]."""
        return self.last.yaw_rate if self.last else 0.0

    @property
    def cause(self) -> str:
        """Why yaw rates are replaced, one of YAW_RATE_CAUSES; empty: they are not."""
        if not self.is_replaced:
            return ""
        if self.constant < CONSTANT_STATES:
            return CONTRADICTS
        return STUCK if self.measured else MISSING

    def correct(self, state: VehicleState) -> VehicleState:
        """Return the state, with the yaw rate of its heading if its own contradicts that."""
        last, self.last = self.last, state
        dt = time_between(last, state) if last else math.inf
        if last is None or dt > CHECK_WINDOW:
            self.above = self.below = 0.0
            self.turns.clear()
            self.turns.append(Turn(0.0, state.yaw, state.yaw_rate))
        else:
            self._compare(last, state, dt)
        if not self.is_replaced:
            return state
        self.replaced[self.cause] += 1
        if self.turns[-1].time - self.turns[0].time >= SHORTEST_SLOPE:
            self.expected = min(max(self._from_heading(), -MAX_YAW_RATE), MAX_YAW_RATE)
        return state._replace(yaw_rate=self.expected)

    def _compare(self, last: VehicleState, state: VehicleState, dt: float) -> None:
        """Add the turning of the heading since the last state, and compare it."""
        turned = wrap_angle(state.yaw - last.yaw)
        turns, before = self.turns, self.turns[-1]
        turns.append(Turn(before.time + dt, before.heading + turned, state.yaw_rate))
        while len(turns) > CONSTANT_STATES and turns[1].time < turns[-1].time - SLOPE_TIME:
            turns.popleft()
        changed = abs(state.yaw_rate - last.yaw_rate)
        self.constant = 1 if changed else self.constant + 1
        if state.v_x < SLOWEST:
            return
        mean = (last.yaw_rate + state.yaw_rate) / 2
        difference = turned - mean * dt
        most = self._most(difference)
        step = max(STEP_SHARE * most, changed * dt)
        counted = min(max(difference, -step), step)
        allowed = (ALLOWED + ALLOWED_SHARE * abs(mean)) * dt
        self.above = max(self.above + counted - allowed, 0.0)
        self.below = max(self.below - counted - allowed, 0.0)
        if max(self.above, self.below) > most or self._is_impossible(state):
            self.is_replaced = True
            self.above = self.below = 0.0
            self._begin_comparison()
        elif self.is_replaced:
            self._look_for_agreement(difference, most, dt)
            self.has_changed |= changed > 0

    def _most(self, difference: float) -> float:
        """Return the largest sum of differences with the noise of the heading [rad].

        The second difference of white noise has 6 times its variance.
        """
        self.states += 1
        share = max(1.0 / self.states, 1.0 / NOISE_STATES)
        change, self.previous = difference - self.previous, difference
        self.variance += share * (change**2 - self.variance)
        return max(MOST, MOST_DEVIATIONS * math.sqrt(self.variance / 6))

    def _is_impossible(self, state: VehicleState) -> bool:
        """Return whether no car turns at this yaw rate, and the heading does not either."""
        r = state.yaw_rate
        return state.v_x * abs(r) > IMPOSSIBLE and abs(r - self._slope()) > abs(r) / 2

    def _begin_comparison(self) -> None:
        self.compared, self.difference, self.has_changed = 0.0, 0.0, False

    def _look_for_agreement(self, difference: float, most: float, dt: float) -> None:
        """Use the measured yaw rate again after AGREEMENT_TIME, unless it is constant."""
        self.compared += dt
        self.difference += difference
        if self.compared >= AGREEMENT_TIME:
            self.is_replaced = not self.has_changed or abs(self.difference) > most
            self._begin_comparison()

    def _from_heading(self) -> float:
        """Return the slope of the heading, with the change of a yaw rate that is not constant."""
        if self.constant >= CONSTANT_STATES - 1:
            return self._slope()
        change = self.measured - sum(turn.yaw_rate for turn in self.turns) / len(self.turns)
        return self._slope() + min(max(change, -LARGEST_CHANGE), LARGEST_CHANGE)

    def _slope(self) -> float:
        """Return the slope of the heading by least squares [rad/s]."""
        n = len(self.turns)
        time = sum(turn.time for turn in self.turns) / n
        heading = sum(turn.heading for turn in self.turns) / n
        area = sum((turn.time - time) ** 2 for turn in self.turns)
        product = sum((turn.time - time) * (turn.heading - heading) for turn in self.turns)
        return product / area if area else 0.0
