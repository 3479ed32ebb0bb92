"""Drives of the leaderboard: every controller with the same cars, roads and disturbances.

One function drives them all: the car advances in steps of 10 ms, a controller answers at its own
period, its odometry may be noisy or late. Controllers of the product are driven through the
`Supervisor`, as in a node: a late state arrives with its true stamp, and all checks and limits are
in force. Yardsticks get the newest state that has arrived.
"""

import math
from collections.abc import Callable
from dataclasses import astuple, replace
from functools import cache
from pathlib import Path as File
from typing import NamedTuple, Protocol

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.metrics import rms
from ampc_msgs_config.parameters import ControllerSettings, SteeringParameters
from ampc_msgs_config.paths.path import Path, Progress
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedPlanner, load_scenario
from ampc_msgs_config.scenarios.wind import Wind
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.configuration import Choices, Configuration, configuration
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.measurement import Deviations, noisy
from sim_vehicle.parameters import MeasurementNoise, Vehicle, load_vehicle_file
from tests.workshop.acceptance.independent_plant import SERVO_LAG, assumed_parameters
from tests.workshop.acceptance.independent_plant import Disturbance as PlantDisturbance
from tests.workshop.acceptance.trials import INDEPENDENT
from tests.workshop.leaderboard.fast_plant import FastSimulation
from tests.workshop.leaderboard.yardstick import Yardstick

STEP_NS = 10_000_000
"""Time between two samples of a drive [ns]."""
TENTH = 10
"""Samples in 0.1 s, the time base of the steering activity."""
LEFT = 5.0
"""Cross-track error at which a car has left the road, and its drive ends [m]."""
APPROACH = 4.0
"""Time that a car has to join its path from the side: its error counts from then on [s]."""
GUST_FORCE, GUST_MOMENT, GUST_SPEED = 1500.0, 400.0, 20.0
"""Gust from 4 s to 6 s: on the independent plant [N], [N m]; side wind on the own cars [m/s]."""
SEEDS = (1, 2, 3)
"""Seeds of the measurement noise."""
CARS = ("independent", "ordinary", "paper")
ROADS = ("sc1_falcone", "lane_change", "sc1", "sc2", "sine")
SPEEDS = {"sc1_falcone": 11.0, "sine": 12.0}
"""Speeds that replace those of the scenario files [m/s]."""
DURATIONS = {"sine": 15.0}
"""Durations that replace those of the scenario files [s]."""


class Disturbance(NamedTuple):
    """What a controller does not know of its car and its road."""

    name: str
    noise: bool = False
    """Measurement noise `x1`, with each seed of SEEDS."""
    delay: float = 0.0
    """Delay of the actuator in addition to that of the car [s]."""
    late: float = 0.0
    """Age of the odometry when it arrives [s]."""
    gust: bool = False
    offset: float = 0.0
    """Start to the left of the path [m]."""
    bias_deg: float = 0.0
    """Angle of the wheels when straight ahead is commanded."""
    friction: float | None = None
    """Friction of the road; on the independent plant a factor on that of its tyres."""


DISTURBANCES = (
    Disturbance("none"),
    Disturbance("noise x1", noise=True),
    *(Disturbance(f"delay {1000 * d:.0f} ms", delay=d) for d in (0.05, 0.1, 0.2)),
    *(Disturbance(f"odometry {1000 * d:.0f} ms late", late=d) for d in (0.05, 0.1, 0.15)),
    Disturbance("side gust", gust=True),
    *(Disturbance(f"start {offset:g} m aside", offset=offset) for offset in (1.0, 3.0)),
    Disturbance("steering 1 deg off", bias_deg=1.0),
    Disturbance("friction 0.5", friction=0.5),
)
SLIPPERY_ROADS = ("sc1_falcone", "lane_change", "sc1", "sine")
"""Roads that need at most 85 % of a friction of 0.5."""


class Row(NamedTuple):
    """One row of the leaderboard."""

    road: str
    car: str
    disturbance: Disturbance

    def __str__(self) -> str:
        """Return the name of the row."""
        return f"{self.road}, {self.car}: {self.disturbance.name}"

    @property
    def actuator_is_ideal(self) -> bool:
        """Whether the car follows a command at once, up to a limit of its rate."""
        return self.car != "independent" and self.disturbance.delay == 0.0


def all_rows() -> list[Row]:
    """Return all rows, disturbance by disturbance."""
    return [
        Row(road, car, disturbance)
        for disturbance in DISTURBANCES
        for road in ROADS
        for car in CARS
        if disturbance.friction is None or road in SLIPPERY_ROADS
    ]


