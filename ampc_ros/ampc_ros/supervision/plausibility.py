"""What makes a measured state unusable, alone or after the ones before it."""

import math
from collections import deque
from typing import NamedTuple

from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.types import NANOSECONDS, VehicleState

FUTURE = 0.1
"""Farthest that a stamp may be ahead of the node's clock [s]."""
REORDERED = 0.5
"""A stamp that goes back by more is no overtaken message but a clock that jumped [s]."""
POSITION_JUMP = 0.5
"""By which a position may differ from where the speed can take it [m]."""
HEADING_JUMP = 0.2
"""By which a heading may differ from where the yaw rate can take it [rad]."""
WINDOW = 0.5
"""Time over which the twist is added up and held against the pose [s]; states that are refused
but follow from each other for as long are a fresh start."""
DRIFT = 0.5
"""By which the pose may differ from the twist added up over the window [m]."""
DRIFT_SHARE = 0.05
"""The same, per way in the window."""
MOST_STATES = 1000
"""Kept of a window, however fast they come."""
MAX_POSITION = 1.0e8
"""Of a coordinate in `map`: farther than any projection of the Earth [m]."""
MAX_SPEED = 100.0
"""Of each component [m/s]."""
MAX_YAW_RATE = 10.0
"""[rad/s]."""

CAUSES = (
    "not_finite",
    "implausible",
    "in_the_future",
    "duplicate",
    "out_of_order",
    "clock_jumped_back",
    "position_jump",
    "heading_jump",
    "twist_contradicts_pose",
)
"""Why a state is refused; keys of `StateFilter.rejected`."""
RANGES = {
    "x": (MAX_POSITION, "m"),
    "y": (MAX_POSITION, "m"),
    "yaw": (math.inf, "rad"),
    "v_x": (MAX_SPEED, "m/s"),
    "v_y": (MAX_SPEED, "m/s"),
    "yaw_rate": (MAX_YAW_RATE, "rad/s"),
}


class Refusal(NamedTuple):
    """Why an input is not used."""

    cause: str
    """One of CAUSES."""
    reason: str
    """A sentence with name, value and bound."""


class Track:
    """States that follow from each other, as far back as the window reaches."""

    def __init__(self, state: VehicleState) -> None:
        """Begin with one state."""
        self.first_ns, self.count = state.stamp_ns, 1
        self.window = deque([(state, 0.0, 0.0, 0.0)], MOST_STATES)
        """States, and the twist added up from the first one to each: x, y and way [m]."""

    @property
    def last(self) -> VehicleState:
        """The newest state."""
        return self.window[-1][0]

    def append(self, state: VehicleState) -> None:
        """Add a state that follows; after a gap the twist is added up anew."""
        if seconds(self.last, state) > WINDOW:
            self.window.clear()
            self.window.append((state, 0.0, 0.0, 0.0))
        else:
            self.window.append(self._added_up(state))
        while len(self.window) > 1 and seconds(self.window[1][0], state) >= WINDOW:
            self.window.popleft()
        self.count += 1

    def objection(self, state: VehicleState, *, silent: bool) -> Refusal | None:
        """Tell why a state does not follow; None where it does.

        Args:
            state: A newer one.
            silent: Nothing has come for so long that the twist in between is not known.
        """
        dt = seconds(self.last, state)
        if dt == 0.0:
            return Refusal("duplicate", f"odom: stamp {state.stamp_ns} ns has been here before")
        if dt < 0.0:
            return stepped_back(dt)
        if silent:
            return jump(self.last, state, dt)
        return self._jump(state, dt) or self._contradiction(state)

    def _jump(self, state: VehicleState, dt: float) -> Refusal | None:
        """Tell of a jump from the last state, unless the twist leads there from a WINDOW before.

        Then the last states were wrong, though not so much that they were refused: where a frozen
        pose goes on, it must not be refused once more for having moved.
        """
        refusal = jump(self.last, state, dt)
        if refusal and refusal.cause == "position_jump" and self._drift(state)[0] <= POSITION_JUMP:
            return turn(self.last, state, dt)
        return refusal

    def _added_up(self, state: VehicleState) -> tuple[VehicleState, float, float, float]:
        last, x, y, way = self.window[-1]
        dt = seconds(last, state)
        (a, b), (c, d) = velocity(last), velocity(state)
        dx, dy = (a + c) / 2 * dt, (b + d) / 2 * dt
        return state, x + dx, y + dy, way + math.hypot(dx, dy)

    def _contradiction(self, state: VehicleState) -> Refusal | None:
        """Hold the pose against the twist, from the newest state that is WINDOW old to this one."""
        off, way, since = self._drift(state)
        most = DRIFT + DRIFT_SHARE * way
        if off <= most:
            return None
        return Refusal(
            "twist_contradicts_pose",
            f"odom: pose differs by {off:.3g} m from the twist added up over "
            f"{since:.3g} s, must be at most {most:.3g} m",
        )

    def _drift(self, state: VehicleState) -> tuple[float, float, float]:
        """Give distance between pose and added-up twist [m], the way [m] and the time [s] of it."""
        first, x, y, way = self.window[0]
        for entry in self.window:
            if seconds(entry[0], state) < WINDOW:
                break
            first, x, y, way = entry
        _, x_now, y_now, way_now = self._added_up(state)
        off = math.hypot(state.x - first.x - (x_now - x), state.y - first.y - (y_now - y))
        return off, way_now - way, seconds(first, state)


