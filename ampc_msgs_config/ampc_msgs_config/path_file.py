"""A user's path from a CSV file."""

import csv
import math
from pathlib import Path as File

import numpy as np

from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.path import Array
from ampc_msgs_config.scenario import Scenario, SpeedProfile, checked_profile, load_scenario


def choose_scenario(
    name: str, path: str, speed: float | None, size: SizeParameters
) -> Scenario:
    """Give the drive along a user's path file, or, if `path` is empty, a scenario by name.

    Args:
        name: Shipped scenario or YAML file.
        path: CSV file, or empty.
        speed: Constant speed instead of the given one [m/s].
        size: Of the car.
    """
    if path:
        return from_csv(File(path), speed)
    return load_scenario(name, size, speed)


def from_csv(file: File, speed: float | None = None) -> Scenario:
    """Make a scenario of a path file: `x_m,y_m[,v_mps]` or `t_s,x_m,y_m`; header names decide.

    Args:
        file: CSV with a header; `x_east_m,y_north_m` serve as well, other columns are ignored.
        speed: Constant speed instead of the file's [m/s].

    Raises:
        ValueError: Names file, line and value; or no speed is known.
    """
    columns = _columns(file)
    points = np.column_stack((columns["x"], columns["y"]))
    distance = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    profile = _speed_over_distance(file, columns, distance, speed)
    duration = float(np.sum(np.diff(profile.at) / np.maximum(_middle(profile.speed), 0.5)))
    return Scenario(file.stem, points, profile, duration=math.floor(duration * 10) / 10)


def _middle(values: Array) -> Array:
    return np.asarray((values[1:] + values[:-1]) / 2)


def _speed_over_distance(
    file: File, columns: dict[str, Array], distance: Array, speed: float | None
) -> SpeedProfile:
    keep = np.concatenate(([True], np.diff(distance) > 0))
    at = distance[keep]
    if len(at) < 2:
        raise ValueError(f"{file}: {len(at)} different points, at least 2 are needed")
    if speed is not None:
        values = np.full(len(at), speed)
    elif "v" in columns:
        values = columns["v"][keep]
    elif "t" in columns:
        values = np.gradient(at, columns["t"][keep])
    else:
        raise ValueError(f"{file}: has neither v_mps nor t_s; give a speed")
    try:
        return checked_profile(SpeedProfile("distance", at, values))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


HEADERS = {"x_m": "x", "y_m": "y", "x_east_m": "x", "y_north_m": "y", "v_mps": "v", "t_s": "t"}


def _columns(file: File) -> dict[str, Array]:
    try:
        rows = list(csv.reader(file.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{file}: cannot be read: {error}") from error
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
