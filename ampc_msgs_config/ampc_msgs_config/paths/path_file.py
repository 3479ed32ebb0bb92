"""Drives from a user's path in a CSV file, and the choice between file and scenario."""

import math
from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.csv_columns import read_path_table
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import CLEAN, cached_path, closure
from ampc_msgs_config.scenarios.scenario import (
    Scenario,
    SpeedProfile,
    check_profile,
    load_scenario,
    stopping_speed,
)
from ampc_msgs_config.types import Array

FAR = 0.3
"""Distance of a point from the smoothed path, beyond five times the noise, that is reported [m]."""
MAX_DEMAND = 9.0
"""Lateral acceleration above which a speed is reported as too high for a bend [m/s^2]."""


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
    columns: str = ""
    """Columns of the CSV file, such as x=3,y=4; empty: by its header."""


def choose_scenario(route: Route, size: SizeParameters) -> Scenario:
    """Load the selected drive for a car of this size.

    Raises:
        ValueError: File, key or line, and value.
    """
    speed = None if route.speed < 0 else route.speed
    if not route.path:
        return load_scenario(route.scenario, size, speed)
    a_y = route.lateral_acceleration
    limits = SpeedLimits(a_y) if a_y > 0 else None
    scenario = from_csv(File(route.path), speed, limits, route.laps, route.columns)
    if route.laps > 1 and not scenario.path.closed:
        reason = closure(scenario.points).reason
        raise ValueError(f"{route.path}: laps = {route.laps}, but the path is open: {reason}")
    return scenario


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
    columns: str = "",
) -> Scenario:
    """Build a scenario from a path file: `x_m,y_m[,v_mps]`, `t_s,x_m,y_m`, or another header.

    Args:
        file: Text file, see `read_path_table`; `Scenario.note` states what was inferred.
        speed: Constant speed instead of the file's [m/s].
        limits: Limits of the speed; they define the speed where the file has none.
        laps: Number of laps on a closed path.
        columns: Selection of columns, such as x=3,y=4; empty: by the header.

    Raises:
        ValueError: File, line and value; or the file has no speed and none is selected.
    """
    numbers, note = read_path_table(file, columns)
    points = np.column_stack((numbers["x"], numbers["y"]))
    try:
        path = cached_path(points)
        values = speed_along(path, points, numbers, speed, limits)
        at = np.asarray(path.spacing * np.arange(len(values)))
        period = path.length if path.closed else math.inf
        profile = check_profile(SpeedProfile(True, at, values, period))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    driven = values if path.closed else np.minimum(values, stopping_speed(path))
    lap_time = float(np.sum(path.spacing / np.maximum(_middle(driven), 0.5)))
    duration = lap_time * (laps if path.closed else 1)
    shape = f"{'closed' if path.closed else 'open'}: {closure(points).reason}"
    note = f"{len(points)} points, {note}; {shape}; path noise {100 * path.noise:.1f} cm"
    note += unusual(path, points, driven)
    return Scenario(file.stem, points, profile, math.floor(duration * 10) / 10, note=note)


def unusual(path: Path, points: Array, speed: Array) -> str:
    """Return a note on a point far from the path, and on a bend that is too fast; mostly empty.

    Args:
        path: Path of the points.
        points: (n, 2) [m].
        speed: Speed at each sample of the path [m/s].
    """
    text = ""
    from scipy.spatial import KDTree  # only files need it

    apart = np.asarray(KDTree(np.column_stack((path.x, path.y))).query(points)[0])
    i = int(np.argmax(apart))
    if apart[i] > FAR + 5.0 * path.noise:
        text = f"; point {i + 1} lies {apart[i]:.2f} m beside the smoothed path"
    demand = speed**2 * np.abs(path.curvature)
    k = int(np.argmax(demand))
    if demand[k] > MAX_DEMAND:
        text += f"; {speed[k]:.3g} m/s at {k * path.spacing:.0f} m demands {demand[k]:.1f} m/s2, "
        text += f"more than tyres on dry asphalt allow ({MAX_DEMAND:g} m/s2): lower the speed"
    return text


def _middle(values: Array) -> Array:
    return np.asarray((values[1:] + values[:-1]) / 2)


def speed_along(
    path: Path,
    points: Array,
    columns: dict[str, Array],
    speed: float | None,
    limits: SpeedLimits | None,
) -> Array:
    """Return the speed at each sample of a path, within the limits (n,) [m/s].

    Args:
        path: Path of the points.
        points: (m, 2) [m].
        columns: Speed `v` [m/s] or time `t` [s] of each point (m,); others are not used.
        speed: Constant speed instead [m/s].
        limits: Limits of the speed; they define it where there is no other.

    Raises:
        ValueError: Nothing defines a speed, or the times do not increase.
    """
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
    if path.noise > CLEAN and not path.closed:  # noise makes the way from point to point longer
        distance *= path.length / distance[-1]
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
