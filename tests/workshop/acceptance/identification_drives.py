"""Drives of cars that the controller does not know, recorded for the identification.

The true car, its steering and the measured point are drawn at random. The start vehicle is wrong as
a template from a data sheet is, and the controller drives with it.
"""

import math
import tempfile
from dataclasses import astuple, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_msgs_config.paths.manoeuvre import write_manoeuvre
from ampc_msgs_config.paths.path import Progress
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedPlanner
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.configuration import Choices, configuration
from ampc_ros.controller import build_controller
from ampc_ros.identification.estimate import Start
from ampc_ros.identification.recording import RecordedDrive, recording_of
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.measurement import Deviations, noisy
from sim_vehicle.parameters import MeasurementNoise, Vehicle, load_vehicle_file
from tests.workshop.acceptance.independent_plant import Disturbance, assumed_parameters, parameters
from tests.workshop.acceptance.trials import INDEPENDENT
from tests.workshop.leaderboard.fast_plant import FastSimulation

CARS = ("ordinary", "paper", "bus", "model_car", "independent")
OWN_CARS = Path(__file__).with_name("cars")
PERIOD_NS = 20_000_000
"""Period of the odometry, 50 Hz [ns]."""
STEERING_NOISE = math.radians(0.05)
"""White noise of the measured steering, at the road wheel [rad]."""
FULL_SIZE = 2.7
"""Wheelbase from which on noise x1 is used as it is [m]."""
SETTINGS = {"pure_pursuit": ("identification", ""), "preview": ("table3", "preview")}
"""Settings and gain table by controller."""


class KnownCar(NamedTuple):
    """True car, and what a user knows of it."""

    name: str
    vehicle: Vehicle
    """The true car; its steering has the true delay and lag."""
    ratio: float
    offset: float
    """[rad]"""
    x_P: float
    """Measured point ahead of the rear axle [m]."""
    start: Vehicle
    """Start vehicle: a template."""
    start_ratio: float


class Assumed(NamedTuple):
    """What the controller assumes of a car."""

    chassis: ChassisParameters
    steering: SteeringParameters
    """With ratio and offset."""
    x_P: float
    """[m]"""


class Driven(NamedTuple):
    """One drive."""

    recording: RecordedDrive
    lateral_acceleration: float
    """Largest true v r [m/s^2]."""
    area: tuple[float, float]
    """Extent of the true positions in x and y [m]."""
    rms: float
    """RMS distance of the centre of gravity from the path [m]."""


def vehicle_of(name: str) -> Vehicle:
    """Return one of CARS."""
    if name == "independent":
        chassis, steering = assumed_parameters(INDEPENDENT)
        ordinary = load_vehicle_file(find("vehicles", "ordinary"))
        p = parameters(INDEPENDENT)
        powertrain = replace(
            ordinary.powertrain, front_drive_share=p.T_se, front_brake_share=p.T_sb
        )
        body = replace(ordinary.body, cg_height=p.h_s)
        return ordinary._replace(
            chassis=chassis, steering=steering, powertrain=powertrain, body=body
        )
    own = OWN_CARS / f"{name}.yaml"
    return load_vehicle_file(own if own.exists() else find("vehicles", name))


def random_car(name: str, rng: np.random.Generator) -> KnownCar:
    """Return a car with random steering and measured point, and a template-like start vehicle."""
    vehicle = vehicle_of(name)
    c, nominal = vehicle.chassis, float(rng.choice([1.0, 15.0]))
    delay, lag = round(rng.uniform(0.0, 0.2) / 0.005) * 0.005, rng.uniform(0.0, 0.2)
    true = vehicle._replace(steering=replace(vehicle.steering, delay=delay, lag=lag))
    wrong = replace(
        c,
        front_cornering_stiffness=c.front_cornering_stiffness * rng.uniform(0.7, 1.3),
        rear_cornering_stiffness=c.rear_cornering_stiffness * rng.uniform(0.7, 1.3),
        yaw_inertia=c.yaw_inertia * rng.uniform(0.8, 1.2),
    )
    steering = SteeringParameters(
        max_angle=vehicle.steering.max_angle, max_rate=10.0, ratio=nominal
    )
    return KnownCar(
        name,
        true,
        nominal * rng.uniform(0.9, 1.1),
        math.radians(rng.uniform(-2.0, 2.0)),
        rng.uniform(-0.2, 1.0) * c.wheelbase,
        vehicle._replace(chassis=wrong, steering=steering),
        nominal,
    )


def start_of(car: KnownCar) -> Start:
    """Return the start of the identification; the relaxation length is not known."""
    powertrain = car.start.powertrain
    return Start(
        car.start.chassis,
        car.start_ratio,
        car.start.tyre.friction,
        None,
        powertrain.front_drive_share,
        powertrain.front_brake_share,
        powertrain.rolling_resistance,
        car.start.body.track,
        car.start.body.cg_height,
        car.start.body.front_roll_share,
        car.start.tyre.stiffest_load,
    )


