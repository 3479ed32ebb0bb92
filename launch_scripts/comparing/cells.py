"""The cells of a comparison: every controller on every road, with the same car and noise."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import as_received
from ampc_msgs_config.metrics import LOST, Drive, errors, evaluate, ticks
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from ampc_ros.controller_interface import Controller
from launch_scripts.run.simulated import SimulatedDrive
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.measurement import measured
from sim_vehicle.parameters import MeasurementNoise, load_vehicle

TIE = 0.005
"""Relative difference that the three digits shown hardly tell."""


class Quantity(NamedTuple):
    """Something to compare; less is better, or at least calmer."""

    key: str
    """In JSON."""
    label: str
    unit: str
    note: str = ""

    @property
    def heading(self) -> str:
        """Label with unit."""
        return f"{self.label} [{self.unit}]"


QUANTITIES = {
    "rms": Quantity("rms_error_m", "RMS cross-track error", "m"),
    "p95": Quantity("p95_error_m", "95 % of cross-track errors are below", "m"),
    "max": Quantity("max_error_m", "largest cross-track error", "m"),
    "mse": Quantity("mse_m2", "mean squared cross-track error", "m\u00b2"),
    "effort": Quantity(
        "steering_rms_increment_deg", "steering effort, RMS increment", "deg per tick"
    ),
    "acceleration": Quantity(
        "max_lateral_acceleration",
        "largest lateral acceleration",
        "m/s\u00b2",
        "Speed times yaw rate. The road asks for most of it.",
    ),
    "solve_time": Quantity(
        "solve_time_p50_us",
        "median time of a step",
        "\u00b5s",
        "Wall time of one step() called from Python, on whatever else this machine was doing: "
        "an order of magnitude, no benchmark (that is bench.py), and the only quantity that "
        "another run does not repeat.",
    ),
}
"""By the name that a user types."""


class Contender(NamedTuple):
    """A controller with its gains."""

    label: str
    controller: str
    gain_table: str
    """Shipped name or file; empty where the controller has none."""


class Conditions(NamedTuple):
    """What all cells share; friction, delay and noise are unknown to the controllers."""

    vehicle: str = "paper"
    settings: str = "table3"
    friction: float | None = None
    """Of the road; None: that of the tyres."""
    delay: float = 0.0
    """Of the real steering, on top of the vehicle's own [s]."""
    noise: str = ""
    seed: int = 0


class Cell(NamedTuple):
    """One controller on one road."""

    contender: str
    scenario: str
    numbers: dict[str, float]
    """By key of the quantities; empty where no drive was finished."""
    reason: str = ""
    """Why the controller gave up, in its own words."""
    gave_up_after: float = math.nan
    """[s]."""
    lost_after: float = math.nan
    """First time farther than LOST off the path; nan: never [s]."""
    driven: SimulatedDrive | None = None

    @property
    def kept(self) -> bool:
        """Whether the car was never lost and drove to the end."""
        return bool(self.numbers) and math.isnan(self.lost_after)

    @property
    def outcome(self) -> str:
        """What became of the drive, in a word or two."""
        if self.kept:
            return "driven"
        if self.numbers:
            return f"lost at {self.lost_after:.1f} s"
        return f"gave up at {self.gave_up_after:.1f} s" if self.gave_up_after else "refused"


class Watched(Simulation):
    """A simulation that notes at each tick where the car really is, whatever is measured."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Place the car; nothing is noted yet."""
        super().__init__(*arguments, **options)
        self.states: list[VehicleState] = []

    def advance(self, steering: float, target_speed: float, period_ns: int) -> None:
        """Note, then drive on."""
        to_rear_axle = -self.vehicle.chassis.cg_to_rear_axle
        stamp_ns = NANOSECONDS + self.elapsed_ns  # as `drive` counts
        self.states.append(as_received(measured(self.car.state, to_rear_axle, stamp_ns)))
        super().advance(steering, target_speed, period_ns)


def controller_of(contender: Contender, conditions: Conditions) -> Controller:
    """Make the controller, which believes in the car as its file describes it.

    Raises:
        ValueError: A file is missing or wrong, or its gains make the problem singular.
    """
    choices = Choices(
        contender.controller, conditions.vehicle, conditions.settings, contender.gain_table
    )
    return make_controller(choices)


def plant(conditions: Conditions, scenario: Scenario) -> Watched:
    """Place the real car; its noise begins with the same seed in every cell."""
    vehicle = load_vehicle(find("vehicles", conditions.vehicle))
    steering = replace(vehicle.steering, delay=vehicle.steering.delay + conditions.delay)
    noise = conditions.noise
    return Watched(
        vehicle._replace(steering=steering),
        scenario,
        friction=conditions.friction,
        noise=load(MeasurementNoise, find("noise", noise)) if noise else None,
        rng=np.random.default_rng(conditions.seed),
    )


def drive_cell(contender: Contender, scenario: Scenario, conditions: Conditions) -> Cell:
    """Drive one cell; a controller that refuses is an answer, not an error."""
    controller, simulation = controller_of(contender, conditions), plant(conditions, scenario)
    try:
        steered = drive(simulation, controller)
    except ValueError as error:
        driven_for = len(simulation.states) * controller.period
        return Cell(contender.label, scenario.name, {}, str(error), driven_for)
    return judge(contender.label, simulation, steered._replace(states=simulation.states))


def judge(label: str, simulation: Watched, finished: Drive) -> Cell:
    """Give the numbers of a drive, in which the states are the real ones."""
    scenario, vehicle = simulation.scenario, simulation.vehicle
    path, to_cg = scenario.path, vehicle.chassis.cg_to_rear_axle
    error = errors(finished, path, to_cg)[:, 0]
    time = ticks(finished)
    swing = [state.v_x * state.yaw_rate for state in finished.states]
    measures = evaluate(finished, path, to_cg, float(time[1]))
    measures["max_lateral_acceleration"] = float(np.abs(swing).max())
    numbers = {quantity.key: measures[quantity.key] for quantity in QUANTITIES.values()}
    gone = ~(np.abs(error) <= LOST)
    lost_after = float(time[np.argmax(gone)]) if gone.any() else math.nan
    driven = SimulatedDrive(finished, path, scenario, vehicle, error)
    return Cell(label, scenario.name, numbers, lost_after=lost_after, driven=driven)


def best_of(cells: list[Cell], key: str) -> set[str]:
    """Name the contenders with the smallest number among those that kept to the road.

    Those within TIE of it are as good; where all are, nobody is best.
    """
    numbers = {cell.contender: cell.numbers[key] for cell in cells if cell.kept}
    limit = (1.0 + TIE) * min(numbers.values(), default=math.nan)
    best = {name for name, value in numbers.items() if value <= limit}
    return set() if len(best) == len(cells) else best
