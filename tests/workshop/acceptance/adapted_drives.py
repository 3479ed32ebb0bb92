"""Drives of a car that differs from its vehicle file, with ordinary driving before."""

import math
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.metrics import LOST
from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_msgs_config.paths.path import Progress
from ampc_msgs_config.scenarios.scenario import (
    Scenario,
    SpeedPlanner,
    SpeedProfile,
    load_scenario,
    speed_at,
)
from ampc_msgs_config.scenarios.wind import Wind, wind_of_steps
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.configuration import Choices, Configuration
from ampc_ros.estimation.adaptation import DIFFERENCES
from ampc_ros.supervision.supervisor import Supervisor
from launch_scripts.templates.vehicle_rules import DataSheet, vehicle_template
from sim_vehicle.car import Car
from sim_vehicle.measurement import noisy
from sim_vehicle.parameters import Vehicle, load_vehicle_file
from tests.workshop.acceptance.independent_plant import Disturbance, assumed_parameters
from tests.workshop.acceptance.state_drives import deviations, loaded
from tests.workshop.acceptance.trials import INDEPENDENT
from tests.workshop.leaderboard.fast_plant import FastSimulation, named

STEP = 0.05
"""Time between two states [s]."""
SPACING = 0.5
"""Distance of the points of an ordinary road [m]."""
RADII = (40.0, 60.0, 80.0, 120.0)
"""Radii of its bends [m]."""
ORDINARY_SPEED, ORDINARY_ACCELERATION, BRAKING = 14.0, 2.5, 1.0
"""Largest speed [m/s], lateral and longitudinal acceleration of ordinary driving [m/s^2]."""
BRAKING_ON_REQUEST = 2.0
"""Deceleration of a driver who obeys a stop request [m/s^2]."""
TRAINING = 60.0
"""Time of ordinary driving [s]."""


class Change(NamedTuple):
    """What differs from the vehicle file."""

    tyres: float = 1.0
    """Factor on the cornering stiffness."""
    mass: float = 1.0
    """Factor on mass and yaw inertia."""
    offset_deg: float = 0.0
    """Angle of the wheels when straight ahead is commanded [deg]."""
    delay: float = 0.0
    """Delay of the steering that is not configured [s]."""

    def __str__(self) -> str:
        """Return the description in tables."""
        parts = [
            f"tyres {100 * (self.tyres - 1):+.0f} %" if self.tyres != 1.0 else "",
            f"mass {100 * (self.mass - 1):+.0f} %" if self.mass != 1.0 else "",
            f"offset {self.offset_deg:+g} deg" if self.offset_deg else "",
            f"delay +{1000 * self.delay:g} ms" if self.delay else "",
        ]
        return ", ".join(filter(None, parts)) or "as in the file"


class ChangedCar(FastSimulation):
    """CommonRoad vehicle 2 with other tyres, mass, offset and delay."""

    def __init__(self, scenario: Scenario, change: Change, lag: float) -> None:
        """Place the car at the start; `lag` is the time constant of the servo [s]."""
        super().__init__(scenario, INDEPENDENT, Disturbance(change.delay, servo_lag=lag))
        self.p.m *= change.mass
        self.p.I_z *= change.mass
        self.p.tire.p_ky1 *= change.tyres / change.mass
        self.numbers, self.offset = named(self.p), math.radians(change.offset_deg)

    def advance(self, steering: float, target_speed: float, period_ns: int) -> None:
        """Integrate over a period [ns] with a commanded angle [rad]."""
        super().advance(steering + self.offset, target_speed, period_ns)


class ChangedOwnCar:
    """A car of this project with other tyres, mass, offset and delay."""

    def __init__(self, vehicle: Vehicle, scenario: Scenario, change: Change) -> None:
        """Place the car at the start."""
        chassis = changed(vehicle.chassis, change)
        delay = vehicle.steering.delay + change.delay
        steering = replace(vehicle.steering, delay=delay)
        speed = speed_at(scenario.speed, 0.0)
        true = vehicle._replace(chassis=chassis, steering=steering)
        self.car = Car(true, scenario.start, speed, step=0.005)
        self.offset = math.radians(change.offset_deg)

    def advance(self, steering: float, target_speed: float, period_ns: int) -> None:
        """Integrate over a period [ns] with a commanded angle [rad]."""
        wind = np.zeros((round(period_ns / NANOSECONDS / 0.005), 2))
        self.car.advance(steering + self.offset, target_speed, wind)


