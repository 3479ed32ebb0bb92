"""Planned steering angles over distance, as received on `steering_plan`."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from ampc_ros.supervision.guard import MAX_GUARD_SPEED, MAX_MEASURED

FEWEST_PLAN_POINTS, MOST_PLAN_POINTS = 2, 2000
"""Number of points of a plan."""


class PlanPoint(NamedTuple):
    """One point of a plan."""

    time: float
    """Time since the start of the plan [s]."""
    angle: float
    """Road-wheel angle to command [rad]."""
    distance: float
    """Distance travelled since the start of the plan [m]."""
    speed: float
    """Planned speed [m/s]."""
    acceleration: float
    """0 in the part that the controller has optimised, negative beyond it [m/s^2]."""
    x: float = 0.0
    """Place of `base_link` in the fixed frame [m]."""
    y: float = 0.0
    """Place of `base_link` in the fixed frame [m]."""


class SteeringPlan(NamedTuple):
    """Angles over distance; the last one holds beyond the end."""

    distances: tuple[float, ...]
    """Distances since the start, never falling [m]."""
    angles: tuple[float, ...]
    """Road-wheel angles [rad]."""
    speeds: tuple[float, ...]
    """Speeds for which the angles are planned [m/s]."""
    places: tuple[tuple[float, float], ...]
    """Places of `base_link` in the fixed frame; empty: the plan states none [m]."""


def make_plan(points: Sequence[PlanPoint], *, has_places: bool = True) -> SteeringPlan:
    """Check the points of a plan, and return it.

    Args:
        points: Its points.
        has_places: Whether the points state places.

    Raises:
        ValueError: Names the point, the value and the bound.
    """
    if not FEWEST_PLAN_POINTS <= len(points) <= MOST_PLAN_POINTS:
        bound = f"must have {FEWEST_PLAN_POINTS} to {MOST_PLAN_POINTS} points"
        raise ValueError(f"steering_plan: {len(points)} points {bound}")
    for i, point in enumerate(points):
        check_point(i, point)
    if points[0].time != 0.0:
        raise ValueError(f"steering_plan: points[0].time = {points[0].time:g} must be 0 s")
    for i, (before, after) in enumerate(pairwise(points), start=1):
        if not after.time > before.time:
            text = f"time = {after.time:g} must be greater than {before.time:g} s"
            raise ValueError(f"steering_plan: points[{i}].{text} before it")
        if after.distance < before.distance:
            text = f"distance = {after.distance:g} must not be less than {before.distance:g} m"
            raise ValueError(f"steering_plan: points[{i}].{text} before it")
    return SteeringPlan(
        tuple(point.distance for point in points),
        tuple(point.angle for point in points),
        tuple(point.speed for point in points),
        tuple((point.x, point.y) for point in points) if has_places else (),
    )


def check_point(i: int, point: PlanPoint) -> None:
    """Raise a ValueError unless the numbers of point `i` are finite and in range."""
    for name, value, low, high in (
        ("time", point.time, 0.0, math.inf),
        ("angle", point.angle, -MAX_MEASURED, MAX_MEASURED),
        ("distance", point.distance, 0.0, math.inf),
        ("speed", point.speed, 0.0, MAX_GUARD_SPEED),
        ("acceleration", point.acceleration, -math.inf, 0.0),
        ("x", point.x, -math.inf, math.inf),
        ("y", point.y, -math.inf, math.inf),
    ):
        if not (low <= value <= high and math.isfinite(value)):
            bound = f"must be finite and lie in [{low:g}, {high:g}]"
            raise ValueError(f"steering_plan: points[{i}].{name} = {value:g} {bound}")