@cache
def manoeuvre_of(wheelbase: float, max_angle: float) -> Scenario:
    """Return the scenario of the manoeuvre, through its file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "identification.csv"
        write_manoeuvre(file, wheelbase, max_angle)
        return from_csv(file)


def noise_of(wheelbase: float) -> MeasurementNoise:
    """Return noise x1, for small cars scaled: lengths as the wheelbase, speeds as its root."""
    noise, scale = load(MeasurementNoise, find("noise", "x1")), min(wheelbase / FULL_SIZE, 1.0)
    return replace(
        noise,
        position=noise.position * scale,
        lateral_velocity=noise.lateral_velocity * math.sqrt(scale),
        speed=noise.speed * math.sqrt(scale),
    )


def drive_manoeuvre(
    car: KnownCar,
    rng: np.random.Generator,
    *,
    controller: str = "pure_pursuit",
    noise: MeasurementNoise | None = None,
    with_steering: bool = True,
    road: Scenario | None = None,
    assumed: Assumed | None = None,
) -> Driven:
    """Drive the manoeuvre in closed loop at 10 Hz, with odometry at 50 Hz.

    Args:
        car: The car.
        rng: Random numbers of the noise.
        controller: One of SETTINGS.
        noise: Noise of the odometry; None: x1.
        with_steering: Whether the steering is measured.
        road: Road instead of the manoeuvre.
        assumed: What the controller assumes; None: the start vehicle.
    """
    # Car and controller
    c = car.vehicle.chassis
    noise = noise_of(c.wheelbase) if noise is None else noise
    scenario = road or manoeuvre_of(c.wheelbase, car.vehicle.steering.max_angle)
    assumed = assumed or Assumed(car.start.chassis, car.start.steering, 0.0)
    settings, table = SETTINGS[controller]
    choices = Choices(controller, "ordinary", settings, table, guard="track", static_path=True)
    config = configuration(choices)._replace(
        chassis=assumed.chassis,
        steering=assumed.steering,
        base_link_to_cg=assumed.chassis.cg_to_rear_axle - assumed.x_P,
    )
    steer, planner, plant = (
        build_controller(config),
        SpeedPlanner(scenario),
        plant_of(car, scenario),
    )
    deviations, every = Deviations(*astuple(noise)), round(steer.period * 1e9 / PERIOD_NS)
    interface = replace(car.vehicle.steering, ratio=car.ratio, offset=car.offset)
    # Drive
    rows: list[tuple[float, ...]] = []
    commands: list[tuple[float, float]] = []
    angles: list[tuple[float, float]] = []
    states: list[VehicleState] = []
    command = target = 0.0
    while not plant.finished:
        stamp_ns = NANOSECONDS + plant.elapsed_ns
        exact = at_distance(plant.car.measure(stamp_ns), car.x_P)
        state = noisy(exact, deviations, rng.standard_normal(6))
        if len(rows) % every == 0:
            command = assumed.steering.position(steer.step(state, scenario.path).steering)
            target = planner.target_speed(state)
            commands.append((stamp_ns / NANOSECONDS, command))
        measured_angle = steering_of(plant) + STEERING_NOISE * rng.standard_normal()
        angles.append((stamp_ns / NANOSECONDS, interface.position(measured_angle)))
        rows.append((stamp_ns / NANOSECONDS, *state[1:]))
        states.append(exact)
        plant.advance(interface.angle(command), target, PERIOD_NS)
    # Record
    seen = np.array(angles) if with_steering else np.empty((0, 2))
    recording = recording_of(np.array(rows), np.array(commands), seen, np.array([]))
    return Driven(recording, *figures(states, scenario, car))


def plant_of(car: KnownCar, scenario: Scenario) -> Simulation | FastSimulation:
    """Return the true car at the start of a road."""
    if car.name != "independent":
        return Simulation(car.vehicle, scenario)
    steering = car.vehicle.steering
    servo = max(steering.lag, 0.002)
    return FastSimulation(scenario, INDEPENDENT, Disturbance(steering.delay, servo_lag=servo))


def steering_of(plant: Simulation | FastSimulation) -> float:
    """Return the true road-wheel angle [rad]."""
    return float(plant.state[2] if isinstance(plant, FastSimulation) else plant.car.steering)


def figures(
    states: list[VehicleState], scenario: Scenario, car: KnownCar
) -> tuple[float, tuple[float, float], float]:
    """Return largest lateral acceleration, area, and RMS distance of the CG from the path."""
    values, progress = np.array([state[1:] for state in states]), Progress(scenario.path)
    to_cg = car.vehicle.chassis.cg_to_rear_axle - car.x_P
    errors = np.array([progress.errors(at_distance(state, to_cg))[0] for state in states])
    area = (float(np.ptp(values[:, 0])), float(np.ptp(values[:, 1])))
    lateral = np.abs(values[:, 3] * values[:, 5]).max()
    return float(lateral), area, float(np.sqrt(np.mean(errors**2)))
