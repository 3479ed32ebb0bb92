"""Scenarios: path, speed profile, wind, start and duration of a drive."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np

from ampc_msgs_config import config
from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.interpolation import interpolate, section
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.curves import (
    AnyPath,
    Lane,
    StretchedPath,
    build_curve,
    q,
    stretched,
)
from ampc_msgs_config.paths.path import END_DECELERATION, NOT_CAUGHT, STAND_OFF, Path, advance
from ampc_msgs_config.paths.path_fitting import cached_path
from ampc_msgs_config.scenarios.wind import Wind, wind_of_steps
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_msgs_config.validation import Checked, check_range, described, number

SPEED_PREVIEW = 0.5
"""Time by which the target speed is read ahead from the profile: the driver's time constant [s]."""
MIN_PREVIEW = 0.5
"""Least distance of that preview, so that a car starts where the profile begins with 0 m/s [m]."""
POINT_SPACING = 0.5
"""Spacing of the points of analytic paths along X [m]."""
RUN_OUT = 60.0
"""Least distance by which analytic paths continue beyond the end of the drive [m]."""
RUN_OUT_TIME = 1.2
"""Time at the final speed in that distance, in addition to the braking distance [s]."""
MOVING = 0.3
"""Speed from which a car has left its start [m/s]."""
SPEED = number(0.0, 100.0, "m/s", "Target speed.")
DURATION = number(0.1, 1.0e5, "s", "Duration of the drive.")
START_OFFSET = number(-100.0, 100.0, "m", "Start to the left of the path's first point.")


class SpeedProfile(NamedTuple):
    """Speed over time (joined with q) or over arc length (joined by straight lines)."""

    over_distance: bool
    """Whether `at` holds arc lengths instead of times."""
    at: Array
    """(n,) times [s] or arc lengths [m], increasing."""
    speed: Array
    """(n,) [m/s]."""
    period: float = math.inf
    """Length of a lap, after which the profile over arc length repeats [m]."""


class Scenario(NamedTuple):
    """One drive."""

    name: str
    points: Array
    """(n, 2) points of the path in `map` [m]."""
    speed: SpeedProfile
    duration: float
    """Duration of the drive [s]."""
    wind: tuple[Wind, ...] = ()
    lanes: tuple[Lane, ...] = ()
    start_offset: float = 0.0
    """Start to the left of the path's first point [m]."""
    note: str = ""
    """What was inferred from a path file, in one line."""

    @property
    def path(self) -> Path:
        """Reference path, fitted once for equal points."""
        return cached_path(self.points)

    @property
    def start(self) -> tuple[float, float, float]:
        """Pose of the centre of gravity at the start: x [m], y [m], yaw [rad]."""
        path = self.path
        x, y, yaw = path.x[0], path.y[0], float(path.heading[0])
        x, y = x - self.start_offset * math.sin(yaw), y + self.start_offset * math.cos(yaw)
        return float(x), float(y), yaw


class PathWithSpeed(NamedTuple):
    """Path of another planner, and the speed along it."""

    path: Path
    speed: SpeedProfile


