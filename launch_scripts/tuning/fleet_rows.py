"""Convert simulations and controllers to the matrices of a fleet, and its log to drives."""

import math
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.compilation import log_compilation
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.paths.path import NOT_CAUGHT
from ampc_msgs_config.paths.path_frame import PathFrame, path_frame
from ampc_msgs_config.scenarios.scenario import Scenario, wind_of_drive
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.tuning.fleet import (
    LOG_STATE,
    LOG_STEERING,
    LOGGED,
    Fleet,
    FleetContext,
    Integers,
    Roads,
    drive_paper,
    drive_preview,
)
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.measurement import Deviations
from sim_vehicle.parameters import MeasurementNoise
from sim_vehicle.vehicle import WORK_SIZE
from sim_vehicle.vehicle_row import pack_vehicle


class Entry(NamedTuple):
    """One car of a fleet with its controller."""

    simulation: Simulation
    """Car at the start of its scenario."""
    controller: PreviewMpc | LateralMpc
    """Controller before its first step."""
    misalignment: float = 0.0
    """Road-wheel angle when straight ahead is commanded [rad]."""
    effect: float = 1.0
    """Factor on the commanded angle, unknown to the controller."""


class FleetRun(NamedTuple):
    """Fleet with its roads, complete enough to drive it repeatedly."""

    roads: Roads
    fleet: Fleet
    speeds: Array
    """(a,) speeds of the gain tables [m/s]."""
    references: Array
    """(b,) lateral references of the gain tables [m]."""
    period_ns: int
    step_ns: int
    scratch_size: int
    preview: bool
    """Whether the controllers use the `preview` formulation."""


def drive_fleet(entries: Sequence[Entry], threads: int = 1, lost: float = math.inf) -> list[Drive]:
    """Drive all cars; the result is that of `closed_loop.drive` for each of them.

    Args:
        entries: Cars with controllers of the same formulation, period, gain grid and step.
        threads: Number of threads that drive equal parts of the fleet.
        lost: Cross-track error beyond which a drive ends [m].

    Raises:
        ValueError: A controller cannot follow its path, or has a learned schedule.
    """
    fleet_run = prepare_fleet(entries, lost)
    return [drive_of_log(log, fleet_run.period_ns) for log in run_fleet(fleet_run, threads)]


def prepare_fleet(entries: Sequence[Entry], lost: float = math.inf) -> FleetRun:
    """Arrange cars, controllers and roads in matrices; see `drive_fleet`."""
    first = entries[0]
    preview, period = isinstance(first.controller, PreviewMpc), first.controller.period
    period_ns, step_ns = round(period * NANOSECONDS), first.simulation.step_ns
    for entry in entries:
        same = isinstance(entry.controller, PreviewMpc) == preview
        same &= entry.controller.period == period and entry.simulation.step_ns == step_ns
        if not same:
            raise ValueError("fleet: controllers must have the same formulation, period and step")
        if getattr(entry.controller, "schedule", None):
            raise ValueError("fleet: the gains of a car are constant, it cannot have a schedule")
        for one, other in zip(entry.controller.table[:2], first.controller.table[:2], strict=True):
            if not np.array_equal(one, other):
                raise ValueError(f"fleet: gain grids must be the same, not {one} and {other}")
    scenarios = {id(entry.simulation.scenario): entry.simulation.scenario for entry in entries}
    roads = pack_roads(list(scenarios.values()), step_ns, period_ns, not preview)
    keys = list(scenarios)
    road: Integers = np.array([keys.index(id(entry.simulation.scenario)) for entry in entries])
    return FleetRun(
        roads=roads,
        fleet=pack_fleet(entries, road, period_ns, lost),
        speeds=first.controller.table.speeds,
        references=first.controller.table.references,
        period_ns=period_ns,
        step_ns=step_ns,
        scratch_size=max(len(entry.controller.scratch.numbers) for entry in entries),
        preview=preview,
    )


def pack_roads(scenarios: Sequence[Scenario], step_ns: int, period_ns: int, framed: bool) -> Roads:
    """Concatenate the roads of several drives.

    Args:
        scenarios: The drives.
        step_ns: Integration step [ns].
        period_ns: Period of the controllers [ns].
        framed: Whether the paths are needed in their inertial frames as well.

    Raises:
        ValueError: A path is no graph over its chord, but is needed as one.
    """
    paths = [scenario.path for scenario in scenarios]
    nowhere = [PathFrame(0.0, 0.0, 0.0, 0.0 * path.x, 0.0 * path.x) for path in paths]
    frames = [path_frame(path) for path in paths] if framed else nowhere
    wind = [wind_of_drive(scenario, step_ns, period_ns) for scenario in scenarios]
    speeds = [scenario.speed for scenario in scenarios]
    return Roads(
        np.hstack([(p.x, p.y, p.heading, p.curvature) for p in paths]),
        np.hstack([(f.X, f.Y) for f in frames]),
        starts([len(p.x) for p in paths]),
        np.array([(p.spacing, p.closed, *f[:3]) for p, f in zip(paths, frames, strict=True)]),
        np.hstack([(s.at, s.speed) for s in speeds]),
        starts([len(s.at) for s in speeds]),
        np.array([(s.over_distance, s.period) for s in speeds], dtype=float),
        np.vstack(wind),
        starts([len(w) for w in wind]),
    )


