"""What the reproduction drives: roads, contenders, and the switches between paper and code."""

from dataclasses import replace
from typing import Any, NamedTuple

from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.metrics import LOST, errors, measure, record_of
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.scenarios.scenario import Scenario, load_scenario, speed_at
from ampc_msgs_config.types import NANOSECONDS, Command, Diagnosis, Plan, VehicleState
from ampc_ros.configuration import default_table
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.pure_pursuit import PurePursuit
from launch_scripts.run.simulated import SimulatedDrive
from sim_vehicle.closed_loop import Simulation, Steering, drive
from sim_vehicle.parameters import Vehicle, load_vehicle

TUNED_TABLE = "paper_pso"
"""Shipped gain table of the paper's formulation, tuned by particle swarm; may be missing."""
ROADS = {
    "sc1": "Sc1: double lane change at 9 m/s",
    "sc2": "Sc2: double lane change, varying speed",
    "sc3_constant": "Sc3: general path at 11 m/s",
    "sc3_varying": "Sc3: general path, varying speed",
    "sc3_wind": "Sc3: varying speed, side wind",
    "sc3_fast_wind": "Sc3 stretched, 18 m/s, side wind",
}
SHORT = {
    "sc1": "Sc1",
    "sc2": "Sc2",
    "sc3_constant": "Sc3, 11 m/s",
    "sc3_varying": "Sc3, varying",
    "sc3_wind": "Sc3, wind",
    "sc3_fast_wind": "Sc3, 18 m/s",
}
FIXED_SPEED = {road: 9.0 if road in ("sc1", "sc2") else 11.0 for road in ROADS}
"""Speed of a model that does not adapt: that at which the paper's scenario begins [m/s]."""
CONTENDERS = {
    "paper": "AMPC, Table 3",
    "paper_pso": "AMPC, PSO-tuned table",
    "paper_one": "AMPC, one PSO-tuned set",
    "classic": "classic MPC, Table 3",
    "classic_pso": "fixed MPC, PSO-tuned",
    "pure_pursuit": "pure pursuit, tuned",
    "preview": "preview (ours)",
}
FIXED = ("classic", "classic_pso")
"""Contenders whose model does not follow the speed."""
Authors = frozenset[str]
"""Names of the switches that stand at `authors_code`."""


class Switch(NamedTuple):
    """One difference between the paper and its authors' released code."""

    what: str
    paper: str
    authors_code: str
    drives: bool
    """Whether it changes a drive; otherwise it changes a search."""


SWITCHES = {
    "tyre": Switch(
        "lateral tyre of the plant",
        "Magic Formula",
        "linear, practically without friction limit (mu = 3), relaxation length 0.1 m",
        True,
    ),
    "plant": Switch("centre of gravity; track", "0.54 m; 1.55 m", "0.35 m; 1.4 m", True),
    "speed": Switch("speed that the controller gets", "measured", "reference", True),
    "horizon": Switch(
        "N_c", "ends the increments", "does not enter the cost (here N_c = N_p)", True
    ),
    "solver": Switch(
        "QP solver", "exact, to which Hildreth's method converges", "Hildreth, 38 sweeps", True
    ),
    "schedule": Switch(
        "c_1, c_2 of the swarm", "Eq. (34)", "always its last branch (a slip in their code)", False
    ),
    "sizes": Switch(
        "size of the search", "15 generations x 20", "5 generations x 10, inertia 0.9 to 0.4", False
    ),
    "bounds": Switch(
        "searched gains",
        "not given; ours are wide",
        "alpha 0.75-0.99, N 1-9, N_c 1-18, N_p 1-55, Q 0.1-10, R 0.001-0.1",
        False,
    ),
    "fitness": Switch(
        "fitness of gains",
        "MSE; on what is not said: here geometric mean over Sc1, Sc2, Sc3 varying",
        "MSE of a step to a constant set-point (3.5 m at 9 m/s)",
        False,
    ),
}


class Found(NamedTuple):
    """What the searches found for the contenders."""

    look_ahead: tuple[float, float]
    """Of pure pursuit: time [s], shortest distance [m]."""
    fixed: Gains
    """Best single set for a model that does not follow the speed."""
    adaptive: Gains
    """Best single set for the model at the measured speed."""


class Recorded:
    """A controller whose diagnoses are kept; it may be told the reference speed as measured."""

    def __init__(self, inner: Steering, scenario: Scenario, reference_speed: bool) -> None:
        """Listen to `inner`."""
        self.inner, self.period, self.scenario = inner, inner.period, scenario
        self.reference_speed = reference_speed
        self.diagnosis: list[Diagnosis] = []

    def step(self, state: VehicleState, path: Path) -> Plan | Command:
        """Answer a state."""
        if self.reference_speed:
            elapsed = len(self.diagnosis) * self.period
            state = state._replace(v_x=speed_at(self.scenario.speed, elapsed))
        command = self.inner.step(state, path)
        self.diagnosis.append(command.diagnosis)
        return command


