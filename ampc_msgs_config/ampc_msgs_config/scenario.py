"""What a drive asks for: path, speed profile, wind, start and duration."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import config
from ampc_msgs_config.curves import Lane, borrowed, bounded, check_known, make_curve, q
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.path import Array, Progress, make_path
from ampc_msgs_config.types import NANOSECONDS, VehicleState

SPEED_PREVIEW = 0.5
"""How far ahead the target speed is read from the profile [s]: the time constant of the driver."""
MIN_PREVIEW = 0.5
"""The same as a distance, at least: a car that stands where the profile says 0 has to start [m]."""
POINT_SPACING = 0.5
"""Distance of the points of analytic paths along X [m]."""
RUN_OUT = 60.0
"""How far analytic paths go on beyond the end of the drive [m]."""
BLOCK_EDGE = 0.5
"""Rise and fall of a block of wind [s]."""


class SpeedProfile(NamedTuple):
    """Speed over time (joined with q) or over arc length (joined by straight lines)."""

    over: str
    """`time` or `distance`."""
    at: Array
    """(n,) times [s] or arc lengths [m], increasing."""
    speed: Array
    """(n,) [m/s]."""
    period: float | None = None
    """Length of a lap, after which a profile over distance begins anew [m]."""


class Wind(NamedTuple):
    """One piece of wind along y of `map`."""

    kind: str
    """`gust`: 1-cos, or `block`."""
    start: float
    end: float
    speed: float


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


def speed_at(profile: SpeedProfile, place: float) -> float:
    """Read a speed profile at a time [s] or an arc length [m]; its ends are held."""
    at, speed = profile.at, profile.speed
    if profile.over == "distance" or len(at) == 1:
        return float(np.interp(place, at, speed, period=profile.period))
    i = int(np.clip(np.searchsorted(at, place, side="right") - 1, 0, len(at) - 2))
    share = q((place - at[i]) / (at[i + 1] - at[i]))
    return float(speed[i] + share * (speed[i + 1] - speed[i]))


class SpeedPlanner:
    """Reads the speed profile for a car on its way; the start is the first state it sees."""

    def __init__(self, scenario: Scenario) -> None:
        """Plan for one drive of a scenario."""
        self.profile = scenario.speed
        self.progress = Progress(make_path(scenario.points))
        self.start_ns: int | None = None

    def target_speed(self, state: VehicleState) -> float:
        """Give the speed that the driver has to reach one preview time later [m/s]."""
        if self.start_ns is None:
            self.start_ns = state.stamp_ns
        if self.profile.over == "time":
            elapsed = (state.stamp_ns - self.start_ns) / NANOSECONDS
            return speed_at(self.profile, elapsed + SPEED_PREVIEW)
        s = self.progress.advance(state.x, state.y, state.yaw)
        ahead = max(SPEED_PREVIEW * speed_at(self.profile, s), MIN_PREVIEW)
        return speed_at(self.profile, s + ahead)


def wind_at(wind: tuple[Wind, ...], time: Array) -> Array:
    """Give the wind velocity in `map`, (n, 2) [m/s], at times (n,) [s]."""
    velocity = np.zeros((len(time), 2))
    for piece in wind:
        if piece.kind == "gust":
            z = np.clip((time - piece.start) / (piece.end - piece.start), 0.0, 1.0)
            shape = (1 - np.cos(math.tau * z)) / 2
        else:
            shape = q((time - piece.start) / BLOCK_EDGE) * q((piece.end - time) / BLOCK_EDGE)
        velocity[:, 1] += piece.speed * shape
    return velocity


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
        wind=_wind(content.get("wind", [])),
        lanes=lanes,
        start_offset=bounded(content, "start_offset", -100.0, 100.0, 0.0),
    )


def _speed(content: Any) -> SpeedProfile:
    if isinstance(content, Mapping):
        return _speed(borrowed(content["same_as"], "speed"))
    try:
        table = np.array(content, dtype=float)
    except (TypeError, ValueError):
        table = np.array([])
    if table.ndim != 2 or table.shape[1] != 2 or not np.isfinite(table).all():
        raise ValueError(f"speed = {content!r} must be a list of [time, speed]")
    return checked_profile(SpeedProfile("time", table[:, 0], table[:, 1]))


def checked_profile(profile: SpeedProfile) -> SpeedProfile:
    """Give the profile back, or say which value is out of order or out of [0, 100] m/s."""
    if (np.diff(profile.at) <= 0).any():
        row = int(np.argmax(np.diff(profile.at) <= 0))
        at = f"{profile.over} {profile.at[row + 1]:g}"
        raise ValueError(f"speed: {at} in row {row + 2} must be greater than {profile.at[row]:g}")
    for value in profile.speed:
        if not 0 <= value <= 100:
            raise ValueError(f"speed = {value:g} must lie in [0, 100] m/s")
    return profile


def _wind(content: Any) -> tuple[Wind, ...]:
    if isinstance(content, Mapping):
        return _wind(borrowed(content["same_as"], "wind"))
    if not isinstance(content, list):
        raise ValueError(f"wind = {content!r} must be a list")
    return tuple(_wind_piece(item) for item in content)


def _wind_piece(item: Mapping[str, Any]) -> Wind:
    check_known(item, {"kind", "start", "end", "speed"}, "wind")
    if item["kind"] not in ("gust", "block"):
        raise ValueError(f"wind: kind = {item['kind']!r} must be gust or block")
    start = bounded(item, "start", 0.0, 1.0e5)
    end = bounded(item, "end", start + 2 * BLOCK_EDGE, 1.0e5)
    return Wind(item["kind"], start, end, bounded(item, "speed", -80.0, 80.0))
