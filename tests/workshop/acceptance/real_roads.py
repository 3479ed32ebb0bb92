"""True roads of the section "real paths", and the points that a planner publishes of them.

The true roads are built here from cubic splines, independently of the path fitting under test.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from ampc_msgs_config.config import find
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import Array
from sim_vehicle.parameters import load_vehicle_file
from tests.workshop.acceptance.road_data import CIRCUITS, DATA, integrated

SPACING = 0.25
"""Distance of the samples of a true road [m]."""
FINE = 0.5
"""Distance of the points that define an analytic road [m]."""
STRAIGHT, RADIUS = 600.0, 50.0
"""Length of the straight road and radius of the circle [m]."""
TURNED = (0.01, 0.3, 0.8, 2.2)
"""Headings by which a road is turned, because the effect of rounding depends on it [rad]."""
MIXED = 0.0
"""Spacing that stands for distances between 0.1 and 5 m in one path."""
MIXED_RANGE = (0.1, 5.0)
"""Distances of the points of a mixed path [m]."""
LAP_GAP, LAP_RADIUS, LAPS = 1.2, 40.0, 3
"""Distance of parallel laps [m], their radius [m] and number."""
LANE_GAP, BEND_RADIUS, LANE = 2.0, 9.0, 60.0
"""Distance between the lanes of a hairpin, radius of its bends, length of its lanes [m]."""
TRANSITION = 6.0
"""Length over which the curvature of a hairpin changes [m]."""


class Road(NamedTuple):
    """A road with its exact geometry."""

    path: Path
    """Samples of the road; argument of progress and error."""
    curve: Callable[[Array], Array]
    """Function from arc length (n,) to points (n, 2) [m]; continues over the laps if closed."""

    @property
    def start(self) -> tuple[float, float, float]:
        """Pose at the start: x [m], y [m], yaw [rad]."""
        path = self.path
        return float(path.x[0]), float(path.y[0]), float(path.heading[0])


def road_through(points: Array, closed: bool = False) -> Road:
    """Return the road of the interpolating cubic spline.

    Args:
        points: (n, 2) positions [m]; those of a closed road end before the first one.
        closed: Whether the last point leads to the first one.
    """
    corners = np.concatenate((points, points[:1])) if closed else points
    chord = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    spline = CubicSpline(chord, corners, bc_type="periodic" if closed else "not-a-knot")

    # Arc length of a fine grid of the parameter, by Simpson's rule.
    parameter = np.linspace(0.0, chord[-1], 20 * math.ceil(chord[-1] / SPACING) + 1)
    speed = np.hypot(*spline(parameter, 1).T)
    middle = np.hypot(*spline((parameter[1:] + parameter[:-1]) / 2, 1).T)
    steps = np.diff(parameter) / 6 * (speed[1:] + 4 * middle + speed[:-1])
    length = np.concatenate(([0.0], np.cumsum(steps)))

    def parameter_at(s: Array) -> Array:
        return np.interp(s % length[-1] if closed else s, length, parameter)

    count = math.ceil(length[-1] / SPACING) + 1
    u = np.interp(np.linspace(0.0, length[-1], count), length, parameter)
    (x, y), (dx, dy), (ddx, ddy) = (spline(u, order).T for order in (0, 1, 2))
    heading = np.unwrap(np.arctan2(dy, dx))
    curvature = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    path = make_path(corners[:2])._replace(  # a path without noise, of this geometry
        spacing=float(length[-1]) / (count - 1),
        x=np.ascontiguousarray(x),
        y=np.ascontiguousarray(y),
        heading=heading,
        curvature=curvature,
        closed=closed,
    )
    return Road(path, lambda s: np.asarray(spline(parameter_at(s))))


@cache
def road(name: str, turned: float = 0.0, share: float = 0.0) -> Road:
    """Return a road by name.

    Args:
        name: One of `roads()`, or `crossing`, `parallel laps`, `hairpins`.
        turned: Heading by which it is turned [rad].
        share: Share of a lap by which the start of a circuit is moved.
    """
    points, closed = _points(name)
    if name in CIRCUITS:
        points = np.roll(points, -round(share * len(points)), axis=0)
    c, s = math.cos(turned), math.sin(turned)
    return road_through(points @ np.array([[c, s], [-s, c]]) + (350.123, -120.456), closed)


def roads() -> tuple[str, ...]:
    """Return the names of the roads; circuits only if the data exist."""
    present = [name for name in CIRCUITS if (DATA / "tracks" / f"{name}.csv").is_file()]
    return ("straight", "sc1", "circle", *present)


def _points(name: str) -> tuple[Array, bool]:
    """Return the points that define a road, and whether it is closed."""
    along = np.arange(0.0, STRAIGHT, FINE)
    match name:
        case "straight":
            return np.column_stack((along, 0 * along)), False
        case "sc1":
            size = load_vehicle_file(find("vehicles", "paper")).size
            return load_scenario("sc1", size).points, False
        case "circle":
            angle = np.linspace(0.0, math.tau, round(math.tau * RADIUS / FINE), endpoint=False)
            return RADIUS * np.column_stack((np.sin(angle), 1 - np.cos(angle))), True
        case "crossing":  # crosses itself at 53 degrees
            angle = np.linspace(-0.5, math.tau - 0.9, 700)
            return 60.0 * np.column_stack((np.sin(angle), np.sin(2 * angle))), False
        case "parallel laps":
            angle = np.linspace(0.0, math.tau * LAPS, 1500)
            radius = LAP_RADIUS + LAP_GAP * angle / math.tau
            return np.column_stack((radius * np.sin(angle), -radius * np.cos(angle))), False
        case "hairpins":
            return hairpins(), False
    rows = np.loadtxt(DATA / "tracks" / f"{name}.csv", delimiter=",", usecols=(0, 1))
    return rows, True


def hairpins() -> Array:
    """Return three lanes, `LANE_GAP` apart, joined by two bulb-shaped hairpins (n, 2) [m]."""

    def excess(angle: float) -> float:
        """Return the distance between the lanes of a hairpin minus `LANE_GAP` [m]."""
        return float(integrated(_bulb(angle))[-1, 1] - LANE_GAP)

    angle = brentq(excess, 0.2, 1.5)
    left = _bulb(float(angle))
    return integrated(np.concatenate((left, -left)))[:: round(FINE / 0.01)]


def _bulb(angle: float) -> Array:
    """Return the curvature of lane, hairpin and lane, every centimetre [1/m].

    Args:
        angle: Turn to the right before the turn to the left, and after it [rad].
    """
    parts = ((LANE, 0.0), (angle, -1.0), (math.pi + 2 * angle, 1.0), (angle, -1.0), (LANE, 0.0))
    lengths = [part if sign == 0.0 else part * BEND_RADIUS for part, sign in parts]
    edges = np.cumsum(lengths)
    s = np.arange(0.0, edges[-1], 0.01)
    values = np.array([sign / BEND_RADIUS for _, sign in parts])
    curvature = values[np.minimum(np.searchsorted(edges, s), len(parts) - 1)]
    window = np.ones(round(TRANSITION / 2 / 0.01))
    for _ in range(2):  # the mean of a mean is smooth, and the turned angle stays
        curvature = np.convolve(curvature, window / len(window), mode="same")
    return np.asarray(curvature)


def places(start: float, stop: float, spacing: float, rng: np.random.Generator) -> Array:
    """Return the arc lengths of points from start to stop, `spacing` apart or mixed (n,) [m]."""
    if spacing != MIXED:
        return np.arange(start, stop, spacing, dtype=np.float64)
    low, high = np.log(MIXED_RANGE)
    count = math.ceil((stop - start) / MIXED_RANGE[0])
    steps = np.exp(rng.uniform(low, high, count))
    along = start + np.concatenate(([0.0], np.cumsum(steps)))
    return along[along < stop]


class Disturbance(NamedTuple):
    """Error of published points."""

    noise: float = 0.0
    """Standard deviation of white noise in x and y [m]."""
    grid: float = 0.0
    """Grid to which x and y are rounded; 0: not rounded [m]."""

    def __str__(self) -> str:
        """Return the name in tables."""
        if self.grid:
            return f"rounded to {100 * self.grid:g} cm"
        return f"white noise {100 * self.noise:g} cm" if self.noise else "clean"

    def applied(self, points: Array, rng: np.random.Generator) -> Array:
        """Return points (n, 2) with this error [m]."""
        if self.noise:
            points = points + self.noise * rng.standard_normal(points.shape)
        return np.round(points / self.grid) * self.grid if self.grid else points
