"""Trials: one drive of a car and a controller with unknown disturbances, and its metrics."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.interpolate import CubicSpline

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.metrics import METRICS, Drive, DriveRecord, errors, ticks
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings, SteeringParameters
from ampc_msgs_config.paths.path_file import SpeedLimits, from_csv
from ampc_msgs_config.scenarios.scenario import Scenario, load_scenario
from ampc_ros.configuration import default_table
from ampc_ros.mpc.gain_table import load_gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.run.simulated import SimulatedDrive
from launch_scripts.tuning.fleet_rows import Entry, drive_fleet
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import MeasurementNoise, Vehicle, load_vehicle_file
from tests.workshop.acceptance.independent_plant import (
    Disturbance,
    IndependentSimulation,
    assumed_parameters,
)
from tests.workshop.acceptance.road_data import DATA

LIMITS = SpeedLimits(lateral_acceleration=4.0, longitudinal_acceleration=2.0, speed=30.0)
"""Speed limits on recorded roads."""
LAPS = 2
INDEPENDENT = 2
"""CommonRoad number of the independent plant, a BMW 320i."""
FINE = 20
"""Number of outlines of the car per tick, and of points along its sides."""


class Trial(NamedTuple):
    """One drive. The fields from `factors` on are unknown to the controller."""

    scenario: str = "sc1"
    """Name of a shipped scenario, or CSV file in `road_data.DATA`."""
    car: str = "paper"
    """Name of a shipped vehicle, or `independent`."""
    speed: float | None = None
    """Speed that replaces that of the scenario [m/s]."""
    offset: float = 0.0
    """Initial offset to the left of the path [m]."""
    known_delay: float = 0.0
    """Steering delay that the controller knows [s]."""
    known_lag: float = 0.0
    """Steering lag that the controller knows [s]."""
    factors: tuple[tuple[str, float], ...] = ()
    """Factors on chassis parameters of the actual car, by name."""
    delay: float = 0.0
    """Steering delay in addition to the known one [s]."""
    friction: float | None = None
    """Friction of the road; on the independent plant a factor on the friction of its tyres."""
    seed: int | None = None
    """Seed of the measurement noise `x1`; None: no noise."""
    misaligned_deg: float = 0.0
    """Angle of the wheels when straight ahead is commanded."""
    gust: tuple[float, float] = (0.0, 0.0)
    """Side force [N] and yaw moment [N m] on the independent plant."""


OTHER_TABLES: dict[str, str] = {}
"""Gain tables of `preview` by vehicle that replace the shipped ones, see `--gain-table`."""


def shipped_controller(
    name: str, car: str, chassis: ChassisParameters, steering: SteeringParameters
) -> PreviewMpc | LateralMpc:
    """Build the controller `preview` or `paper` with the gains shipped for a car."""
    settings = load(ControllerSettings, find("controllers", "table3"))
    shipped_name = default_table(name, car)
    own = OTHER_TABLES.get(car, shipped_name) if name == "preview" else shipped_name
    table = load_gain_table(own)
    if name == "preview":
        return PreviewMpc(chassis, steering, settings, table)
    return LateralMpc(chassis, settings, table)


def run(trial: Trial, name: str) -> SimulatedDrive:
    """Drive a trial with a controller; see `run_all`."""
    return run_all([trial], name)[0]


def run_all(trials: Sequence[Trial], name: str) -> list[SimulatedDrive]:
    """Drive trials with a controller, as one fleet or sequentially on the independent plant.

    Raises:
        ValueError: The controller cannot take a path.
    """
    vehicles = [assumed_vehicle(trial) for trial in trials]
    scenarios = [scenario_of(*pair) for pair in zip(trials, vehicles, strict=True)]
    entries = [
        Entry(
            plant(trial, vehicle, scenario),
            shipped_controller(name, trial.car, vehicle.chassis, vehicle.steering),
            math.radians(trial.misaligned_deg),
        )
        for trial, vehicle, scenario in zip(trials, vehicles, scenarios, strict=True)
    ]
    if any(trial.car == "independent" for trial in trials):
        drives = [drive(entry.simulation, entry.controller) for entry in entries]
    else:
        drives = drive_fleet(entries)
    return [with_errors(*each) for each in zip(drives, scenarios, vehicles, strict=True)]


def with_errors(finished: Drive, scenario: Scenario, vehicle: Vehicle) -> SimulatedDrive:
    """Return a drive with its cross-track errors."""
    path = scenario.path
    error = errors(finished, path, vehicle.chassis.cg_to_rear_axle)[:, 0]
    return SimulatedDrive(finished, path, scenario, vehicle, error)


def assumed_vehicle(trial: Trial) -> Vehicle:
    """Return the vehicle that the controller assumes."""
    independent = trial.car == "independent"
    vehicle = load_vehicle_file(find("vehicles", "ordinary" if independent else trial.car))
    if independent:
        chassis, steering = assumed_parameters(INDEPENDENT)
        return vehicle._replace(chassis=chassis, steering=steering)
    known = replace(vehicle.steering, delay=trial.known_delay, lag=trial.known_lag)
    return vehicle._replace(steering=known)


def scenario_of(trial: Trial, vehicle: Vehicle) -> Scenario:
    """Return the scenario of a trial."""
    if trial.scenario.endswith(".csv"):
        return from_csv(DATA / trial.scenario, trial.speed, LIMITS, LAPS)
    scenario = load_scenario(trial.scenario, vehicle.size, trial.speed)
    return scenario._replace(start_offset=trial.offset)


def plant(trial: Trial, vehicle: Vehicle, scenario: Scenario) -> Simulation:
    """Return the simulation of the actual car at the start of the drive."""
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
    """Return the largest overlap of the car with a row of cones; negative is clearance [m].

    Cubic splines interpolate the poses between the ticks; the rows of cones have no gaps.
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


def record_of_simulated(driven: SimulatedDrive) -> DriveRecord:
    """Return the input of the metrics, without heading errors and Y - Y_ref(X)."""
    time, states = ticks(driven.drive), driven.drive.states
    return DriveRecord(
        time,
        float(time[1]),
        driven.error,
        speed=np.array([state.v_x for state in states]),
        yaw_rate=np.array([state.yaw_rate for state in states]),
        steering=driven.drive.steering,
        solve_time=driven.drive.solve_time,
    )


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
    "radius": Quantity("spectral radius, estimate held"),
    "estimator_radius": Quantity("spectral radius, with the estimator"),
    "margin": Quantity("margin of unknown delay, linear [s]"),
    "small_margin": Quantity("the same, simulated car, decays from 0.02 m [s]"),
    "large_margin": Quantity("the same, simulated car, settles from 0.5 m [s]"),
    "asked": Quantity("lateral acceleration of the road [m/s2]"),
    "reached": Quantity("lateral acceleration that the car reaches [m/s2]"),
    "demand": Quantity("the first in percent of the second"),
}
