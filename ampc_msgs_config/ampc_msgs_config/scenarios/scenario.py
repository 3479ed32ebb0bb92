"""What a drive asks for: path, speed profile, wind, start and duration."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import config
from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.interpolation import interpolate, section
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.curves import Lane, bounded, check_known, make_curve, q, read_same_as
from ampc_msgs_config.paths.path import NOT_CAUGHT, Array, Path, advance
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.wind import Wind, read_wind, wind_of_steps
from ampc_msgs_config.types import NANOSECONDS, VehicleState

SPEED_PREVIEW = 0.5
"""How far ahead the target speed is read from the profile [s]: the time constant of the driver."""
MIN_PREVIEW = 0.5
"""The same as a distance, at least: a car that stands where the profile says 0 has to start [m]."""
POINT_SPACING = 0.5
"""Distance of the points of analytic paths along X [m]."""
RUN_OUT = 60.0
"""How far analytic paths go on beyond the end of the drive [m]."""


class SpeedProfile(NamedTuple):
    """Speed over time (joined with q) or over arc length (joined by straight lines)."""

    over_distance: bool
    """Whether `at` is arc lengths, not times."""
    at: Array
    """(n,) times [s] or arc lengths [m], increasing."""
    speed: Array
    """(n,) [m/s]."""
    period: float = math.inf
    """Length of a lap, from 0 to which `at` goes and after which the profile begins anew [m]."""


class Scenario(NamedTuple):
    """One drive."""

    name: str
    points: Array
    """(n, 2) points of the path in `map` [m]."""
    speed: SpeedProfile
    duration: float
    """[s]."""
    wind: tuple[Wind, ...] = ()
    lanes: tuple[Lane, ...] = ()
    start_offset: float = 0.0
    """Start to the left of the path's first point [m]."""

    @property
    def start(self) -> tuple[float, float, float]:
        """Pose of the centre of gravity at the start: x [m], y [m], yaw [rad]."""
        path = make_path(self.points)
        x, y, yaw = path.x[0], path.y[0], float(path.heading[0])
        x, y = x - self.start_offset * math.sin(yaw), y + self.start_offset * math.cos(yaw)
        return float(x), float(y), yaw


@compiled
def speed_at(profile: SpeedProfile, place: float) -> float:
    """Read a speed profile at a time [s] or an arc length [m]; its ends are held."""
    at, speed = profile.at, profile.speed
    if profile.period < math.inf:
        place %= profile.period
    if profile.over_distance or len(at) == 1:
        return interpolate(place, at, speed)
    i = section(place, at)
    share = q((place - at[i]) / (at[i + 1] - at[i]))
    return float(speed[i] + share * (speed[i + 1] - speed[i]))


@compiled
def target_speed(
    profile: SpeedProfile, path: Path, index: int, elapsed: float, x: float, y: float, yaw: float
) -> tuple[float, int]:
    """Give the speed that the driver has to reach one preview time later.

    Args:
        profile: Of the drive.
        path: Of the drive.
        index: Where the car was on it, as `advance` counts; NOT_CAUGHT at the start.
        elapsed: Time since the start [s].
        x: Position [m].
        y: Position [m].
        yaw: Heading [rad].

    Returns:
        Speed [m/s], and the index for the next call.
    """
    if not profile.over_distance:
        return speed_at(profile, elapsed + SPEED_PREVIEW), index
    s, index = advance(path, index, x, y, yaw)
    ahead = max(SPEED_PREVIEW * speed_at(profile, s), MIN_PREVIEW)
    return speed_at(profile, s + ahead), index


