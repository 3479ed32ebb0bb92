"""Set-point Y_ref(X) of the paper in an inertial frame of small angles."""

import math
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.interpolation import interpolate
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import Array


class PathFrame(NamedTuple):
    """Inertial frame of the paper: origin in the path's first point, X along its chord."""

    x: float
    """Origin in `map` [m]."""
    y: float
    """Origin in `map` [m]."""
    heading: float
    """Direction of the X axis in `map` [rad]."""
    X: Array
    """(n,) X of the path in this frame, increasing [m]."""
    Y: Array
    """(n,) Y of the path in this frame [m]."""


@compiled
def rotate(x: Any, y: Any, angle: float) -> tuple[Any, Any]:
    """Return a vector, or arrays of vectors, turned counter-clockwise by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


@compiled
def place(frame: PathFrame, x: float, y: float, yaw: float) -> tuple[float, float, float]:
    """Return X [m], Y [m] and yaw [rad] of a pose in this frame."""
    X, Y = rotate(x - frame.x, y - frame.y, -frame.heading)
    return X, Y, wrap_angle(yaw - frame.heading)


@compiled
def set_point(frame: PathFrame, X: float) -> float:
    """Return Y_ref at X, r(k) of Eq. (11) [m]; constant beyond the path's ends."""
    return interpolate(X, frame.X, frame.Y)


def path_frame(path: Path) -> PathFrame:
    """Return the inertial frame in which the small angles of the paper hold along the path.

    Raises:
        ValueError: The path turns by 90 degrees or more against its chord, so that Y is no
            function of X.
    """
    x, y = float(path.x[0]), float(path.y[0])
    chord = math.atan2(path.y[-1] - y, path.x[-1] - x)
    steepest = float(np.abs(np.remainder(path.heading - chord + math.pi, math.tau) - math.pi).max())
    if steepest >= math.pi / 2:
        raise ValueError(
            f"reference_path: turns by {math.degrees(steepest):.0f} degrees against its chord; the "
            "paper's formulation needs less than 90"
        )
    c, s = math.cos(chord), math.sin(chord)
    return PathFrame(
        x, y, chord, c * (path.x - x) + s * (path.y - y), c * (path.y - y) - s * (path.x - x)
    )


def along_chord(frame: PathFrame, points: Array) -> Array:
    """Return points in `map` (n, 2) as distance along the chord and offset to its left [m]."""
    x, y = points.T
    return np.column_stack(rotate(x - frame.x, y - frame.y, -frame.heading))
