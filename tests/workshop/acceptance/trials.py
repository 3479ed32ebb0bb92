"""One trial: a car, a controller and what the controller does not know; and what is measured."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path as File
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.interpolate import CubicSpline

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import METRICS, Drive, errors, ticks
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings, SteeringParameters
from ampc_msgs_config.paths.path_file import SpeedLimits, from_csv
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import Scenario, load_scenario
from ampc_msgs_config.types import at_distance
from ampc_ros.configuration import default_table
from ampc_ros.mpc.gain_table import load_gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.run.simulated import SimulatedDrive, record_of_simulated
from launch_scripts.tuning.fleet_rows import Entry, drive_all
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import MeasurementNoise, Vehicle, load_vehicle
from tests.workshop.acceptance.independent_plant import Disturbance, IndependentSimulation, belief

DATA = File(__file__).resolve().parents[4] / "shared" / "data"
"""Recorded roads; they are no part of this repository."""
LIMITS = SpeedLimits(lateral_acceleration=4.0, longitudinal_acceleration=2.0, speed=30.0)
"""On recorded roads."""
LAPS = 2
INDEPENDENT = 2
"""CommonRoad's number of the independent plant: a BMW 320i."""
FINE = 20
"""Outlines looked at per tick."""


class Trial(NamedTuple):
    """One drive as data. What stands from `factors` on, the controller does not know."""

    scenario: str = "sc1"
    """Shipped name, or a CSV file in `DATA`."""
    car: str = "paper"
    """Shipped name, or `independent`."""
    speed: float | None = None
    """Instead of the scenario's [m/s]."""
    offset: float = 0.0
    """Of the start to the left of the path [m]."""
    known_delay: float = 0.0
    """Of the steering [s]."""
    known_lag: float = 0.0
    """Of the steering [s]."""
    factors: tuple[tuple[str, float], ...] = ()
    """On chassis parameters of the real car, by name."""
    delay: float = 0.0
    """Of the steering, beyond the known one [s]."""
    friction: float | None = None
    """Of the road; on the independent plant a factor on that of its tyres."""
    seed: int | None = None
    """Of the measurement noise x1."""
    misaligned_deg: float = 0.0
    """Angle at which the wheels stand when straight ahead is commanded."""
    gust: tuple[float, float] = (0.0, 0.0)
    """Independent plant: side force [N] and yaw moment [N m]."""


def controller(
    name: str, car: str, chassis: ChassisParameters, steering: SteeringParameters
) -> PreviewMpc | LateralMpc:
    """Make `preview` or `paper` with the gains shipped for a car, as it is believed to be."""
    settings = load(ControllerSettings, find("controllers", "table3"))
    table = load_gain_table(default_table(name, car))
    if name == "preview":
        return PreviewMpc(chassis, steering, settings, table)
    return LateralMpc(chassis, settings, table)


def run(trial: Trial, name: str) -> SimulatedDrive:
    """Drive a trial with a controller; see `run_all`."""
    return run_all([trial], name)[0]


def run_all(trials: Sequence[Trial], name: str) -> list[SimulatedDrive]:
    """Drive trials with a controller: as one fleet, or one by one on the independent plant.

    Raises:
        ValueError: The controller cannot take a path.
    """
    vehicles = [believed_vehicle(trial) for trial in trials]
    scenarios = [scenario_of(*pair) for pair in zip(trials, vehicles, strict=True)]
    entries = [
        Entry(
            plant(trial, vehicle, scenario),
            controller(name, trial.car, vehicle.chassis, vehicle.steering),
            math.radians(trial.misaligned_deg),
        )
        for trial, vehicle, scenario in zip(trials, vehicles, scenarios, strict=True)
    ]
    if any(trial.car == "independent" for trial in trials):
        drives = [drive(entry.simulation, entry.controller) for entry in entries]
    else:
        drives = drive_all(entries)
    return [judged(*each) for each in zip(drives, scenarios, vehicles, strict=True)]


def judged(finished: Drive, scenario: Scenario, vehicle: Vehicle) -> SimulatedDrive:
    """Give a drive with its errors."""
    path = make_path(scenario.points)
    error = errors(finished, path, vehicle.chassis.cg_to_rear_axle)[:, 0]
    return SimulatedDrive(finished, path, scenario, vehicle, error)