class SpeedPlanner:
    """Remembers when a drive began and where the car is; the start is the first state it sees."""

    def __init__(self, scenario: Scenario) -> None:
        """Plan for one drive of a scenario."""
        self.profile, self.path = scenario.speed, make_path(scenario.points)
        self.index = NOT_CAUGHT
        self.start_ns: int | None = None

    def target_speed(self, state: VehicleState) -> float:
        """Give the speed that the driver has to reach one preview time later [m/s]."""
        if self.start_ns is None:
            self.start_ns = state.stamp_ns
        elapsed = (state.stamp_ns - self.start_ns) / NANOSECONDS
        speed, self.index = target_speed(
            self.profile, self.path, self.index, elapsed, state.x, state.y, state.yaw
        )
        return speed


def wind_of_drive(scenario: Scenario, step_ns: int, period_ns: int) -> Array:
    """Give the wind velocity of a whole drive, one row for each step of the integration.

    Args:
        scenario: The drive.
        step_ns: Of the integration [ns].
        period_ns: Of the controller [ns].

    Returns:
        (n, 2) [m/s], n for whole periods; the rows of each are its `wind_of_steps`, bit for bit.
    """
    steps = round(period_ns / step_ns)
    periods = -(-round(scenario.duration * NANOSECONDS) // (steps * step_ns))
    return wind_of_steps(scenario.wind, 0, step_ns, periods * steps)


def load_scenario(name: str, size: SizeParameters, speed: float | None = None) -> Scenario:
    """Load a scenario by shipped name or YAML file.

    Args:
        name: Shipped name, or file.
        size: Of the car, from which the lanes of ISO tracks follow.
        speed: Constant speed instead of the scenario's [m/s].

    Raises:
        ValueError: Names the file, the key, the value and the bound.
    """
    file = config.find("scenarios", name)
    content = config.read(file)
    if speed is not None:
        content["speed"] = [[0.0, speed]]
    try:
        return _scenario(file.stem, content, size)
    except KeyError as error:
        raise ValueError(f"{file}: missing key {error}") from error
    except (TypeError, ValueError) as error:
        raise ValueError(f"{file}: {error}") from error


def _scenario(name: str, content: Mapping[str, Any], size: SizeParameters) -> Scenario:
    check_known(content, {"path", "speed", "wind", "start_offset", "duration"}, "scenario")
    speed = _speed(content["speed"])
    duration = bounded(content, "duration", 0.1, 1.0e5)
    time = np.arange(0.0, duration, 0.1).tolist()
    reach = sum(speed_at(speed, t) for t in time) * 0.1 + RUN_OUT
    curve, lanes = make_curve(content["path"], size)
    return Scenario(
        name=name,
        points=curve(np.arange(0.0, reach, POINT_SPACING, dtype=np.float64)),
        speed=speed,
        duration=duration,
        wind=read_wind(content.get("wind", [])),
        lanes=lanes,
        start_offset=bounded(content, "start_offset", -100.0, 100.0, 0.0),
    )


def _speed(content: Any) -> SpeedProfile:
    if isinstance(content, Mapping):
        return _speed(read_same_as(content["same_as"], "speed"))
    try:
        table = np.array(content, dtype=float)
    except (TypeError, ValueError):
        table = np.array([])
    if table.ndim != 2 or table.shape[1] != 2 or not np.isfinite(table).all():
        raise ValueError(f"speed = {content!r} must be a list of [time, speed]")
    at, speed = np.ascontiguousarray(table.T)
    return checked_profile(SpeedProfile(False, at, speed))


def checked_profile(profile: SpeedProfile) -> SpeedProfile:
    """Give the profile back, or say which value is out of order or out of [0, 100] m/s."""
    if (np.diff(profile.at) <= 0).any():
        row = int(np.argmax(np.diff(profile.at) <= 0))
        at = f"{'distance' if profile.over_distance else 'time'} {profile.at[row + 1]:g}"
        raise ValueError(f"speed: {at} in row {row + 2} must be greater than {profile.at[row]:g}")
    for value in profile.speed:
        if not 0 <= value <= 100:
            raise ValueError(f"speed = {value:g} must lie in [0, 100] m/s")
    return profile