class Result(NamedTuple):
    """Numbers of one controller in one row; means over the seeds."""

    max: float
    """Largest cross-track error of the guided point [m]."""
    rms: float
    """RMS of this error [m]."""
    activity: float
    """RMS change of the commanded wheel angle within 0.1 s [deg]."""
    centre: float
    """Largest cross-track error of the centre of gravity [m]."""

    @property
    def stays(self) -> bool:
        """Whether the car stays on the road."""
        return self.max <= LEFT


class Steering(Protocol):
    """A controller as the drive sees it."""

    period: float
    guided_point: float
    """Distance of the point that is guided along the path from the rear axle forward [m]."""

    def command(self, state: VehicleState, now_ns: int) -> float:
        """Return the angle at `now_ns` with the newest state that has arrived [rad]."""


class Supervised:
    """A controller of the product with all its checks, as a node runs it."""

    def __init__(self, supervisor: Supervisor, scenario: Scenario, now_ns: int) -> None:
        """Send the path once."""
        self.supervisor, self.period = supervisor, supervisor.period
        self.guided_point = supervisor.config.chassis.cg_to_rear_axle
        self.angle, self.rejected = 0.0, 0
        supervisor.take_path(scenario.points, now_ns, now_ns)

    def command(self, state: VehicleState, now_ns: int) -> float:
        """Deliver the state with its own stamp, then tick."""
        try:
            self.supervisor.take_state(state, now_ns)
        except ValueError:
            self.rejected += 1
        record = self.supervisor.tick(now_ns)
        if record is not None:
            self.angle = record.command.steering
        return self.angle


class Unsupervised:
    """A yardstick, which uses any state as the present one."""

    def __init__(self, controller: Yardstick, path: Path) -> None:
        """Drive along a path."""
        self.controller, self.path = controller, path
        self.period, self.guided_point = controller.period, controller.guided_point

    def command(self, state: VehicleState, now_ns: int) -> float:
        """Step the controller."""
        return self.controller.step(state, self.path)


Maker = Callable[[Row, Scenario], Steering]
"""Function that builds a controller for a row."""


@cache
def deviations() -> Deviations:
    """Return the measurement noise `x1`."""
    return Deviations(*astuple(load(MeasurementNoise, find("noise", "x1"))))


@cache
def limits() -> ControllerSettings:
    """Return the limits of the yardsticks, which are those of the shipped controllers."""
    return load(ControllerSettings, find("controllers", "table3"))


@cache
def loaded(choices: Choices) -> Configuration:
    """Return the configuration of these choices."""
    return configuration(choices)


@cache
def vehicle_of(car: str) -> Vehicle:
    """Return the vehicle that all controllers assume, with its true actuator."""
    if car != "independent":
        return load_vehicle_file(find("vehicles", car))
    chassis, steering = assumed_parameters(INDEPENDENT)
    ordinary = load_vehicle_file(find("vehicles", "ordinary"))
    return ordinary._replace(chassis=chassis, steering=replace(steering, lag=SERVO_LAG))


def shipped(settings: str, gains: str, *, configured: bool, row: Row, road: Scenario) -> Supervised:
    """Build the preview formulation for a row, with or without the parameters of the actuator.

    Args:
        settings: Name of the controller settings.
        gains: Name of the gains; empty: the default ones of the car.
        configured: Whether rate, lag and delay of the actuator are configured.
        row: Car and disturbance.
        road: Road of the row.
    """
    known = row.car if row.car != "independent" else "ordinary"
    table = gains or ("preview" if row.car == "independent" else "")
    choices = Choices("preview", known, settings, table, guard="track", static_path=True)
    config, vehicle = loaded(choices), vehicle_of(row.car)
    steering = SteeringParameters(max_angle=vehicle.steering.max_angle)
    if configured:
        actuator = vehicle.steering
        steering = replace(actuator, delay=actuator.delay + row.disturbance.delay)
    chassis = vehicle.chassis
    to_cg = chassis.cg_to_rear_axle
    config = config._replace(chassis=chassis, steering=steering, base_link_to_cg=to_cg)
    return Supervised(Supervisor(config), road, NANOSECONDS)


def yardstick(kind: type[Yardstick], row: Row, road: Scenario) -> Unsupervised:
    """Build a yardstick for a row."""
    return Unsupervised(kind(vehicle_of(row.car).chassis, limits()), road.path)


@cache
def road_of(name: str, car: str, *, mirrored: bool = False) -> Scenario:
    """Return a road for a car; mirrored: left and right exchanged."""
    own = File(__file__).with_name(f"{name}.yaml")
    file = str(own) if own.is_file() else name
    scenario = load_scenario(file, vehicle_of(car).size, SPEEDS.get(name))
    if mirrored:
        scenario = scenario._replace(points=scenario.points * (1.0, -1.0))
    return scenario._replace(duration=DURATIONS.get(name, scenario.duration))


