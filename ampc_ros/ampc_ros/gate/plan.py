"""Planned steering angles over time and distance, as received on `steering_plan`."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from ampc_ros.supervision.guard import MAX_GUARD_SPEED, MAX_MEASURED, interpolate_linear

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


class SteeringPlan(NamedTuple):
    """Angles over time and distance; the last one holds beyond the end."""

    times: tuple[float, ...]
    """Times since the start, increasing from 0 [s]."""
    angles: tuple[float, ...]
    """Road-wheel angles [rad]."""
    distances: tuple[float, ...]
    """Distances since the start, never falling [m]."""
    optimised: float
    """Duration of the part that the controller has optimised [s]."""


def make_plan(points: Sequence[PlanPoint]) -> SteeringPlan:
    """Check the points of a plan, and return it.

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
    optimised = 0.0
    for point in points:
        if point.acceleration != 0.0:
            break
        optimised = point.time
    return SteeringPlan(
        tuple(point.time for point in points),
        tuple(point.angle for point in points),
        tuple(point.distance for point in points),
        optimised,
    )


def check_point(i: int, point: PlanPoint) -> None:
    """Raise a ValueError unless the numbers of point `i` are finite and in range."""
    for name, value, low, high in (
        ("time", point.time, 0.0, math.inf),
        ("angle", point.angle, -MAX_MEASURED, MAX_MEASURED),
        ("distance", point.distance, 0.0, math.inf),
        ("speed", point.speed, 0.0, MAX_GUARD_SPEED),
        ("acceleration", point.acceleration, -math.inf, 0.0),
    ):
        if not (low <= value <= high and math.isfinite(value)):
            bound = f"must be finite and lie in [{low:g}, {high:g}]"
            raise ValueError(f"steering_plan: points[{i}].{name} = {value:g} {bound}")


def planned_angle(
    plan: SteeringPlan, time: float, distance: float, *, by_distance: bool = False
) -> float:
    """Return the angle of a plan [rad].

    Within the optimised part the plan is followed by time, beyond it by the distance travelled,
    because a car that brakes reaches each point of the road later than planned.

    Args:
        plan: The plan.
        time: Time since its start [s].
        distance: Distance travelled since its start [m].
        by_distance: Follow the optimised part by distance, too.
    """
    if time <= plan.optimised and not by_distance:
        return interpolate_linear(plan.times, plan.angles, time)
    return interpolate_linear(plan.distances, plan.angles, distance)