class SameAs(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Reference to the same key of another scenario."""

    same_as: Annotated[str, described("Shipped scenario, or YAML file, to take the key from.")]


@dataclass(frozen=True, kw_only=True)
class ScenarioFile(Checked):
    """Content of a scenario file."""

    path: AnyPath
    speed: (
        Annotated[
            tuple[
                tuple[
                    Annotated[float, number(-math.inf, math.inf, "s", "Time.")],
                    Annotated[float, SPEED],
                ],
                ...,
            ],
            described(
                "Times [s], increasing, each with a speed [m/s], joined with q.", most=10_000
            ),
        ]
        | SameAs
    )
    duration: Annotated[float, DURATION]
    wind: tuple[Wind, ...] | SameAs = ()
    start_offset: Annotated[float, START_OFFSET] = 0.0


@compiled
def speed_at(profile: SpeedProfile, place: float) -> float:
    """Return the speed at a time [s] or an arc length [m]; constant beyond the ends [m/s]."""
    at, speed = profile.at, profile.speed
    if profile.period < math.inf:
        place %= profile.period
    if profile.over_distance or len(at) == 1:
        return interpolate(place, at, speed)
    i = section(place, at)
    share = q((place - at[i]) / (at[i + 1] - at[i]))
    return float(speed[i] + share * (speed[i + 1] - speed[i]))


@compiled
def preview_speed(
    profile: SpeedProfile, path: Path, index: int, elapsed: float, x: float, y: float, yaw: float
) -> tuple[float, int]:
    """Return the speed that the driver has to reach one preview time later.

    At the end of an open path the car comes to a stand.

    Args:
        profile: Speed profile of the drive.
        path: Path of the drive.
        index: Position of the car on it, as `advance` counts; NOT_CAUGHT at the start.
        elapsed: Time since the start [s].
        x: Position [m].
        y: Position [m].
        yaw: Heading [rad].

    Returns:
        Speed [m/s], and the index for the next call.
    """
    s, index = advance(path, index, x, y, yaw)
    now = speed_at(profile, s if profile.over_distance else elapsed)
    left = math.inf if path.closed else (len(path.x) - 1) * path.spacing - s - STAND_OFF
    stopping = math.sqrt(2 * END_DECELERATION * max(left, 0.0))
    ahead = max(SPEED_PREVIEW * min(now, stopping), MIN_PREVIEW)
    if not path.closed:
        s = max(s, 0.0)  # `odom` at the start describes the rear axle, behind the first point
    soon = speed_at(profile, s + ahead if profile.over_distance else elapsed + SPEED_PREVIEW)
    return min(soon, math.sqrt(2 * END_DECELERATION * max(left - ahead, 0.0))), index


def stopping_speed(path: Path) -> Array:
    """Return the largest speed at each sample from which the car stops at the end (n,) [m/s]."""
    left = path.spacing * np.arange(len(path.x) - 1, -1, -1)
    return np.asarray(np.sqrt(2 * END_DECELERATION * left))


class SpeedPlanner:
    """Target speed of one drive, which starts with the first state.

    A car may stand at its start and wait. The time of a drive that begins with a speed counts from
    the last state before the car moves.
    """

    def __init__(self, scenario: Scenario | PathWithSpeed) -> None:
        """Prepare one drive of a scenario, or along a path of another planner."""
        self.profile, self.path = scenario.speed, scenario.path
        self.index = NOT_CAUGHT
        self.start_ns: int | None = None
        self.waits = speed_at(self.profile, 0.0) > MOVING

    def target_speed(self, state: VehicleState) -> float:
        """Return the speed that the driver has to reach one preview time later [m/s]."""
        self.waits = self.waits and state.v_x < MOVING
        if self.start_ns is None or self.waits:
            self.start_ns = state.stamp_ns
        elapsed = (state.stamp_ns - self.start_ns) / NANOSECONDS
        speed, self.index = preview_speed(
            self.profile, self.path, self.index, elapsed, state.x, state.y, state.yaw
        )
        return speed


def wind_of_drive(scenario: Scenario, step_ns: int, period_ns: int) -> Array:
    """Return the wind velocity of a whole drive, one row for each step of the integration.

    Args:
        scenario: The drive.
        step_ns: Step of the integration [ns].
        period_ns: Period of the controller [ns].

    Returns:
        (n, 3, 2) [m/s] for whole periods, whose rows equal `wind_of_steps` bit for bit.
    """
    steps = round(period_ns / step_ns)
    periods = -(-round(scenario.duration * NANOSECONDS) // (steps * step_ns))
    return wind_of_steps(scenario.wind, 0, step_ns, periods * steps)


def load_scenario(name: str, size: SizeParameters, speed: float | None = None) -> Scenario:
    """Load a scenario by shipped name or YAML file.

    Args:
        name: Shipped name, or file.
        size: Outline of the car, from which the lanes of ISO tracks follow.
        speed: Constant speed instead of the scenario's [m/s].

    Raises:
        ValueError: File, key, value and bound.
    """
    file = config.find("scenarios", name)
    content = config.read(file)
    if speed is not None:
        content["speed"] = [[0.0, speed]]
    drive = config.build(ScenarioFile, content, str(file))
    try:
        speeds = _resolved(drive.speed, "speed")
        at, values = np.ascontiguousarray(np.array(speeds, dtype=float).T)
        profile = check_profile(SpeedProfile(False, at, values))
        curve, lanes = build_curve(_resolved(drive.path, "path"), size)
        if isinstance(drive.path, StretchedPath):
            curve, lanes = stretched((curve, lanes), drive.path.stretch)
        wind = _resolved(drive.wind, "wind")
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    time = np.arange(0.0, drive.duration, 0.1).tolist()
    reach = sum(speed_at(profile, t) for t in time) * 0.1
    reach += run_out(speed_at(profile, drive.duration))
    return Scenario(
        name=file.stem,
        points=curve(np.arange(0.0, reach, POINT_SPACING, dtype=np.float64)),
        speed=profile,
        duration=drive.duration,
        wind=wind,
        lanes=lanes,
        start_offset=drive.start_offset,
    )


def run_out(v: float) -> float:
    """Return how far a path continues beyond a drive that ends at a speed v [m/s], in m."""
    return max(RUN_OUT, v**2 / (2 * END_DECELERATION) + RUN_OUT_TIME * v)


def _resolved(value: Any, key: str) -> Any:
    """Return the value of a key, or that in the other scenario file to which it refers."""
    if not isinstance(value, SameAs | StretchedPath):
        return value
    file = config.find("scenarios", value.same_as if isinstance(value, SameAs) else value.scenario)
    content = config.read(file)
    if key not in content:
        raise ValueError(f"{file}: missing key {key!r}")
    other = getattr(config.build(ScenarioFile, content, str(file)), key)
    if isinstance(other, SameAs | StretchedPath):
        raise ValueError(f"{file}: {key} refers to another scenario: name that one")
    return other


def check_profile(profile: SpeedProfile) -> SpeedProfile:
    """Return a profile unchanged, if its places increase and its speeds are in range.

    Raises:
        ValueError: Index, value and bound.
    """
    if (np.diff(profile.at) <= 0).any():
        i = int(np.argmax(np.diff(profile.at) <= 0)) + 1
        at, before = profile.at[i], profile.at[i - 1]
        what = "distance" if profile.over_distance else "time"
        raise ValueError(f"speed[{i}]: {what} {at:g} must be greater than {before:g} before it")
    for i, value in enumerate(profile.speed.tolist()):
        check_range(f"speed[{i}]", value, SPEED)
    return profile
