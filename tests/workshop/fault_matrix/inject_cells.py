"""Cells of the fault matrix: one fault on one road, with error and recovery of the car."""

import math
from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find
from ampc_msgs_config.metrics import LOST
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import NANOSECONDS, OPTIMAL, REASONS, RUNGS
from ampc_ros.configuration import Choices, Configuration, configuration
from ampc_ros.gate.core import Gate
from ampc_ros.gate.settings import GateSettings
from ampc_ros.supervision.supervisor import Supervisor
from launch_scripts.faults.schedule import Fault, FaultSchedule, Injector
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import Vehicle, load_vehicle_file
from tests.workshop.fault_matrix.fault_loop import ODOM_NS, FaultyDrive, Log
from tests.workshop.fault_matrix.inject_cases import Case, allowed_reason

EARLIEST = 1.0
"""Earliest start of a fault [s]."""
OBSERVED = 10.0
"""Minimum remaining time of a drive after a fault of 3 s [s]."""
NEAR, EXTRA = 0.1, 0.05
"""A car has recovered within NEAR of its path, or within EXTRA of its error without fault [m]."""
STANDING = 0.3
"""Speed below which a car counts as safe: the steering is held [m/s]."""
SETTLED = 0.5
"""Minimum duration of the recovered state at the end of the drive [s]."""


class Conditions(NamedTuple):
    """Settings of all cells."""

    controller: str = "preview"
    vehicle: str = "paper"
    guard: str = "track"
    seed: int = 0
    obey: bool = False
    gated: bool = True
    """Whether the gate passes the commands on."""


class Course(NamedTuple):
    """A road, and the drive without a fault."""

    scenario: Scenario
    start: float
    """Start of each fault, where the lateral acceleration is largest [s]."""
    free: Log


class Cell(NamedTuple):
    """Result of one fault on one road."""

    case: str
    scenario: str
    max_error: float
    """Largest cross-track error after the start of the fault [m]."""
    free_error: float
    """Largest cross-track error without the fault [m]."""
    recovery: float
    """Time to recover from the end of the fault; NaN: not recovered [s]."""
    lost_after: float
    """First time with an error above LOST; NaN: never [s]."""
    rungs: dict[str, float]
    """Time in each fallback after the start of the fault [s]."""
    reasons: tuple[str, ...]
    rejected: dict[str, int]
    """Number of rejected inputs by cause."""
    clips: dict[str, int]
    """Number of clipped commands by limit."""
    resets: int
    missed: int
    stop_requested: bool
    allowed_reason: str
    """Reason why the car may be lost; empty if it may not."""

    @property
    def kept(self) -> bool:
        """True if the car was never lost and has recovered."""
        return math.isnan(self.lost_after) and not math.isnan(self.recovery)

    @property
    def fails(self) -> bool:
        """True if the result is not allowed."""
        return not (self.kept or self.allowed_reason)

    @property
    def outcome(self) -> str:
        """Outcome as short text: time of loss, not recovered, or time of recovery."""
        if not math.isnan(self.lost_after):
            return f"lost at {self.lost_after:.1f} s"
        return "not recovered" if math.isnan(self.recovery) else f"{self.recovery:.1f} s"


class Bench:
    """Car and controller, created for each drive."""

    def __init__(self, conditions: Conditions) -> None:
        """Load vehicle and configuration.

        Raises:
            ValueError: A name is unknown, or a file is missing or wrong.
        """
        self.conditions = conditions
        self.vehicle: Vehicle = load_vehicle_file(find("vehicles", conditions.vehicle))
        self.config: Configuration = configuration(
            Choices(conditions.controller, conditions.vehicle, guard=conditions.guard)
        )

    def drive(self, scenario: Scenario, faults: tuple[Fault, ...]) -> FaultyDrive:
        """Return a drive at its start."""
        return FaultyDrive(
            Simulation(self.vehicle, scenario),
            Supervisor(self.config),
            Injector(FaultSchedule(faults, self.conditions.seed)),
            obey=self.conditions.obey,
            gate=self.gate() if self.conditions.gated else None,
        )

    def gate(self) -> Gate:
        """Return a gate with the guard of the controller."""
        config = self.config
        return Gate(config.guard, config.chassis, GateSettings(config.settings.sample_time))

    def log(self, scenario: Scenario, *faults: Fault) -> Log:
        """Drive to the end and return the log."""
        drive = self.drive(scenario, faults)
        drive.run(scenario.duration)
        return drive.log()

    def course(self, scenario: Scenario) -> Course:
        """Drive without a fault, and find the time of the largest lateral acceleration.

        Raises:
            ValueError: The controller cannot take the path.
        """
        free = self.log(scenario)
        if len(free.ticks) < 2:
            name = self.conditions.controller
            raise ValueError(f"--scenarios {scenario.name}: {name} cannot take this path")
        latest = max(scenario.duration - 3.0 - OBSERVED, EARLIEST)
        allowed = (free.time >= EARLIEST) & (free.time <= latest)
        worst = int(np.argmax(np.where(allowed, np.abs(np.round(free.swing, 6)), -1.0)))
        return Course(scenario, round(float(free.time[worst]), 1), free)

    def cell(self, case: Case, course: Course) -> Cell:
        """Drive with a fault and evaluate the drive."""
        fault = replace(case.fault, start=course.start)
        log = self.log(course.scenario, fault)
        return evaluate_cell(case.name, course, fault, log)


def evaluate_cell(name: str, course: Course, fault: Fault, log: Log) -> Cell:
    """Evaluate a drive with a fault."""
    since = log.time >= fault.start
    error, free = np.abs(log.error[since]), np.abs(course.free.error[since])
    gone = ~(error <= LOST)
    ticks = [tick for tick in log.ticks if tick.time >= fault.start]
    records = [tick.record for tick in ticks]
    rungs = Counter(RUNGS[each.command.rung] for each in records)
    period = log.ticks[1].time - log.ticks[0].time
    return Cell(
        name,
        course.scenario.name,
        float(error.max()),
        float(free.max()),
        recovery(log, course.free, fault.start + fault.duration),
        float(log.time[since][np.argmax(gone)]) if gone.any() else math.nan,
        {rung: round(rungs[rung] * period, 6) for rung in RUNGS},
        tuple(sorted({REASONS[each.command.reason] for each in records} - {"none"})),
        dict(sorted(log.rejected.items())),
        dict(sorted(log.clips.items())),
        int(records[-1].resets),
        log.missed,
        bool(records[-1].stop_requested),
        allowed_reason(name, course.scenario.name),
    )


def recovery(log: Log, free: Log, end: float) -> float:
    """Return the time from the end of a fault to the final recovery; NaN: not recovered [s]."""
    moves = log.speed > STANDING
    bad = moves & ~(np.abs(log.error) <= np.maximum(NEAR, np.abs(free.error) + EXTRA))
    low = [tick.time for tick in log.ticks if tick.record.command.rung != OPTIMAL]
    last = max([*log.time[bad].tolist(), *low, end])
    return math.nan if last > float(log.time[-1]) - SETTLED else after(last, end)


def after(last: float, end: float) -> float:
    """Return the time from the end of a fault to the first state without error [s]."""
    return 0.0 if last <= end else last - end + ODOM_NS / NANOSECONDS
