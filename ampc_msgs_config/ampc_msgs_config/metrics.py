"""Metrics of a finished drive."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.paths.path import Path, Progress
from ampc_msgs_config.paths.path_frame import path_frame, place, set_point
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState

REVERSAL_BAND = math.radians(0.2)
"""Least road-wheel movement of a reversal, 3 deg at a steering wheel geared 16 to 1 [rad]."""
LOST = 10.0
"""Cross-track error beyond which a car counts as lost [m]."""


class Drive(NamedTuple):
    """Measured states and commands at the control ticks of a drive."""

    states: list[VehicleState]
    """State for each command, at `base_link`."""
    steering: Array
    """Commanded angle (n,) [rad]."""
    solve_time: Array
    """Computing time of the controller (m,) [s]."""


def errors(drive: Drive, path: Path, base_link_to_cg: float) -> Array:
    """Return cross-track [m] and heading error [rad] of the centre of gravity by tick (n, 2)."""
    progress = Progress(path)
    return np.array([progress.errors(at_distance(s, base_link_to_cg)) for s in drive.states])


def lateral_errors(drive: Drive, path: Path, base_link_to_cg: float) -> Array:
    """Return Y - Y_ref(X) (n,) [m], the paper's error; nan where the path is no function of X."""
    try:
        frame = path_frame(path)
    except ValueError:
        return np.full(len(drive.states), np.nan)
    centres = [at_distance(s, base_link_to_cg) for s in drive.states]
    places = [place(frame, centre.x, centre.y, centre.yaw) for centre in centres]
    return np.array([Y - set_point(frame, X) for X, Y, _ in places], dtype=float)


def ticks(drive: Drive) -> Array:
    """Return the time of each tick since the first (n,) [s]."""
    stamps = np.array([state.stamp_ns for state in drive.states])
    return np.asarray((stamps - stamps[0]) / NANOSECONDS)


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def missed_ticks(time: Array, period: float) -> int:
    """Count the missing ticks between stamps (n,) [s] of a controller with this period [s]."""
    gaps = np.rint(np.diff(time) / period).astype(int)
    return int(np.maximum(gaps - 1, 0).sum())


def reversals(angle: Array, band: float = REVERSAL_BAND) -> int:
    """Count the direction changes of a wheel angle (n,) [rad] by more than `band` [rad]."""
    count, direction, low, high = 0, 0, math.inf, -math.inf
    for value in angle.tolist():
        low, high = min(low, value), max(high, value)
        turned = -1 if value < high - band else 1 if value > low + band else 0
        if turned and turned != direction:
            count += direction != 0
            direction = turned
        if turned:
            low = high = value
    return count


def time_where(time: Array, active: NDArray[np.bool_]) -> float:
    """Return the total time of active ticks (n,) [s]; each tick lasts until the next one."""
    lasting = np.diff(time)
    return float(lasting[active[:-1]].sum())


def distance_driven(time: Array, speed: Array) -> float:
    """Return the integral of the speed (n,) [m/s] over time (n,) [s], in [m]."""
    return float(np.sum(np.diff(time) * (np.abs(speed[1:]) + np.abs(speed[:-1])) / 2))


def evaluate(drive: Drive, path: Path, base_link_to_cg: float, period: float) -> dict[str, float]:
    """Return the metrics of the result table; the unit is in the name where it is not SI.

    Args:
        drive: At least two ticks.
        path: Reference path.
        base_link_to_cg: Distance from the point of the states forward to the centre of gravity [m].
        period: Period of the controller [s].
    """
    error, heading = errors(drive, path, base_link_to_cg).T
    lateral = lateral_errors(drive, path, base_link_to_cg)
    increments = np.degrees(np.diff(drive.steering))
    solve_us = drive.solve_time * 1e6
    return {
        "ticks": len(drive.states),
        "missed_ticks": missed_ticks(ticks(drive), period),
        "mse_m2": float(np.mean(error**2)),
        "mse_lateral_m2": float(np.mean(lateral**2)),
        "rms_error_m": rms(error),
        "p95_error_m": float(np.percentile(np.abs(error), 95)),
        "max_error_m": float(np.abs(error).max()),
        "rms_heading_error_deg": math.degrees(rms(heading)),
        "steering_rms_increment_deg": rms(increments),
        "steering_reversals": reversals(drive.steering),
        "steering_max_deg": float(np.degrees(np.abs(drive.steering).max())),
        "solve_time_p50_us": float(np.percentile(solve_us, 50)),
        "solve_time_p99_us": float(np.percentile(solve_us, 99)),
        "solve_time_max_us": float(solve_us.max()),
    }
