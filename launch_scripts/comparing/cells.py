"""Cells of a comparison: every controller on every road, with the same car and noise."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import as_received
from ampc_msgs_config.metrics import LOST, measure, record_of, ticks
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import NANOSECONDS, Plan, VehicleState
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from ampc_ros.controller_interface import Controller
from launch_scripts.comparing.conditions import COMPARED_METRICS, Conditions
from launch_scripts.run.simulated import SimulatedDrive
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.measurement import measured
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file

TIE = 0.005
"""Relative difference below which two numbers count as equal; three digits are displayed."""


class Contender(NamedTuple):
    """A controller with its gains."""

    label: str
    controller: str
    """Shipped name, or `file.py:Class`."""
    gain_table: str
    """Shipped name or file; empty for a controller without gains."""


class Cell(NamedTuple):
    """One controller on one road."""

    contender: str
    scenario: str
    numbers: dict[str, float]
    """By key of the metrics; empty if the controller ended the drive."""
    reason: str = ""
    """Message with which the controller ended the drive."""
    gave_up_after: float = math.nan
    """[s]."""
    lost_after: float = math.nan
    """First time at which the error exceeds LOST; nan: never [s]."""
    driven: SimulatedDrive | None = None

    @property
    def kept(self) -> bool:
        """Whether the car completed the drive and was never lost."""
        return bool(self.numbers) and math.isnan(self.lost_after)

    @property
    def outcome(self) -> str:
        """Outcome of the drive in a few words."""
        if self.numbers:
            return "driven" if self.kept else f"lost at {self.lost_after:.1f} s"
        return f"gave up at {self.gave_up_after:.1f} s" if self.gave_up_after else "refused"

    @property
    def hatch(self) -> str:
        """Hatch of the heat map: lost, or without a drive."""
        return "" if self.kept else "////" if self.numbers else "xxx"


class TrueStateSimulation(Simulation):
    """A simulation that records the true state at each tick, without measurement noise."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Place the car at the start; see `Simulation`."""
        super().__init__(*arguments, **options)
        self.states: list[VehicleState] = []

    def advance(self, steering: float, target_speed: float, period_ns: int) -> None:
        """Record the state, then simulate one period."""
        to_rear_axle = -self.vehicle.chassis.cg_to_rear_axle
        stamp_ns = NANOSECONDS + self.elapsed_ns  # equals the stamps of `drive`
        self.states.append(as_received(measured(self.car.state, to_rear_axle, stamp_ns)))
        super().advance(steering, target_speed, period_ns)


class EndsAtFailure:
    """Controller that ends the drive where a user's class fails; others pass unchanged."""

    def __init__(self, inner: Controller) -> None:
        """Wrap a controller."""
        self.inner, self.period = inner, inner.period

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Return the plan of the controller.

        Raises:
            ValueError: The class of a user raised an error, or returned no finite angle.
        """
        plan = self.inner.step(state, path)
        if self.inner.failure:
            raise ValueError(self.inner.failure)
        return plan


def controller_of(contender: Contender, conditions: Conditions) -> Controller:
    """Build a controller with a model of the car as its file describes it.

    Raises:
        ValueError: A file is missing or invalid, or its gains make the problem singular.
    """
    _, controller, gains = contender
    return make_controller(Choices(controller, conditions.vehicle, conditions.settings, gains))


def build_simulation(conditions: Conditions, scenario: Scenario) -> TrueStateSimulation:
    """Build the simulated car; its noise starts with the same seed in every cell."""
    vehicle = load_vehicle_file(find("vehicles", conditions.vehicle))
    steering = replace(vehicle.steering, delay=vehicle.steering.delay + conditions.delay)
    noise = conditions.noise
    return TrueStateSimulation(
        vehicle._replace(steering=steering),
        scenario,
        friction=conditions.friction,
        noise=load(MeasurementNoise, find("noise", noise)) if noise else None,
        rng=np.random.default_rng(conditions.seed),
    )


def drive_cell(contender: Contender, scenario: Scenario, conditions: Conditions) -> Cell:
    """Drive one cell; a controller that raises a ValueError ends the drive with this reason."""
    controller = controller_of(contender, conditions)
    simulation = build_simulation(conditions, scenario)
    try:
        steered = drive(simulation, EndsAtFailure(controller))
    except ValueError as error:
        driven_for = len(simulation.states) * controller.period
        return Cell(contender.label, scenario.name, {}, str(error), driven_for)
    finished, vehicle = steered._replace(states=simulation.states), simulation.vehicle
    time, path = ticks(finished), scenario.path
    record = record_of(finished, path, vehicle.chassis.cg_to_rear_axle, float(time[1]))
    measures = measure(COMPARED_METRICS.values(), record)
    numbers = {key: math.nan if value is None else value for key, value in measures.items()}
    gone = ~(np.abs(record.error) <= LOST)
    lost_after = float(time[np.argmax(gone)]) if gone.any() else math.nan
    driven = SimulatedDrive(finished, path, scenario, vehicle, record.error)
    return Cell(contender.label, scenario.name, numbers, lost_after=lost_after, driven=driven)


def best_of(cells: list[Cell], key: str) -> set[str]:
    """Return the contenders with the smallest number among the completed drives.

    Numbers within TIE of the smallest one count as equal to it; if all are equal, the set is empty.
    """
    numbers = {cell.contender: cell.numbers[key] for cell in cells if cell.kept}
    limit = (1.0 + TIE) * min(numbers.values(), default=math.nan)
    best = {name for name, value in numbers.items() if value <= limit}
    return set() if len(best) == len(cells) else best