def plant(row: Row, road: Scenario) -> Simulation | FastSimulation:
    """Return the car of a row at the start of its road."""
    disturbance, vehicle = row.disturbance, vehicle_of(row.car)
    gust = (GUST_FORCE, GUST_MOMENT) if disturbance.gust else (0.0, 0.0)
    if row.car == "independent":
        friction = disturbance.friction or 1.0
        return FastSimulation(
            road, INDEPENDENT, PlantDisturbance(disturbance.delay, friction, gust)
        )
    if disturbance.gust:
        wind = Wind(kind="gust", start=4.0, end=6.0, speed=GUST_SPEED)
        road = road._replace(wind=(*road.wind, wind))
    delay = vehicle.steering.delay + disturbance.delay
    vehicle = vehicle._replace(steering=replace(vehicle.steering, delay=delay))
    return Simulation(vehicle, road, friction=disturbance.friction)


class Odometry:
    """Measured states on their way to the controller."""

    def __init__(self, late: float, seed: int | None, steps: int) -> None:
        """Prepare a drive; equal seeds give equal noise at equal times for any controller."""
        self.age, self.states = round(late * NANOSECONDS / STEP_NS), list[VehicleState]()
        self.normal: Array | None = None
        if seed is not None:
            self.normal = np.random.default_rng(seed).standard_normal((steps, 6))

    def measure(self, state: VehicleState) -> None:
        """Take the true state of this sample."""
        self.states.append(state)

    def newest(self) -> VehicleState | None:
        """Return the newest state that has arrived, if any."""
        sample = len(self.states) - 1 - self.age
        if sample < 0:
            return None
        state = self.states[sample]
        if self.normal is not None:
            state = noisy(state, deviations(), self.normal[sample])
        return as_received(state)


class Course(NamedTuple):
    """A finished drive, sampled every 10 ms."""

    error: Array
    """Cross-track error of the guided point (n,) [m]."""
    centre: Array
    """Cross-track error of the centre of gravity (n,) [m]."""
    steering: Array
    """Commanded angle (n,) [rad]."""

    def result(self, disturbance: Disturbance) -> Result:
        """Return the numbers of the drive."""
        left = not abs(self.error[-1]) <= LEFT
        first = round(APPROACH * NANOSECONDS / STEP_NS) if disturbance.offset and not left else 0
        error, centre = np.abs(self.error[first:]), np.abs(self.centre[first:])
        change = np.degrees(self.steering[TENTH:] - self.steering[:-TENTH])
        return Result(
            math.inf if left else float(error.max()),
            rms(error),
            rms(change) if len(change) else math.inf,
            math.inf if left else float(centre.max()),
        )


def drive(row: Row, make: Maker, seed: int | None = None, *, mirrored: bool = False) -> Course:
    """Drive one row once with one controller, until the time is over or the road is left.

    Args:
        row: Road, car and disturbance.
        make: Builds the controller.
        seed: Seed of the measurement noise; None: none.
        mirrored: Whether left and right of the road and of the start are exchanged.
    """
    disturbance, side = row.disturbance, -1.0 if mirrored else 1.0
    road = road_of(row.road, row.car, mirrored=mirrored)
    road = road._replace(start_offset=side * disturbance.offset)
    car, controller = plant(row, road), make(row, road)
    planner = SpeedPlanner(road)
    points = controller.guided_point, vehicle_of(row.car).chassis.cg_to_rear_axle
    along = Progress(road.path), Progress(road.path)
    steps = round(road.duration * NANOSECONDS) // STEP_NS
    every = round(controller.period * NANOSECONDS / STEP_NS)
    odometry = Odometry(disturbance.late, seed, steps)
    bias = math.radians(disturbance.bias_deg) * side
    errors, steering, angle = np.empty((2, steps)), np.empty(steps), 0.0
    for step in range(steps):
        now_ns = NANOSECONDS + step * STEP_NS
        true = car.car.measure(now_ns)
        for point, distance in enumerate(points):
            errors[point, step] = along[point].errors(at_distance(true, distance))[0]
        odometry.measure(true)
        if step % every == 0 and (arrived := odometry.newest()) is not None:
            angle = controller.command(arrived, now_ns)
        steering[step] = angle
        if not abs(errors[0, step]) <= LEFT:
            return Course(errors[0, : step + 1], errors[1, : step + 1], steering[: step + 1])
        car.advance(angle + bias, planner.target_speed(true), STEP_NS)
    return Course(errors[0], errors[1], steering)


def drive_row(row: Row, make: Maker) -> Result:
    """Return the numbers of a controller in a row, means over the seeds where there is noise."""
    seeds = SEEDS if row.disturbance.noise else (None,)
    results = [drive(row, make, seed).result(row.disturbance) for seed in seeds]
    return Result(*np.mean(results, axis=0).tolist())