def seconds(earlier: VehicleState, later: VehicleState) -> float:
    """Give the time from one state to another [s]."""
    return seconds_between(earlier.stamp_ns, later.stamp_ns)


def seconds_between(earlier_ns: int, later_ns: int) -> float:
    """Give the time from one stamp to another [s]."""
    return (later_ns - earlier_ns) / NANOSECONDS


def velocity(state: VehicleState) -> tuple[float, float]:
    """Give the velocity in `map` [m/s]."""
    cos, sin = math.cos(state.yaw), math.sin(state.yaw)
    return state.v_x * cos - state.v_y * sin, state.v_x * sin + state.v_y * cos


def unusable(state: VehicleState, now_ns: int) -> Refusal | None:
    """Tell why a state cannot be used whatever came before; None where it can."""
    for name, (most, unit) in RANGES.items():
        value = getattr(state, name)
        if not math.isfinite(value):
            return Refusal("not_finite", f"odom: {name} = {value} must be finite")
        if abs(value) > most:
            bounds = f"[{-most:g}, {most:g}] {unit}"
            return Refusal("implausible", f"odom: {name} = {value:g} must lie in {bounds}")
    ahead = seconds_between(now_ns, state.stamp_ns)
    if now_ns > 0 and ahead > FUTURE:
        reason = f"odom: stamp is {ahead:.3g} s in the future, must be at most {FUTURE:g} s"
        return Refusal("in_the_future", reason)
    return None


def stepped_back(dt: float) -> Refusal:
    """Tell that a stamp went back, by -dt [s]."""
    if dt >= -REORDERED:
        reason = f"odom: stamp is {-dt:.3g} s before that of the newest state"
        return Refusal("out_of_order", reason)
    reason = f"odom: stamp went back by {-dt:.3g} s, more than {REORDERED:g} s"
    return Refusal("clock_jumped_back", reason)


def jump(last: VehicleState, state: VehicleState, dt: float) -> Refusal | None:
    """Tell which jump leads from one state to the next; None where there is none."""
    moved = math.hypot(state.x - last.x, state.y - last.y)
    speed = max(math.hypot(last.v_x, last.v_y), math.hypot(state.v_x, state.v_y))
    most = speed * dt + POSITION_JUMP
    if moved > most:
        reason = f"odom: position jumped by {moved:.3g} m in {dt:.3g} s, must be at most"
        return Refusal("position_jump", f"{reason} {most:.3g} m")
    return turn(last, state, dt)


def turn(last: VehicleState, state: VehicleState, dt: float) -> Refusal | None:
    """Tell of a jump of the heading from one state to the next; None where there is none."""
    turned = abs(wrap_angle(state.yaw - last.yaw))
    most = max(abs(last.yaw_rate), abs(state.yaw_rate)) * dt + HEADING_JUMP
    if turned > most:
        reason = f"odom: heading jumped by {turned:.3g} rad in {dt:.3g} s, must be at most"
        return Refusal("heading_jump", f"{reason} {most:.3g} rad")
    return None
