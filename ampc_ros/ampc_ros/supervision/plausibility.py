"""Plausibility of a measured state, alone and against the earlier states."""

import math
from collections import deque
from typing import NamedTuple

from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.types import NANOSECONDS, VehicleState

FUTURE = 0.1
"""Largest lead of a stamp before the node's clock [s]."""
REORDERED = 0.5
"""A stamp that goes back by more is not an overtaken message but a clock that jumped [s]."""
POSITION_JUMP = 0.5
"""Largest distance between a position and the reach of the speed [m]."""
HEADING_JUMP = 0.2
"""Largest difference between a heading and the reach of the yaw rate [rad]."""
CHECK_WINDOW = 0.5
"""Time over which the twist is integrated and compared with the pose [s]; rejected states that are
consistent with each other for as long replace the track."""
DRIFT = 0.5
"""Largest difference between pose and integrated twist over the window [m]..."""
DRIFT_SHARE = 0.05
"""... plus this share of the distance driven in the window."""
VELOCITY_STEP = 1.0
"""Change of the velocity between two states from which its moment matters: a simulated car starts
with the speed of its drive [m/s]."""
REPEATED = -1.0
MOST_STATES = 1000
"""Largest number of states in a window."""
MAX_POSITION = 1.0e8
"""Largest coordinate in `map`, beyond any projection of the Earth [m]."""
MAX_HEADING = 1.0e6
"""Largest heading, for callers that do not wrap it; beyond, turns are lost in rounding [rad]."""
MAX_SPEED = 100.0
"""Largest component of the velocity [m/s]."""
MAX_YAW_RATE = 10.0
"""Largest yaw rate [rad/s]."""

CAUSES = (
    "not_finite",
    "implausible",
    "zero_stamp",
    "in_the_future",
    "duplicate",
    "out_of_order",
    "clock_jumped_back",
    "position_jump",
    "heading_jump",
    "twist_contradicts_pose",
)
"""Causes of a rejection; keys of `StateFilter.rejected`."""
RANGES = {
    "x": (MAX_POSITION, "m"),
    "y": (MAX_POSITION, "m"),
    "yaw": (MAX_HEADING, "rad"),
    "v_x": (MAX_SPEED, "m/s"),
    "v_y": (MAX_SPEED, "m/s"),
    "yaw_rate": (MAX_YAW_RATE, "rad/s"),
}


class Rejection(NamedTuple):
    """Why a state is not used."""

    cause: str
    """One of CAUSES."""
    reason: str
    """A sentence with name, value and bound."""


class WindowSample(NamedTuple):
    """A state, and the twist integrated from the first state of the window to it."""

    state: VehicleState
    x: float = 0.0
    """[m]."""
    y: float = 0.0
    """[m]."""
    distance: float = 0.0
    """[m]."""
    unknown: float = 0.0
    """Largest difference by the newest step of the velocity, whose moment between two states is
    unknown [m]; REPEATED: after another step in the same window, which is no start of a car."""


class StateHistory:
    """States that are consistent with each other, as far back as the window reaches."""

    def __init__(self, state: VehicleState) -> None:
        """Begin with one state."""
        self.first_ns, self.count = state.stamp_ns, 1
        self.window = deque([WindowSample(state)], MOST_STATES)
        self._integrated: WindowSample | None = None

    @property
    def last(self) -> VehicleState:
        """Newest state."""
        return self.window[-1].state

    def append(self, state: VehicleState) -> None:
        """Add a consistent state; after a gap the integration starts again."""
        if time_between(self.last, state) > CHECK_WINDOW:
            self.window.clear()
            self.window.append(WindowSample(state))
        else:
            self.window.append(self._integrate(state))
        self._integrated = None
        while len(self.window) > 1 and time_between(self.window[1].state, state) >= CHECK_WINDOW:
            self.window.popleft()
        self.count += 1

    def objection(self, state: VehicleState, *, silent: bool) -> Rejection | None:
        """Check a state against the track; return the contradiction, or None.

        Args:
            state: New state.
            silent: No state arrived for so long that the twist in between is unknown.
        """
        dt = time_between(self.last, state)
        if dt == 0.0:
            return Rejection("duplicate", f"odom: stamp {state.stamp_ns} ns has been here before")
        if dt < 0.0:
            return stepped_back(dt)
        if silent:
            return jump(self.last, state, dt)
        drift, most, since = self._drift(state)
        rejection = jump(self.last, state, dt)
        if rejection and rejection.cause == "position_jump" and drift <= POSITION_JUMP:
            # The twist leads here from one WINDOW before: the last states were wrong, but not by
            # enough for a rejection. A frozen pose that moves again must not be rejected once more.
            rejection = turn(self.last, state, dt)
        if rejection or drift <= most:
            return rejection
        return Rejection(
            "twist_contradicts_pose",
            f"odom: pose differs by {drift:.3g} m from the twist integrated over "
            f"{since:.3g} s, must be at most {most:.3g} m",
        )

    def _integrate(self, state: VehicleState) -> WindowSample:
        """Integrate the twist from the last state to this one, once per state."""
        if self._integrated is None or self._integrated.state is not state:
            last, x, y, distance, unknown = self.window[-1]
            dt = time_between(last, state)
            (a, b), (c, d) = velocity(last), velocity(state)
            dx, dy = (a + c) / 2 * dt, (b + d) / 2 * dt
            if (change := math.hypot(c - a, d - b)) > VELOCITY_STEP:
                unknown = change / 2 * dt if unknown == self.window[0].unknown else REPEATED
            distance += math.hypot(dx, dy)
            self._integrated = WindowSample(state, x + dx, y + dy, distance, unknown)
        return self._integrated

    def _drift(self, state: VehicleState) -> tuple[float, float, float]:
        """Compare pose and integrated twist since the newest state that is WINDOW old.

        Returns:
            Difference [m], its largest value of a consistent car [m], and time [s].
        """
        first = self.window[0]
        for sample in self.window:
            if time_between(sample.state, state) < CHECK_WINDOW:
                break
            first = sample
        start, now = first.state, self._integrate(state)
        drift = math.hypot(
            state.x - start.x - (now.x - first.x), state.y - start.y - (now.y - first.y)
        )
        most = DRIFT + DRIFT_SHARE * (now.distance - first.distance)
        most += max(now.unknown, 0.0) if now.unknown != first.unknown else 0.0
        return drift, most, time_between(start, state)