def believed_vehicle(trial: Trial) -> Vehicle:
    """Give the car that the controller knows."""
    independent = trial.car == "independent"
    vehicle = load_vehicle(find("vehicles", "ordinary" if independent else trial.car))
    if independent:
        chassis, steering = belief(INDEPENDENT)
        return vehicle._replace(chassis=chassis, steering=steering)
    known = replace(vehicle.steering, delay=trial.known_delay, lag=trial.known_lag)
    return vehicle._replace(steering=known)


def scenario_of(trial: Trial, vehicle: Vehicle) -> Scenario:
    """Give what is to be driven."""
    if trial.scenario.endswith(".csv"):
        return from_csv(DATA / trial.scenario, trial.speed, LIMITS, LAPS)
    scenario = load_scenario(trial.scenario, vehicle.size, trial.speed)
    return scenario._replace(start_offset=trial.offset)


def plant(trial: Trial, vehicle: Vehicle, scenario: Scenario) -> Simulation:
    """Give the real car at the start of the drive."""
    if trial.car == "independent":
        disturbance = Disturbance(trial.delay, trial.friction or 1.0, trial.gust)
        return cast(Simulation, IndependentSimulation(scenario, INDEPENDENT, disturbance))
    steering = replace(vehicle.steering, delay=vehicle.steering.delay + trial.delay)
    scaled = {key: getattr(vehicle.chassis, key) * factor for key, factor in trial.factors}
    chassis = replace(vehicle.chassis, **scaled)
    options: dict[str, Any] = {"friction": trial.friction}
    if trial.seed is not None:
        options["noise"] = load(MeasurementNoise, find("noise", "x1"))
        options["rng"] = np.random.default_rng(trial.seed)
    return Simulation(vehicle._replace(chassis=chassis, steering=steering), scenario, **options)


def overlap(driven: SimulatedDrive) -> float:
    """Farthest that a side of the car reaches over a row of cones; negative: the room left [m].

    The poses between the ticks follow cubic splines; the cones stand along the lanes without gaps.
    """
    chassis, size = driven.vehicle.chassis, driven.vehicle.size
    states = [at_distance(s, chassis.cg_to_rear_axle) for s in driven.drive.states]
    pose = np.array([state[1:4] for state in states])
    pose[:, 2] = np.unwrap(pose[:, 2])
    time = ticks(driven.drive)
    x, y, yaw = CubicSpline(time, pose)(np.linspace(0, time[-1], FINE * len(time))).T
    front = chassis.cg_to_front_axle + size.front_overhang
    rear = -chassis.cg_to_rear_axle - size.rear_overhang
    worst = -math.inf
    for along in np.linspace(rear, front, FINE):
        for across in (-size.width / 2, size.width / 2):
            X = x + along * np.cos(yaw) - across * np.sin(yaw)
            Y = y + along * np.sin(yaw) + across * np.cos(yaw)
            for lane in driven.scenario.lanes:
                inside = (lane.start <= X) & (lane.end >= X)
                over = np.maximum(Y - lane.left, lane.right - Y)
                worst = float(np.max(over[inside], initial=worst))
    return worst


class Quantity(NamedTuple):
    """A measured quantity of a trial."""

    label: str
    measure: Callable[[SimulatedDrive], float] | None = None
    """None: the quantity is computed from several drives."""


def metric(key: str) -> Callable[[SimulatedDrive], float]:
    """Return the function that computes a metric of a simulated drive."""
    return lambda driven: float(METRICS[key].function(record_of_simulated(driven)) or 0.0)


QUANTITIES = {
    "mse": Quantity("MSE [m2]", metric("mse_m2")),
    "rms": Quantity("RMS error [m]", metric("rms_error_m")),
    "max": Quantity("largest error [m]", metric("max_error_m")),
    "last_5_s": Quantity("RMS of the last 5 s [m]", metric("last_5_s_rms_m")),
    "last_3_s": Quantity("RMS of the last 3 s [m]", metric("last_3_s_rms_m")),
    "diverged": Quantity("number that diverged", metric("diverged")),
    "activity": Quantity("steering, RMS increment [deg]", metric("steering_rms_increment_deg")),
    "swing": Quantity("swing of the wheel [deg]", metric("steering_range_deg")),
    "overlap": Quantity("overlap with the cones [m]", overlap),
    "added": Quantity("added to the largest error [m]"),
    "fastest": Quantity("highest speed passed [km/h]"),
    "radius": Quantity("spectral radius"),
    "margin": Quantity("margin of unknown delay [s]"),
}
