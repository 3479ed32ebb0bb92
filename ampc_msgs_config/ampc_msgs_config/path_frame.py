"""The path as the paper sees it: a set-point Y_ref(X) in an inertial frame of small angles."""

import math
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.path import Array, Path
from ampc_msgs_config.types import VehicleState, wrap_angle


class PathFrame(NamedTuple):
    """The paper's inertial frame, origin in the path's first point and X along its chord."""

    x: float
    """Origin in `map` [m]."""
    y: float
    """Origin in `map` [m]."""
    heading: float
    """Of the X axis in `map` [rad]."""
    X: Array
    """(n,) path in this frame, increasing [m]."""
    Y: Array
    """(n,) path in this frame [m]."""

    def place(self, state: VehicleState) -> tuple[float, float, float]:
        """Give X [m], Y [m] and yaw [rad] of a state in this frame."""
        X, Y = rotate(state.x - self.x, state.y - self.y, -self.heading)
        return X, Y, wrap_angle(state.yaw - self.heading)

    def set_point(self, X: float) -> float:
        """Give Y_ref at X, r(k) of Eq. (11) [m]; the path's ends are held."""
        return float(np.interp(X, self.X, self.Y))


def rotate(x: float, y: float, angle: float) -> tuple[float, float]:
    """Turn a vector counter-clockwise by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


def path_frame(path: Path) -> PathFrame:
    """Turn the inertial frame so that the small angles of the paper hold along the path.

    Raises:
        ValueError: The path turns by 90 degrees or more against its chord, so that Y is no
            function of X there.
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