def changed(chassis: ChassisParameters, change: Change) -> ChassisParameters:
    """Return the true chassis of a changed car."""
    return replace(
        chassis,
        mass=chassis.mass * change.mass,
        yaw_inertia=chassis.yaw_inertia * change.mass,
        front_cornering_stiffness=chassis.front_cornering_stiffness * change.tyres,
        rear_cornering_stiffness=chassis.rear_cornering_stiffness * change.tyres,
    )


@cache
def ordinary_road(seed: int) -> Scenario:
    """Return a minute of ordinary driving: random bends in both directions below 2.5 m/s^2."""
    rng, count = np.random.default_rng(seed), round(TRAINING * ORDINARY_SPEED / SPACING) + 100
    at: Array = SPACING * np.arange(count, dtype=np.float64)
    kappa, s = np.zeros(count), 20.0
    while s < at[-1]:
        bend = rng.choice([-1.0, 1.0]) / rng.choice(RADII)
        length = rng.uniform(20.0, 50.0)
        kappa += bend * np.clip(np.minimum(at - s, s + length - at) / 8.0, 0.0, 1.0)
        s += length + rng.uniform(2.0, 25.0)
    heading = SPACING * np.cumsum(kappa)
    points = SPACING * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    speed: Array = np.sqrt(ORDINARY_ACCELERATION / np.maximum(np.abs(kappa), 1e-4))
    speed = np.minimum(speed, ORDINARY_SPEED)
    for order in (range(1, count), range(count - 2, -1, -1)):
        for i in order:
            before = speed[i - 1 if order.step > 0 else i + 1]
            speed[i] = min(speed[i], math.sqrt(before**2 + 2 * BRAKING * SPACING))
    return Scenario("ordinary", points, SpeedProfile(True, at, speed), TRAINING)


def lane_change(speed: float) -> Scenario:
    """Return the smooth double lane change at a speed [m/s]."""
    size = load_vehicle_file(find("vehicles", "ordinary")).size
    return load_scenario("sc1_falcone", size, speed)._replace(start_offset=0.0)


def template_chassis() -> ChassisParameters:
    """Return what the template makes of mass and wheelbase of the independent car."""
    true, _ = assumed_parameters(INDEPENDENT)
    sheet = DataSheet(mass=true.mass, wheelbase=true.wheelbase)
    return ChassisParameters(**vehicle_template(sheet).sections["chassis"])


def config_of(
    chassis: ChassisParameters, steering: SteeringParameters, *, adaptation: bool = True
) -> Configuration:
    """Return the default controller at 10 Hz with the gains of `ordinary`."""
    choices = Choices("preview", "ordinary", gain_table="preview", guard="track", static_path=True)
    config = loaded(choices)
    settings = replace(config.settings, adaptation=adaptation)
    to_cg = chassis.cg_to_rear_axle
    return config._replace(
        chassis=chassis, steering=steering, settings=settings, base_link_to_cg=to_cg
    )


def drive(
    supervisor: Supervisor,
    scenario: Scenario,
    plant: ChangedCar | ChangedOwnCar,
    to_cg: float,
    begin_ns: int,
    seed: int | None = None,
) -> Array:
    """Drive a scenario and return the true cross-track errors of the centre of gravity (n,) [m].

    Args:
        supervisor: Controller.
        scenario: Road.
        plant: The car at its start.
        to_cg: Its true distance from the rear axle to the centre of gravity [m].
        begin_ns: Time of the first state [ns].
        seed: Of the noise `x1`; None: no noise.
    """
    planner, along = SpeedPlanner(scenario), Progress(scenario.path)
    step_ns, every = round(STEP * NANOSECONDS), round(supervisor.period / STEP)
    rng, errors = np.random.default_rng(seed), list[float]()
    supervisor.take_path(scenario.points, begin_ns, begin_ns)
    for number in range(round(scenario.duration / STEP)):
        now_ns = begin_ns + number * step_ns
        true = plant.car.measure(now_ns)
        errors.append(float(along.errors(at_distance(true, to_cg))[0]))
        if abs(errors[-1]) > LOST:
            break
        if number % every == 0:
            state = true
            if seed is not None:
                state = as_received(noisy(true, deviations(), rng.standard_normal(6)))
            with suppress(ValueError):
                supervisor.take_state(state, now_ns)
            supervisor.tick(now_ns)
        plant.advance(supervisor.steering, planner.target_speed(true), step_ns)
    return np.array(errors)


