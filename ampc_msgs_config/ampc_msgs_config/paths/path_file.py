"""A user's path from a CSV file."""

import csv
import math
from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import read_text
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.path import Array, Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import (
    Scenario,
    SpeedProfile,
    checked_profile,
    load_scenario,
)

MAX_BYTES, MAX_POINTS = 50_000_000, 500_000
"""Of a CSV file."""


class Route(NamedTuple):
    """What a user chooses to drive; -1 stands for "as given"."""

    scenario: str = "sc1"
    """Shipped scenario, or YAML file."""
    path: str = ""
    """CSV file instead of a scenario, or empty."""
    speed: float = -1.0
    """Constant speed instead of the given one [m/s]."""
    lateral_acceleration: float = -1.0
    """Largest along the CSV file's path; speeds are cut to it [m/s^2]."""
    laps: int = 1
    """Of a CSV file's path that is closed."""


def choose_scenario(route: Route, size: SizeParameters) -> Scenario:
    """Give the drive that a user chose, with a car of this size.

    Raises:
        ValueError: Names the file, the key or line, and the value.
    """
    speed = None if route.speed < 0 else route.speed
    if not route.path:
        return load_scenario(route.scenario, size, speed)
    a_y = route.lateral_acceleration
    return from_csv(File(route.path), speed, SpeedLimits(a_y) if a_y > 0 else None, route.laps)


class SpeedLimits(NamedTuple):
    """What a speed profile along a path keeps to."""

    lateral_acceleration: float = math.inf
    """v^2 times curvature [m/s^2]."""
    longitudinal_acceleration: float = 2.0
    """Of driving off and of braking [m/s^2]."""
    speed: float = 30.0
    """[m/s]."""


def from_csv(
    file: File,
    speed: float | None = None,
    limits: SpeedLimits | None = None,
    laps: int = 1,
) -> Scenario:
    """Make a scenario of a path file: `x_m,y_m[,v_mps]` or `t_s,x_m,y_m`; header names decide.

    Args:
        file: CSV with a header; `x_east_m,y_north_m` serve as well, other columns are ignored.
        speed: Constant speed instead of the file's [m/s].
        limits: That the speed has to keep; they also serve where the file tells no speed.
        laps: How often a closed path is driven.

    Raises:
        ValueError: Names file, line and value; or no speed is known.
    """
    columns = _columns(file)
    points = np.column_stack((columns["x"], columns["y"]))
    try:
        path = make_path(points)
        values = _speed_along(path, points, columns, speed, limits)
        at = np.asarray(path.spacing * np.arange(len(values)))
        period = path.length if path.closed else math.inf
        profile = checked_profile(SpeedProfile(True, at, values, period))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    lap_time = float(np.sum(path.spacing / np.maximum(_middle(values), 0.5)))
    duration = lap_time * (laps if path.closed else 1)
    return Scenario(file.stem, points, profile, duration=math.floor(duration * 10) / 10)


def _middle(values: Array) -> Array:
    return np.asarray((values[1:] + values[:-1]) / 2)


def _speed_along(
    path: Path,
    points: Array,
    columns: dict[str, Array],
    speed: float | None,
    limits: SpeedLimits | None,
) -> Array:
    """Speed at each sample of a path: the given or the file's one, within the limits [m/s]."""
    count = len(path.x)
    values: Array
    if speed is not None:
        values = np.full(count, speed)
    elif "v" in columns or "t" in columns:
        values = _file_speed(path, points, columns)
    elif limits is not None:
        values = np.full(count, limits.speed)
    else:
        raise ValueError("has neither v_mps nor t_s; give a speed or a lateral acceleration")
    return values if limits is None else limited(values, path, limits)


def _file_speed(path: Path, points: Array, columns: dict[str, Array]) -> Array:
    distance = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    kept = np.concatenate(([True], np.diff(distance) > 0))
    if "v" in columns:
        values = columns["v"][kept]
    else:
        values = np.gradient(distance[kept], _increasing(columns["t"][kept]))
    share = np.linspace(0.0, distance[-1], len(path.x))
    return np.asarray(np.interp(share, distance[kept], values))


def _increasing(time: Array) -> Array:
    late = np.diff(time) > 0
    if not late.all():
        i = int(np.argmin(late))
        raise ValueError(f"t_s = {time[i + 1]:g} must be greater than {time[i]:g} before it")
    return time


def limited(values: Array, path: Path, limits: SpeedLimits) -> Array:
    """Lower speeds along a path until they keep to the limits (n,) [m/s].

    Speeds are cut where the path bends, then forwards for driving off and backwards for braking;
    on a closed path twice, so that its end fits its beginning.
    """
    bend = np.maximum(np.abs(path.curvature), 1e-9)
    cut = np.minimum.reduce([values, np.sqrt(limits.lateral_acceleration / bend)])
    speed = np.minimum(cut, limits.speed)
    gain = 2 * limits.longitudinal_acceleration * path.spacing
    for _ in range(2 if path.closed else 1):
        if path.closed:
            speed[0] = speed[-1] = min(speed[0], speed[-1])
        for i in range(1, len(speed)):
            speed[i] = min(speed[i], math.sqrt(speed[i - 1] ** 2 + gain))
        for i in range(len(speed) - 1, 0, -1):
            speed[i - 1] = min(speed[i - 1], math.sqrt(speed[i] ** 2 + gain))
    return np.asarray(speed)


HEADERS = {"x_m": "x", "y_m": "y", "x_east_m": "x", "y_north_m": "y", "v_mps": "v", "t_s": "t"}


def _columns(file: File) -> dict[str, Array]:
    try:
        rows = list(csv.reader(read_text(file, MAX_BYTES).splitlines()))
    except csv.Error as error:
        raise ValueError(f"{file}: cannot be read: {error}") from error
    if len(rows) - 1 > MAX_POINTS:
        raise ValueError(f"{file}: {len(rows) - 1} points are more than {MAX_POINTS}")
    names = [name.strip(" #") for name in rows[0]] if rows else []
    found = {HEADERS[name]: i for i, name in enumerate(names) if name in HEADERS}
    if not {"x", "y"} <= set(found):
        raise ValueError(f"{file}: header {names} must name x_m and y_m")
    return {key: _column(file, rows, i) for key, i in found.items()}


def _column(file: File, rows: list[list[str]], i: int) -> Array:
    values = []
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        text = row[i] if i < len(row) else ""
        try:
            values.append(float(text))
        except ValueError:
            raise ValueError(f"{file}: line {line}: {text!r} must be a number") from None
        if not math.isfinite(values[-1]):
            raise ValueError(f"{file}: line {line}: {text!r} must be finite")
    return np.array(values)