def contenders() -> list[str]:
    """Names of those that can drive: the tuned table only where it is shipped."""
    return [name for name in CONTENDERS if name != "paper_pso" or TUNED_TABLE in shipped("gains")]


def plant_vehicle(authors: Authors) -> Vehicle:
    """Give the real car, the paper's."""
    vehicle = load_vehicle(find("vehicles", "paper"))
    if "tyre" in authors:
        tyre = replace(vehicle.tyre, model="linear", friction=3.0, relaxation_length=0.1)
        vehicle = vehicle._replace(tyre=tyre)
    if "plant" in authors:
        vehicle = vehicle._replace(body=replace(vehicle.body, cg_height=0.35, track=1.4))
    return vehicle


def settings_of(fixed_speed: float, authors: Authors) -> ControllerSettings:
    """Give limits and solver; the model follows the measured speed where `fixed_speed` is 0."""
    solver = "hildreth" if "solver" in authors else "active_set"
    settings = load(ControllerSettings, find("controllers", "table3"))
    return replace(settings, nominal_speed=fixed_speed, solver=solver)


def single(gains: Gains, authors: Authors) -> GainTable:
    """Give a table of one set that holds everywhere."""
    if "horizon" in authors:
        gains = gains._replace(control_horizon=gains.prediction_horizon)
    return GainTable([9.0], [0.0], [gains])


def table_of(name: str, found: Found, authors: Authors) -> GainTable:
    """Give the gains of a contender of the paper's formulation."""
    if name == "paper_pso":
        return load_gain_table(TUNED_TABLE)
    sets = {"paper_one": found.adaptive, "classic_pso": found.fixed}
    return single(sets.get(name, load_gain_table("table3").nodes[0]), authors)


def contender(name: str, fixed_speed: float, found: Found, authors: Authors) -> Steering:
    """Make a contender; it believes in the paper's car whatever the plant is."""
    car = load_vehicle(find("vehicles", "paper"))
    settings = settings_of(fixed_speed if name in FIXED else 0.0, authors)
    if name == "preview":
        exact = replace(settings, solver="active_set")
        table = load_gain_table(default_table("preview", "paper"))
        return PreviewMpc(car.chassis, car.steering, exact, table)
    if name == "pure_pursuit":
        time, distance = found.look_ahead
        chosen = replace(settings, look_ahead_time=time, min_look_ahead=distance)
        return PurePursuit(car.chassis, chosen)
    return LateralMpc(car.chassis, settings, table_of(name, found, authors))


def run(
    name: str, scenario: Scenario, found: Found, authors: Authors = frozenset(), **unknown: float
) -> SimulatedDrive:
    """Drive a scenario with a contender, which does not know of delay or lag of the steering."""
    vehicle = plant_vehicle(authors)
    vehicle = vehicle._replace(steering=replace(vehicle.steering, **unknown))
    inner = contender(name, FIXED_SPEED.get(scenario.name, 9.0), found, authors)
    steering = Recorded(inner, scenario, "speed" in authors and name.startswith("paper"))
    driven = drive(Simulation(vehicle, scenario), steering)
    path = scenario.path
    error = errors(driven, path, vehicle.chassis.cg_to_rear_axle)[:, 0]
    return SimulatedDrive(driven, path, scenario, vehicle, error, steering.diagnosis)


def road(name: str, **changes: Any) -> Scenario:
    """Give a shipped scenario for the paper's car, with some of its fields changed."""
    speed = changes.pop("speed", None)
    return load_scenario(name, load_vehicle(find("vehicles", "paper")).size, speed)._replace(
        **changes
    )


def numbers(driven: SimulatedDrive) -> dict[str, Any]:
    """Give what the page says of a drive, for JSON."""
    to_cg = driven.vehicle.chassis.cg_to_rear_axle
    period = (driven.drive.states[1].stamp_ns - driven.drive.states[0].stamp_ns) / NANOSECONDS
    keys = ("mse_m2", "mse_lateral_m2", "max_error_m", "steering_rms_increment_deg")
    record = record_of(driven.drive, driven.path, to_cg, period)
    measured = measure((*keys, "last_3_s_rms_m"), record)
    unsolved = sum(d.converged == 0.0 for d in driven.diagnosis)
    return {
        **measured,
        "unsolved_ticks": unsolved,
        "ticks": len(driven.error),
        "lost": bool((measured["max_error_m"] or 0.0) > LOST),
    }
