"""How to steer from a tick on until the car stands, for the gate: the car may get no other command.

The angles that the controller has planned come first. The angles that the road asks for continue
them over the complete braking distance, at decreasing speed.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import Array
from ampc_ros.assumed_car import AssumedCar
from ampc_ros.preview.model import road_steering

PLAN_PERIOD = 0.1
"""Least time between two points of the optimised part, and between two plans [s]."""
PLAN_SPACING, MOST_CONTINUED = 0.4, 100
"""Least distance of the points of the continuation [wheelbases], and their largest number."""
LEAST_PLANNED_SPEED = 0.5
"""Speed at the last point, from which the angle does not change any more [m/s]."""
CURVATURE_TIME, LEAST_REACH = 0.1, 0.1
"""Time and least distance over which the curvature is averaged [s, wheelbases]."""
PLAN_DECELERATION = 2.0
"""Largest deceleration of a plan: the plan must not end before a car that brakes at this [m/s^2].
"""


class StoppingPlan(NamedTuple):
    """Angles by time and by distance, and the places that belong to them; (n,) each, n >= 2."""

    time: Array
    """Time since the tick, from 0 on, increasing [s]."""
    angle: Array
    """Road-wheel angle to command, without the estimated offset [rad]."""
    distance: Array
    """Distance driven since the tick [m]."""
    speed: Array
    """[m/s]."""
    acceleration: Array
    """Zero in the optimised part, negative beyond it [m/s^2]."""
    x: Array
    """Place of `base_link` on the path [m]."""
    y: Array
    """Place of `base_link` on the path [m]."""


class PlanStart(NamedTuple):
    """Where a plan begins."""

    path: Path
    s: float
    """Arc length of the centre of gravity [m]."""
    v_x: float
    """Speed [m/s]."""
    base_link_to_cg: float
    """[m]."""


def stopping_plan(
    start: PlanStart, angles: Sequence[float], period: float, car: AssumedCar, braking: float
) -> StoppingPlan:
    """Return the plan from a tick until the car stands.

    Args:
        start: Place and speed at the tick.
        angles: Road-wheel angles planned by the controller, of this tick and the following ones;
            at least one [rad].
        period: Time between them [s].
        car: Assumed car; its response time is the time by which a command precedes its place.
        braking: Deceleration [m/s^2].
    """
    every = max(round(PLAN_PERIOD / period), 1)
    planned = np.asarray(angles, dtype=float)[::every]
    v, a = max(start.v_x, 0.0), min(braking, PLAN_DECELERATION)
    time = every * period * np.arange(len(planned), dtype=np.float64)
    distance: Array = v * time

    # Continuation: the speed falls from the end of the optimised part on
    end, slowest = float(distance[-1]), min(LEAST_PLANNED_SPEED, v)
    spacing = PLAN_SPACING * (car.vehicle[2] + car.vehicle[3])
    length = max((v * v - slowest * slowest) / (2 * a), 2 * spacing)
    count = min(math.ceil(length / spacing), MOST_CONTINUED)
    beyond: Array = length / count * np.arange(1.0, count + 1.0, dtype=np.float64)
    speed = np.sqrt(np.maximum(v * v - 2 * a * beyond, slowest * slowest))
    mean = (np.concatenate(([v], speed[:-1])) + speed) / 2
    steps = np.diff(beyond, prepend=0.0) / np.maximum(mean, LEAST_PLANNED_SPEED)
    road = road_angles(start.path, start.s + end + beyond, speed, car)
    if v < LEAST_PLANNED_SPEED:
        road = np.full(count, planned[-1])

    distance = np.concatenate((distance, end + beyond))
    x, y = places(start.path, start.s + distance - start.base_link_to_cg)
    return StoppingPlan(
        np.concatenate((time, time[-1] + np.cumsum(steps))),
        np.concatenate((planned, road)) - car.offset,
        distance,
        np.concatenate((np.full(len(planned), v), speed)),
        np.concatenate((np.zeros(len(planned)), np.full(count, -a))),
        x,
        y,
    )


def road_angles(path: Path, s: Array, speed: Array, car: AssumedCar) -> Array:
    """Return the angles to command at arc lengths (n,) so that they act where the road asks [rad].

    Args:
        path: Path.
        s: Arc lengths of the centre of gravity (n,) [m].
        speed: Speeds there (n,) [m/s].
        car: Assumed car.
    """
    least = LEAST_REACH * (car.vehicle[2] + car.vehicle[3])
    ahead, reach = s + speed * sum(car.response), np.maximum(CURVATURE_TIME * speed, least)
    edges = headings(path, ahead + reach * np.array([[-1.5], [-0.5], [0.5], [1.5]]))
    before, now, after = np.diff(edges, axis=0) / reach
    change = speed * (after - before) / (2 * reach)
    values = zip(speed.tolist(), now.tolist(), change.tolist(), strict=True)
    return np.array([road_steering(car.vehicle, *each) for each in values])


def headings(path: Path, s: Array) -> Array:
    """Return the headings at arc lengths of any shape, continuous over the laps [rad]."""
    if not path.closed:
        return np.interp(s, path.spacing * np.arange(len(path.x)), path.heading)
    laps = np.floor(s / path.length)
    turn = path.heading[-1] - path.heading[0]
    at = np.interp(s - laps * path.length, path.spacing * np.arange(len(path.x)), path.heading)
    return np.asarray(at + laps * turn)


def places(path: Path, s: Array) -> tuple[Array, Array]:
    """Return positions at arc lengths (n,); an open path continues straight [m]."""
    inside = s % path.length if path.closed else np.clip(s, 0.0, path.length)
    at = path.spacing * np.arange(len(path.x))
    heading, beyond = headings(path, s), 0.0 if path.closed else s - inside
    return (
        np.interp(inside, at, path.x) + beyond * np.cos(heading),
        np.interp(inside, at, path.y) + beyond * np.sin(heading),
    )
