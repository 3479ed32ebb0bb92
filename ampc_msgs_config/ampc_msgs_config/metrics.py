"""Judges a finished drive."""

from typing import NamedTuple

import numpy as np

from ampc_msgs_config.path import Array, Path, Progress
from ampc_msgs_config.path_frame import path_frame, place, set_point
from ampc_msgs_config.types import NANOSECONDS, VehicleState, at_distance


class Drive(NamedTuple):
    """What was measured and commanded at each control tick of a drive."""

    states: list[VehicleState]
    """State that each command answers, at `base_link`."""
    steering: Array
    """Commanded angle (n,) [rad]."""
    solve_time: Array
    """Time that the controller took, (m,) [s]."""


def errors(drive: Drive, path: Path, base_link_to_cg: float) -> Array:
    """Give cross-track [m] and heading error [rad] of the centre of gravity at each tick (n, 2)."""
    progress = Progress(path)
    return np.array([progress.errors(at_distance(s, base_link_to_cg)) for s in drive.states])


def lateral_errors(drive: Drive, path: Path, base_link_to_cg: float) -> Array:
    """Give Y - Y_ref(X) (n,) [m], the paper's error; nan where the path is no graph over X."""
    try:
        frame = path_frame(path)
    except ValueError:
        return np.full(len(drive.states), np.nan)
    centres = [at_distance(s, base_link_to_cg) for s in drive.states]
    places = [place(frame, centre.x, centre.y, centre.yaw) for centre in centres]
    return np.array([Y - set_point(frame, X) for X, Y, _ in places], dtype=float)


def ticks(drive: Drive) -> Array:
    """Give the time of each tick since the first (n,) [s]."""
    stamps = np.array([state.stamp_ns for state in drive.states])
    return np.asarray((stamps - stamps[0]) / NANOSECONDS)


def evaluate(drive: Drive, path: Path, base_link_to_cg: float, period: float) -> dict[str, float]:
    """Give the numbers of the result table; the unit stands in the name where it is not SI.

    Args:
        drive: At least two ticks.
        path: The reference.
        base_link_to_cg: From the point that the states describe to the centre of gravity [m].
        period: Of the controller [s].
    """
    error = errors(drive, path, base_link_to_cg)[:, 0]
    lateral = lateral_errors(drive, path, base_link_to_cg)
    increments = np.degrees(np.diff(drive.steering))
    gaps = np.rint(np.diff(ticks(drive)) / period).astype(int)
    solve_us = drive.solve_time * 1e6
    return {
        "ticks": len(drive.states),
        "missed_ticks": int(np.maximum(gaps - 1, 0).sum()),
        "mse_m2": float(np.mean(error**2)),
        "mse_lateral_m2": float(np.mean(lateral**2)),
        "rms_error_m": float(np.sqrt(np.mean(error**2))),
        "max_error_m": float(np.abs(error).max()),
        "steering_rms_increment_deg": float(np.sqrt(np.mean(increments**2))),
        "steering_max_deg": float(np.degrees(np.abs(drive.steering).max())),
        "solve_time_p50_us": float(np.percentile(solve_us, 50)),
        "solve_time_p99_us": float(np.percentile(solve_us, 99)),
        "solve_time_max_us": float(solve_us.max()),
    }