def time_between(earlier: VehicleState, later: VehicleState) -> float:
    """Return the time from one state to another [s]."""
    return stamp_difference(earlier.stamp_ns, later.stamp_ns)


def stamp_difference(earlier_ns: int, later_ns: int) -> float:
    """Return the time from one stamp to another [s]."""
    return (later_ns - earlier_ns) / NANOSECONDS


def velocity(state: VehicleState) -> tuple[float, float]:
    """Return the velocity in `map` [m/s]."""
    cos, sin = math.cos(state.yaw), math.sin(state.yaw)
    return state.v_x * cos - state.v_y * sin, state.v_x * sin + state.v_y * cos


def unusable(state: VehicleState, now_ns: int) -> Rejection | None:
    """Check a state without the earlier ones; return the reason against it, or None."""
    for name, (most, unit) in RANGES.items():
        value = getattr(state, name)
        if not math.isfinite(value):
            return Rejection("not_finite", f"odom: {name} = {value} must be finite")
        if abs(value) > most:
            bounds = f"[{-most:g}, {most:g}] {unit}"
            return Rejection("implausible", f"odom: {name} = {value:g} must lie in {bounds}")
    if state.stamp_ns == 0 and now_ns > NANOSECONDS:  # earlier, zero is the time of a simulation
        reason = "odom: header.stamp = 0: the publisher does not set it; must be the time of the"
        return Rejection("zero_stamp", f"{reason} measurement")
    ahead = stamp_difference(now_ns, state.stamp_ns)
    if now_ns > 0 and ahead > FUTURE:
        reason = f"odom: stamp is {ahead:.3g} s in the future, must be at most {FUTURE:g} s"
        return Rejection("in_the_future", reason)
    return None


def stepped_back(dt: float) -> Rejection:
    """Return the rejection of a stamp that went back by -dt [s]."""
    if dt >= -REORDERED:
        reason = f"odom: stamp is {-dt:.3g} s before that of the newest state"
        return Rejection("out_of_order", reason)
    reason = f"odom: stamp went back by {-dt:.3g} s, more than {REORDERED:g} s"
    return Rejection("clock_jumped_back", reason)


def jump(last: VehicleState, state: VehicleState, dt: float) -> Rejection | None:
    """Return the jump of position or heading between two states, or None."""
    moved = math.hypot(state.x - last.x, state.y - last.y)
    speed = max(math.hypot(last.v_x, last.v_y), math.hypot(state.v_x, state.v_y))
    most = speed * dt + POSITION_JUMP
    if moved > most:
        reason = f"odom: position jumped by {moved:.3g} m in {dt:.3g} s, must be at most"
        return Rejection("position_jump", f"{reason} {most:.3g} m")
    return turn(last, state, dt)


def turn(last: VehicleState, state: VehicleState, dt: float) -> Rejection | None:
    """Return the jump of the heading between two states, or None."""
    turned = abs(wrap_angle(state.yaw - last.yaw))
    most = max(abs(last.yaw_rate), abs(state.yaw_rate)) * dt + HEADING_JUMP
    if turned > most:
        reason = f"odom: heading jumped by {turned:.3g} rad in {dt:.3g} s, must be at most"
        return Rejection("heading_jump", f"{reason} {most:.3g} rad")
    return None
