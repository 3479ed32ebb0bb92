"""Drives that determine the fitness: roads, and cars that differ from the internal model."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.paths.curves import q
from ampc_msgs_config.scenarios.scenario import (
    POINT_SPACING,
    Scenario,
    SpeedProfile,
    run_out,
)
from ampc_msgs_config.scenarios.wind import Wind
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import MeasurementNoise, Vehicle

SMALL_STEP = 1.0
"""Step at a node with lateral reference 0 [m]."""
STEP_DURATION = 10.0
"""Duration of a step to a constant lateral reference [s]."""
LANE = 3.5
"""Lateral displacement of the lane change [m]."""
PEAK = 10.0 / math.sqrt(3.0)
"""Largest second derivative of q."""
LANE_CHANGE_ACCELERATION = 2.5
"""Largest lateral acceleration of the lane change [m/s^2]."""
CURVATURE = 0.1
"""Largest curvature of the lane change; at walking speed the steering angle limits it [1/m]."""
STRAIGHT_CURVATURE = 3.0e-4
"""Curvature that counts as straight: that of the least demanding drives of a schedule [1/m]."""
LANE_CHANGE_START, LANE_CHANGE_DURATION = 4.0, 14.0
"""Start and duration of the drive with the lane change [s]."""
SMALL_OFFSET, LARGE_OFFSET = 0.1, 3.0
"""Initial cross-track error of the lane change and of joining a road [m]."""
GUST = Wind(kind="gust", start=9.0, end=11.0, speed=15.0)
"""Side wind after the lane change."""
JOIN_DURATION = 14.0
"""Duration of joining a straight road [s]."""
SETTLING_DEADLINE = {"lane change": 3.0, "joining": 9.0}
"""Start of the evaluation [s]; an earlier return to the path earns nothing."""


class Plant(NamedTuple):
    """One drive of a simulated car.

    The fields from `friction` on are unknown to the controller. Names and order of the fields are
    part of `DEFINITION`, whose hash is stored in every tuned table.
    """

    name: str
    road: str = "lane change"
    """Key of ROADS."""
    known_delay: float = 0.0
    """Steering delay that the controller knows, in addition to the vehicle file [s]."""
    known_lag: float = 0.0
    """Steering lag that the controller knows, in addition to the vehicle file [s]."""
    friction: float | None = None
    """Friction coefficient of the road; None: that of the tyres."""
    stiffness: float = 1.0
    """Factor on the cornering stiffness of all tyres."""
    delay: float = 0.0
    """Steering delay that the controller does not know [s]."""
    seed: int | None = None
    """Seed of the measurement noise `x1`; None: no noise."""
    mass: float = 1.0
    """Factor on mass and yaw inertia."""
    lag: float = 0.0
    """Steering lag that the controller does not know [s]."""
    misalignment: float = 0.0
    """Road-wheel angle when straight ahead is commanded [rad]."""


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
    Plant("mass +30 %, noise", mass=1.3, seed=2),
    Plant("50 ms unknown lag, noise", lag=0.05, seed=3),
    Plant("stiffness -15 %, 50 ms unknown delay, noise", stiffness=0.85, delay=0.05, seed=4),
    Plant("wheel -0.7 deg off", misalignment=math.radians(-0.7)),
    Plant("joining", "joining"),
    Plant("joining, friction 0.3", "joining", friction=0.3),
    Plant("joining, 80 ms unknown delay", "joining", delay=0.08),
)
"""Drives of fitness `robust`. Unknown delays of up to 90 ms exclude the nearly dead-beat gains that
minimise the mean squared error of a single nominal drive."""
HELD_OUT = (
    Plant("mass +20 %, noise", mass=1.2, seed=101),
    Plant("mass -20 %, noise", mass=0.8, seed=102),
    Plant("stiffness -20 %, 60 ms unknown delay", stiffness=0.8, delay=0.06),
    Plant("stiffness +20 %, noise", stiffness=1.2, seed=103),
    Plant("friction 0.7", friction=0.7),
    Plant("60 ms unknown lag", lag=0.06),
    Plant("wheel 1 deg off", misalignment=math.radians(1.0)),
    Plant("120 ms delay, 70 ms unknown", known_delay=0.05, delay=0.07),
    Plant("100 ms lag, 50 ms unknown delay", known_lag=0.1, delay=0.05),
    Plant("150 ms delay, noise", known_delay=0.15, seed=104),
    Plant("40 ms unknown delay, noise", delay=0.04, seed=105),
    Plant("joining, mass +20 %", "joining", mass=1.2),
    Plant("joining, friction 0.6, noise", "joining", friction=0.6, seed=106),
    Plant("joining, 60 ms unknown delay, wheel 0.5 deg off", "joining", delay=0.06,
          misalignment=math.radians(-0.5)),
)  # fmt: skip
"""Drives that judge a table (`table_rule`); no search ever sees them."""


def lane_change(v: float, curvature: float = CURVATURE) -> Scenario:
    """Return a lane change with an initial offset and a final gust.

    Args:
        v: Speed [m/s].
        curvature: Largest curvature [1/m].
    """
    length = math.sqrt(LANE * PEAK / min(LANE_CHANGE_ACCELERATION / v**2, curvature))
    x = np.arange(0.0, v * LANE_CHANGE_DURATION + run_out(v), POINT_SPACING)
    points = np.column_stack((x, LANE * q((x - LANE_CHANGE_START * v) / length)))
    scenario = Scenario("lane change", points, constant_speed(v), LANE_CHANGE_DURATION, (GUST,))
    return scenario._replace(start_offset=SMALL_OFFSET)


def straight(v: float, duration: float, offset: float) -> Scenario:
    """Return a straight road; speed [m/s], duration [s], initial offset to the left [m]."""
    x = np.arange(0.0, v * duration + run_out(v), POINT_SPACING)
    points = np.column_stack((x, np.zeros_like(x)))
    return Scenario("straight", points, constant_speed(v), duration, start_offset=offset)


def joining(v: float) -> Scenario:
    """Return a straight road that is joined from the large offset, at a speed [m/s]."""
    return straight(v, JOIN_DURATION, LARGE_OFFSET)


def step_to(v: float, reference: float) -> Scenario:
    """Return a step to a lateral reference [m] at a speed [m/s]: a road with this offset."""
    return straight(v, STEP_DURATION, -(reference or SMALL_STEP))


def constant_speed(v: float) -> SpeedProfile:
    """Return a speed profile of constant speed [m/s]."""
    return SpeedProfile(False, np.array([0.0]), np.array([v]))


ROADS: dict[str, Callable[[float], Scenario]] = {"lane change": lane_change, "joining": joining}


def nominal_vehicle(plant: Plant, vehicle: Vehicle) -> Vehicle:
    """Return the vehicle that the controller assumes."""
    steering = vehicle.steering
    lag = steering.time_constant + plant.known_lag if plant.known_lag else steering.lag
    delay = steering.delay + plant.known_delay
    return vehicle._replace(steering=replace(steering, delay=delay, lag=lag))


def simulated_car(plant: Plant, vehicle: Vehicle, scenario: Scenario) -> Simulation:
    """Return the simulation of the actual car at the start of the drive."""
    steering = nominal_vehicle(plant, vehicle).steering
    steering = replace(steering, delay=steering.delay + plant.delay)
    if plant.lag:
        steering = replace(steering, lag=steering.time_constant + plant.lag)
    chassis = replace(
        vehicle.chassis,
        mass=plant.mass * vehicle.chassis.mass,
        yaw_inertia=plant.mass * vehicle.chassis.yaw_inertia,
        front_cornering_stiffness=plant.stiffness * vehicle.chassis.front_cornering_stiffness,
        rear_cornering_stiffness=plant.stiffness * vehicle.chassis.rear_cornering_stiffness,
    )
    options: dict[str, Any] = {"friction": plant.friction}
    if plant.seed is not None:
        options["noise"] = load(MeasurementNoise, find("noise", "x1"))
        options["rng"] = np.random.default_rng(plant.seed)
    return Simulation(vehicle._replace(chassis=chassis, steering=steering), scenario, **options)


DEFINITION = repr(
    (
        (
            PLANTS,
            HELD_OUT,
            SMALL_STEP,
            STEP_DURATION,
            LANE,
            LANE_CHANGE_ACCELERATION,
            CURVATURE,
            LANE_CHANGE_START,
        ),
        (LANE_CHANGE_DURATION, SMALL_OFFSET, LARGE_OFFSET, GUST, JOIN_DURATION, SETTLING_DEADLINE),
    )
)
"""All numbers above; its hash is part of the provenance of a table."""
