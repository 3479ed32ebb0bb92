"""Drives of the reproduction: scenarios, contenders, and the switches between paper and code."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import LOST, errors, measure, record_of
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import Scenario, load_scenario, speed_at
from ampc_msgs_config.types import NANOSECONDS, Command, Diagnosis, Plan, VehicleState
from ampc_ros.configuration import default_table
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.pure_pursuit import PurePursuit
from launch_scripts.run.simulated import SimulatedDrive
from launch_scripts.study.switches import WEAK, Switches
from sim_vehicle.closed_loop import Simulation, Steering, drive
from sim_vehicle.parameters import Vehicle, load_vehicle_file

STUDY_ROADS = {
    "sc1": "Sc1",
    "sc2": "Sc2",
    "sc3_constant": "Sc3, 11 m/s",
    "sc3_varying": "Sc3, varying",
    "sc3_wind": "Sc3, wind",
    "sc3_fast_wind": "Sc3, 18 m/s",
}
"""Short titles of the scenarios."""
FIXED_SPEED = {road: 9.0 if road in ("sc1", "sc2") else 11.0 for road in STUDY_ROADS}
"""Speed of a model that does not adapt: the initial speed of the paper's scenario [m/s]."""
CONTENDERS = {
    "paper": "AMPC, Table 3",
    "paper_pso": "AMPC, PSO-tuned table",
    "paper_one": "AMPC, one PSO-tuned set",
    "classic": "classic MPC, Table 3",
    "classic_pso": "fixed MPC, PSO-tuned",
    "pure_pursuit": "pure pursuit, tuned",
    "preview": "preview (ours)",
}
FIXED_CONTENDERS = ("classic", "classic_pso")
"""Contenders whose model does not follow the speed."""
WEAK_WEIGHTS = {"paper": 10.0, "classic": 1000.0}
"""R of AMPC and classic MPC in this reading; their other gains are those of Table 3."""
WEAK_LOOK_AHEAD = (3.0, 2.0)
"""Look-ahead of pure pursuit in this reading: time [s], minimum distance [m]."""
WEAK_LABELS = {
    "paper": "AMPC, R = 10",
    "classic": "classic MPC, R = 1000",
    "pure_pursuit": "pure pursuit, 3.0 s",
}


class TunedGains(NamedTuple):
    """Results of the searches that the contenders use."""

    look_ahead: tuple[float, float]
    """Look-ahead of pure pursuit: time [s], minimum distance [m]."""
    fixed: Gains
    """Best single set for a model that does not follow the speed."""
    adaptive: Gains
    """Best single set for the model at the measured speed."""


class DiagnosisRecorder:
    """Controller that stores the diagnosis of each step of another controller."""

    def __init__(self, inner: Steering, scenario: Scenario, reference_speed: bool) -> None:
        """Wrap `inner`; with `reference_speed` it receives the reference as measured speed."""
        self.inner, self.period, self.scenario = inner, inner.period, scenario
        self.reference_speed = reference_speed
        self.diagnosis: list[Diagnosis] = []

    def step(self, state: VehicleState, path: Path) -> Plan | Command:
        """Return the command of the wrapped controller."""
        if self.reference_speed:
            elapsed = len(self.diagnosis) * self.period
            state = state._replace(v_x=speed_at(self.scenario.speed, elapsed))
        command = self.inner.step(state, path)
        self.diagnosis.append(command.diagnosis)
        return command


@cache
def paper_car() -> Vehicle:
    """Return the paper's car."""
    return load_vehicle_file(find("vehicles", "paper"))


@cache
def table3_gains() -> Gains:
    """Return the gains of the paper's Table 3."""
    return load_gain_table("table3").nodes[0]


@cache
def table3_settings() -> ControllerSettings:
    """Return the limits of the paper's Table 3."""
    return load(ControllerSettings, find("controllers", "table3"))


def contender_labels(switches: Switches) -> dict[str, str]:
    """Return the names of the contenders for readers."""
    return CONTENDERS | (WEAK_LABELS if WEAK in switches else {})


def plant_vehicle(switches: Switches) -> Vehicle:
    """Return the simulated car: the paper's, or parts of it from the authors' code."""
    vehicle = paper_car()
    if "tyre" in switches:
        tyre = replace(vehicle.tyre, model="linear", friction=3.0, relaxation_length=0.1)
        vehicle = vehicle._replace(tyre=tyre)
    if "plant" in switches:
        vehicle = vehicle._replace(body=replace(vehicle.body, cg_height=0.35, track=1.4))
    return vehicle


def controller_settings(fixed_speed: float, switches: Switches) -> ControllerSettings:
    """Return limits and solver; with `fixed_speed` 0 the model follows the measured speed."""
    solver = "hildreth" if "solver" in switches else "active_set"
    settings = table3_settings()
    return replace(settings, nominal_speed=fixed_speed, solver=solver)


