"""The drives that gains are judged by: roads, and cars that are not what the controller knows."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.paths.curves import q
from ampc_msgs_config.scenarios.scenario import POINT_SPACING, RUN_OUT, Scenario, SpeedProfile
from ampc_msgs_config.scenarios.wind import Wind
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import MeasurementNoise, Vehicle

SMALL_STEP = 1.0
"""Step of a node whose lateral reference is 0 and would ask for nothing [m]."""
STEP_DURATION = 10.0
"""Of a step to a constant lateral reference [s]."""
LANE = 3.5
"""Lateral way of the lane change [m]."""
PEAK = 10.0 / math.sqrt(3.0)
"""Largest second derivative of q."""
ACCELERATION = 2.5
"""Largest lateral acceleration that the lane change asks for [m/s^2]."""
CURVATURE = 0.1
"""Largest curvature of it: at walking speed the steering's angle is the limit [1/m]."""
LANE_CHANGE_START, LANE_CHANGE_DURATION = 4.0, 14.0
"""[s]"""
SMALL_OFFSET, LARGE_OFFSET = 0.1, 3.0
"""Of the start from the path, on the lane change and where a road is joined [m]."""
GUST = Wind(kind="gust", start=9.0, end=11.0, speed=15.0)
"""Side wind after the lane change."""
JOIN_DURATION = 14.0
"""Of joining a straight road [s]."""
JUDGED_FROM = {"lane change": 3.0, "joining": 9.0}
"""When the return from the offset has to be over [s]: how fast it was is nobody's gain."""


class Plant(NamedTuple):
    """One drive. What stands from `friction` on, the controller does not know."""

    name: str
    road: str = "lane change"
    """Key of ROADS."""
    known_delay: float = 0.0
    """Of the steering, beyond that of the vehicle file [s]."""
    known_lag: float = 0.0
    """The same of its lag [s]."""
    friction: float | None = None
    """Of the road; None: that of the tyres."""
    stiffness: float = 1.0
    """Factor on that of all tyres."""
    delay: float = 0.0
    """Of the steering, beyond the known one [s]."""
    seed: int | None = None
    """Of the measurement noise x1; None: no noise."""


PLANTS = (
    Plant("nominal"),
    Plant("stiffness -30 %", stiffness=0.7),
    Plant("stiffness +30 %", stiffness=1.3),
    Plant("friction 0.5", friction=0.5),
    Plant("50 ms unknown delay", delay=0.05),
    Plant("80 ms unknown delay", delay=0.08),
    Plant("100 ms delay, 90 ms unknown", known_delay=0.1, delay=0.09),
    Plant("200 ms delay, 90 ms unknown", known_delay=0.2, delay=0.09),
    Plant("100 ms delay", known_delay=0.1),
    Plant("200 ms lag", known_lag=0.2),
    Plant("noise", seed=1),
    Plant("joining", "joining"),
    Plant("joining, friction 0.3", "joining", friction=0.3),
    Plant("joining, 80 ms unknown delay", "joining", delay=0.08),
)
"""Of fitness `robust`. Delays of up to 90 ms that nobody knows of keep the gains away from the
dead-beat ones that win where the mean squared error of one nominal drive is all that counts."""


def lane_change(v: float) -> Scenario:
    """Give a lane change with an offset before it and a gust after it, at a speed [m/s]."""
    length = math.sqrt(LANE * PEAK / min(ACCELERATION / v**2, CURVATURE))
    x = np.arange(0.0, v * LANE_CHANGE_DURATION + RUN_OUT, POINT_SPACING)
    points = np.column_stack((x, LANE * q((x - LANE_CHANGE_START * v) / length)))
    scenario = Scenario("lane change", points, steady(v), LANE_CHANGE_DURATION, (GUST,))
    return scenario._replace(start_offset=SMALL_OFFSET)


def straight(v: float, duration: float, offset: float) -> Scenario:
    """Give a straight road, begun beside it; speed [m/s], duration [s], offset to the left [m]."""
    x = np.arange(0.0, v * duration + RUN_OUT, POINT_SPACING)
    points = np.column_stack((x, np.zeros_like(x)))
    return Scenario("straight", points, steady(v), duration, start_offset=offset)


def joining(v: float) -> Scenario:
    """Give a straight road that is joined from the large offset, at a speed [m/s]."""
    return straight(v, JOIN_DURATION, LARGE_OFFSET)


def step_to(v: float, reference: float) -> Scenario:
    """Give a step to a lateral reference [m] at a speed [m/s]: a road as far to the side."""
    return straight(v, STEP_DURATION, -(reference or SMALL_STEP))


def steady(v: float) -> SpeedProfile:
    """Give a constant speed [m/s]."""
    return SpeedProfile(False, np.array([0.0]), np.array([v]))


ROADS: dict[str, Callable[[float], Scenario]] = {"lane change": lane_change, "joining": joining}


def believed(plant: Plant, vehicle: Vehicle) -> Vehicle:
    """Give the car that the controller knows."""
    steering = vehicle.steering
    delay, lag = steering.delay + plant.known_delay, steering.lag + plant.known_lag
    return vehicle._replace(steering=replace(steering, delay=delay, lag=lag))


def real(plant: Plant, vehicle: Vehicle, scenario: Scenario) -> Simulation:
    """Give the car that it gets, at the start of the drive."""
    steering = believed(plant, vehicle).steering
    steering = replace(steering, delay=steering.delay + plant.delay)
    chassis = softened(vehicle.chassis, plant.stiffness)
    options: dict[str, Any] = {"friction": plant.friction}
    if plant.seed is not None:
        options["noise"] = load(MeasurementNoise, find("noise", "x1"))
        options["rng"] = np.random.default_rng(plant.seed)
    return Simulation(vehicle._replace(chassis=chassis, steering=steering), scenario, **options)


def softened(chassis: ChassisParameters, factor: float) -> ChassisParameters:
    """Give a chassis on tyres of another stiffness."""
    front, rear = chassis.front_cornering_stiffness, chassis.rear_cornering_stiffness
    return replace(
        chassis,
        front_cornering_stiffness=factor * front,
        rear_cornering_stiffness=factor * rear,
    )


DEFINITION = repr(
    (
        (PLANTS, SMALL_STEP, STEP_DURATION, LANE, ACCELERATION, CURVATURE, LANE_CHANGE_START),
        (LANE_CHANGE_DURATION, SMALL_OFFSET, LARGE_OFFSET, GUST, JOIN_DURATION, JUDGED_FROM),
    )
)
"""All numbers above, for a table's provenance."""