# Hostile drives


class Hostile(NamedTuple):
    """Result of a hostile drive."""

    lost: bool
    outside: bool
    """Whether an estimate left its bounds or was not finite."""


def hostile_drive(seed: int, *, adaptation: bool) -> Hostile:
    """Drive a changed car with skids, gusts, noise and frozen sensors; all drawn from the seed."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice(["paper", "ordinary"]))
    vehicle = load_vehicle_file(find("vehicles", name))
    road, speed = str(rng.choice(["sc1", "sine", "circle"])), float(rng.uniform(4.0, 20.0))
    scenario = load_scenario(road, vehicle.size, speed)
    duration = min(scenario.duration, 14.0)
    change = Change(
        float(rng.uniform(0.7, 1.3)),
        float(rng.uniform(1.0, 1.3)),
        float(rng.uniform(-1.5, 1.5)),
        float(rng.choice([0.0, 0.05, 0.1, 0.15])),
    )
    begin = float(rng.uniform(0.0, 8.0))
    wind = (Wind(kind="gust", start=begin, end=begin + 3.0, speed=float(rng.uniform(-25, 25))),)
    scenario = scenario._replace(wind=wind if rng.random() < 0.5 else (), duration=duration)
    friction = float(rng.uniform(0.3, 1.0)) if rng.random() < 0.4 else None
    noise = float(rng.choice([0.0, 1.0, 3.0]))
    frozen = np.sort(rng.uniform(2.0, duration, 2))
    kind = str(rng.choice(["none", "state", "yaw rate", "lateral velocity"]))
    known = replace(vehicle.steering, lag=float(rng.choice([-1.0, 0.0, 0.08])))
    config = config_of(vehicle.chassis, known, adaptation=adaptation)
    supervisor = Supervisor(config)
    true = vehicle._replace(
        chassis=changed(vehicle.chassis, change),
        steering=replace(vehicle.steering, delay=vehicle.steering.delay + change.delay),
    )
    car = Car(true, scenario.start, speed, step=0.005, friction=friction)
    return _drive_hostile(supervisor, scenario, car, change, noise, (*frozen, kind), rng)


def _drive_hostile(
    supervisor: Supervisor,
    scenario: Scenario,
    car: Car,
    change: Change,
    noise: float,
    frozen: tuple[float, float, str],
    rng: np.random.Generator,
) -> Hostile:
    planner, along = SpeedPlanner(scenario), Progress(scenario.path)
    period_ns, last = round(supervisor.period * NANOSECONDS), None
    begin, end, kind = frozen
    outside, steps, slower = False, round(supervisor.period / 0.005), math.inf
    supervisor.take_path(scenario.points, NANOSECONDS, NANOSECONDS)
    for number in range(round(scenario.duration / supervisor.period)):
        t, now_ns = number * supervisor.period, NANOSECONDS + number * period_ns
        true = car.measure(now_ns)
        if abs(along.errors(true)[0]) > LOST:
            return Hostile(True, outside)
        scaled = noise * rng.standard_normal(6)
        state = as_received(noisy(true, deviations(), scaled))
        last = last or state
        if begin <= t < end:
            state = freeze(state, last, kind)
        else:
            last = state
        with suppress(ValueError):
            supervisor.take_state(state, now_ns)
        supervisor.tick(now_ns)
        adaptation = supervisor.adaptation
        if adaptation:
            x = adaptation.x[DIFFERENCES]
            outside |= not bool(((adaptation.lower <= x) & (x <= adaptation.upper)).all())
        wanted = planner.target_speed(true)
        if supervisor.stop_requested:  # the driver obeys
            slower = min(slower, true.v_x) - BRAKING_ON_REQUEST * supervisor.period
            wanted = max(min(wanted, slower), 0.0)
        wind = wind_of_steps(scenario.wind, number * period_ns, period_ns // steps, steps)
        angle = supervisor.steering + math.radians(change.offset_deg)
        car.advance(angle, wanted, wind)
    return Hostile(False, outside)


def freeze(state: VehicleState, last: VehicleState, kind: str) -> VehicleState:
    """Return a state whose sensor shows its last value."""
    match kind:
        case "state":
            return last._replace(stamp_ns=state.stamp_ns)
        case "yaw rate":
            return state._replace(yaw_rate=last.yaw_rate)
        case "lateral velocity":
            return state._replace(v_y=last.v_y)
    return state