def constant_table(gains: Gains, switches: Switches) -> GainTable:
    """Return a gain table with one set for all speeds."""
    if "horizon" in switches:
        gains = gains._replace(control_horizon=gains.prediction_horizon)
    return GainTable([9.0], [0.0], [gains])


def build_contender(
    name: str, fixed_speed: float, tuned: TunedGains, switches: Switches
) -> Steering:
    """Return a contender; its internal model is the paper's car, whatever the plant is."""
    car = paper_car()
    settings = controller_settings(fixed_speed if name in FIXED_CONTENDERS else 0.0, switches)
    if name == "preview":
        exact = replace(settings, solver="active_set")
        table = load_gain_table(default_table("preview", "paper"))
        return PreviewMpc(car.chassis, car.steering, exact, table)
    if name == "pure_pursuit":
        time, distance = WEAK_LOOK_AHEAD if WEAK in switches else tuned.look_ahead
        chosen = replace(settings, look_ahead_time=time, min_look_ahead=distance)
        return PurePursuit(car.chassis, chosen)
    if name == "paper_pso":
        return LateralMpc(car.chassis, settings, load_gain_table("paper_pso"))
    sets = {"paper_one": tuned.adaptive, "classic_pso": tuned.fixed}
    gains = sets.get(name, table3_gains())
    if WEAK in switches and name in WEAK_WEIGHTS:
        gains = gains._replace(increment_weight=WEAK_WEIGHTS[name])
    return LateralMpc(car.chassis, settings, constant_table(gains, switches))


def drive_contender(
    name: str,
    scenario: Scenario,
    tuned: TunedGains,
    switches: Switches = frozenset(),
    **unmodelled: float,
) -> SimulatedDrive:
    """Drive a scenario with a contender.

    Args:
        name: Key of CONTENDERS.
        scenario: Scenario to drive.
        tuned: Results of the searches.
        switches: Differences that are taken from the authors' code.
        unmodelled: Fields of the steering that the controller does not model: delay, lag [s].
    """
    vehicle = plant_vehicle(switches)
    vehicle = vehicle._replace(steering=replace(vehicle.steering, **unmodelled))
    inner = build_contender(name, FIXED_SPEED.get(scenario.name, 9.0), tuned, switches)
    steering = DiagnosisRecorder(inner, scenario, "speed" in switches and name.startswith("paper"))
    driven = drive(Simulation(vehicle, scenario), steering)
    path = make_path(scenario.points)
    error = errors(driven, path, vehicle.chassis.cg_to_rear_axle)[:, 0]
    return SimulatedDrive(driven, path, scenario, vehicle, error, steering.diagnosis)


def study_scenario(name: str, **changes: Any) -> Scenario:
    """Return a shipped scenario for the paper's car with some of its fields changed."""
    speed = changes.pop("speed", None)
    size = paper_car().size
    return load_scenario(name, size, speed)._replace(**changes)


def drive_metrics(driven: SimulatedDrive) -> dict[str, Any]:
    """Return the metrics of a drive that `results.json` contains."""
    to_cg = driven.vehicle.chassis.cg_to_rear_axle
    period = (driven.drive.states[1].stamp_ns - driven.drive.states[0].stamp_ns) / NANOSECONDS
    keys = ("mse_m2", "mse_lateral_m2", "max_error_m", "steering_rms_increment_deg")
    record = record_of(driven.drive, driven.path, to_cg, period)
    metrics = measure((*keys, "last_3_s_rms_m"), record)
    return {
        **metrics,
        "unsolved_ticks": sum(d.converged == 0.0 for d in driven.diagnosis),
        "ticks": len(driven.error),
        "lost": bool((metrics["max_error_m"] or 0.0) > LOST),
    }


def metrics_of(
    names: Sequence[str],
    scenario: Scenario,
    tuned: TunedGains,
    switches: Switches,
    **steering: float,
) -> dict[str, dict[str, Any]]:
    """Return the metrics of some contenders in a scenario."""
    return {
        n: drive_metrics(drive_contender(n, scenario, tuned, switches, **steering)) for n in names
    }


def largest_error(driven: SimulatedDrive) -> float:
    """Return the largest absolute cross-track error [m]."""
    return float(np.abs(driven.error).max())


def mean_square_errors(
    name: str, roads: Sequence[str], tuned: TunedGains, switches: Switches
) -> dict[str, float]:
    """Return the mean squared error of a contender by road [m^2]."""
    drives = {r: drive_contender(name, study_scenario(r), tuned, switches) for r in roads}
    return {road: float(np.mean(np.square(each.error))) for road, each in drives.items()}