def starts(lengths: Sequence[int]) -> Integers:
    """Return the start of each of several concatenated pieces, and the end of the last."""
    return np.append(0, np.cumsum(lengths)).astype(np.int64)


def pack_fleet(entries: Sequence[Entry], road: Integers, period_ns: int, lost: float) -> Fleet:
    """Return the rows of cars and controllers; the measurement noise is drawn here."""
    cars = [entry.simulation.car for entry in entries]
    controllers = [entry.controller for entry in entries]
    durations = [entry.simulation.scenario.duration for entry in entries]
    ticks = np.array([-(-round(each * NANOSECONDS) // period_ns) for each in durations])
    noises = [car.noise or MeasurementNoise() for car in cars]
    most = int(ticks.max()) if any(car.noise for car in cars) else 0
    normal = [
        car.rng.standard_normal((most, 6)) if car.rng else np.zeros((most, 6)) for car in cars
    ]
    return Fleet(
        road=road,
        ticks=ticks,
        plant=np.array([pack_vehicle(entry.simulation.vehicle) for entry in entries]),
        state=np.array([car.state for car in cars]),
        waiting=padded([car.waiting for car in cars]),
        delay=np.array([len(car.waiting) for car in cars]),
        friction=np.array([car.friction for car in cars]),
        misalignment=np.array([entry.misalignment for entry in entries]),
        effect=np.array([entry.effect for entry in entries]),
        lost=np.full(len(entries), lost),
        noise=np.array([Deviations(*astuple(noise)) for noise in noises]),
        normal=np.array(normal),
        model=np.array([controller.model_row for controller in controllers]),
        memory=padded([controller.memory for controller in controllers]),
        nodes=np.array([controller.table.nodes for controller in controllers]),
    )


def padded(rows: Sequence[Array]) -> Array:
    """Return rows of different lengths as a matrix, padded with zeros."""
    matrix = np.zeros((len(rows), max(map(len, rows))))
    for target, row in zip(matrix, rows, strict=True):
        target[: len(row)] = row
    return matrix


def map_rows(fleet: Fleet, change: Callable[[Any], Any]) -> Fleet:
    """Return a fleet whose arrays have all been changed by the same function."""
    return Fleet._make(map(change, fleet))


def run_fleet(fleet_run: FleetRun, threads: int = 1) -> Array:
    """Drive a fleet; its own matrices are not changed.

    Returns:
        Log (n, most ticks, LOGGED), see `fleet`; nan after the end of a drive.
    """
    fleet = fleet_run.fleet
    log = np.full((len(fleet.road), int(fleet.ticks.max()), LOGGED), np.nan)
    parts = [part for part in np.array_split(np.arange(len(log)), threads) if len(part)]
    print_line = partial(print, file=sys.stderr, flush=True)
    with ThreadPoolExecutor(threads) as pool, log_compilation("fleet of cars", print_line):
        slices = [slice(part[0], part[-1] + 1) for part in parts]
        list(pool.map(lambda rows: run_part(fleet_run, rows, log[rows]), slices))
    return log


def run_part(fleet_run: FleetRun, rows: slice, log: Array) -> None:
    """Drive some rows of a fleet, on copies of the arrays."""
    context = FleetContext(
        period_ns=fleet_run.period_ns,
        step_ns=fleet_run.step_ns,
        speeds=fleet_run.speeds,
        references=fleet_run.references,
        scratch=make_scratch(fleet_run.scratch_size),
        work=np.zeros(WORK_SIZE),
        places=np.full(len(log), NOT_CAUGHT),
        predicted=np.zeros((0, 3)),
    )
    own = map_rows(fleet_run.fleet, lambda array: array[rows].copy())
    drive_fleet_part = drive_preview if fleet_run.preview else drive_paper
    drive_fleet_part(fleet_run.roads, own, log, context)


def drive_of_log(log: Array, period_ns: int, start_ns: int = NANOSECONDS) -> Drive:
    """Return the drive in the log (most ticks, LOGGED) of one car."""
    driven = log[~np.isnan(log[:, LOG_STATE])]
    states = [
        VehicleState(start_ns + tick * period_ns, *row)
        for tick, row in enumerate(driven[:, LOG_STATE:].tolist())
    ]
    return Drive(states, driven[:, LOG_STEERING].copy(), np.zeros(0))
