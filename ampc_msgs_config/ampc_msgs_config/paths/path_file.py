"""Drives from a user's path in a CSV file, and the choice between file and scenario."""

import csv
import math
from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import read_text
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import cached_path
from ampc_msgs_config.scenarios.scenario import (
    Scenario,
    SpeedProfile,
    check_profile,
    load_scenario,
    stopping_speed,
)
from ampc_msgs_config.types import Array

MAX_BYTES, MAX_POINTS = 50_000_000, 500_000
"""Greatest size [bytes] and number of points of a CSV file."""


class Route(NamedTuple):
    """Selection of a drive; -1: value of the scenario or file."""

    scenario: str = "sc1"
    """Shipped scenario, or YAML file."""
    path: str = ""
    """CSV file instead of a scenario, or empty."""
    speed: float = -1.0
    """Constant speed instead of the profile [m/s]."""
    lateral_acceleration: float = -1.0
    """Largest lateral acceleration along the CSV file's path, which limits the speed [m/s^2]."""
    laps: int = 1
    """Laps on a closed path of a CSV file."""


def choose_scenario(route: Route, size: SizeParameters) -> Scenario:
    """Load the selected drive for a car of this size.

    Raises:
        ValueError: File, key or line, and value.
    """
    speed = None if route.speed < 0 else route.speed
    if not route.path:
        return load_scenario(route.scenario, size, speed)
    a_y = route.lateral_acceleration
    return from_csv(File(route.path), speed, SpeedLimits(a_y) if a_y > 0 else None, route.laps)


class SpeedLimits(NamedTuple):
    """Limits of a speed profile along a path."""

    lateral_acceleration: float = math.inf
    """v^2 times curvature [m/s^2]."""
    longitudinal_acceleration: float = 2.0
    """Acceleration and deceleration [m/s^2]."""
    speed: float = 30.0
    """Speed [m/s]."""


def from_csv(
    file: File,
    speed: float | None = None,
    limits: SpeedLimits | None = None,
    laps: int = 1,
) -> Scenario:
    """Build a scenario from a path file: `x_m,y_m[,v_mps]` or `t_s,x_m,y_m`, by its header.

    Args:
        file: CSV with a header; `x_east_m,y_north_m` are accepted, too; other columns are ignored.
        speed: Constant speed instead of the file's [m/s].
        limits: Limits of the speed; they define the speed where the file has none.
        laps: Number of laps on a closed path.

    Raises:
        ValueError: File, line and value; or the file has no speed and none is selected.
    """
    columns = _columns(file)
    points = np.column_stack((columns["x"], columns["y"]))
    try:
        path = cached_path(points)
        values = _speed_along(path, points, columns, speed, limits)
        at = np.asarray(path.spacing * np.arange(len(values)))
        period = path.length if path.closed else math.inf
        profile = check_profile(SpeedProfile(True, at, values, period))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    driven = values if path.closed else np.minimum(values, stopping_speed(path))
    lap_time = float(np.sum(path.spacing / np.maximum(_middle(driven), 0.5)))
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
    """Return the speed at each sample of a path, within the limits [m/s]."""
    count = len(path.x)
    values: Array
    if speed is not None:
        values = np.full(count, speed)
    elif "v" in columns or "t" in columns:
        values = _file_speed(path, points, columns)
    elif limits is not None:
        values = np.full(count, limits.speed)
    else:
        raise ValueError("has neither v_mps nor t_s: select a speed or a lateral acceleration")
    return values if limits is None else limited(values, path, limits)


def _file_speed(path: Path, points: Array, columns: dict[str, Array]) -> Array:
    distance = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    moving = np.concatenate(([True], np.diff(distance) > 0))
    if "v" in columns:
        values = columns["v"][moving]
    else:
        values = np.gradient(distance[moving], _increasing(columns["t"][moving]))
    share = np.linspace(0.0, distance[-1], len(path.x))
    return np.asarray(np.interp(share, distance[moving], values))


def _increasing(time: Array) -> Array:
    increases = np.diff(time) > 0
    if not increases.all():
        i = int(np.argmin(increases))
        raise ValueError(f"t_s = {time[i + 1]:g} must be greater than {time[i]:g} before it")
    return time


def limited(values: Array, path: Path, limits: SpeedLimits) -> Array:
    """Return speeds along a path, lowered to the limits (n,) [m/s].

    The speed is limited by the curvature, then forwards by the acceleration and backwards by the
    deceleration; on a closed path twice, so that its end matches its start.
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
    present = {HEADERS[name]: i for i, name in enumerate(names) if name in HEADERS}
    if not {"x", "y"} <= set(present):
        raise ValueError(f"{file}: header {names} must name x_m and y_m")
    return {key: _column(file, rows, i) for key, i in present.items()}


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
