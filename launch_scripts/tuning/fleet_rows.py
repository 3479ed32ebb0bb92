"""From simulations and controllers to the matrices of a fleet, and from its log to drives."""

import math
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple
from functools import partial
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.compiled import announced
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.paths.path import NOT_CAUGHT
from ampc_msgs_config.paths.path_frame import PathFrame, path_frame
from ampc_msgs_config.scenarios.scenario import Scenario, wind_of_drive
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.tuning.fleet import (
    LOGGED,
    STATE,
    STEERING,
    Fleet,
    FleetTiming,
    Integers,
    Roads,
    drive_paper,
    drive_preview,
)
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import MeasurementNoise, flat_numbers
from sim_vehicle.vehicle import WORK_SIZE


class Entry(NamedTuple):
    """One car of a fleet."""

    simulation: Simulation
    """At its start."""
    controller: PreviewMpc | LateralMpc
    """As new."""
    misalignment: float = 0.0
    """Angle at which the wheels stand when straight ahead is commanded [rad]."""


class FleetRun(NamedTuple):
    """A fleet with its roads: all that a drive needs."""

    roads: Roads
    fleet: Fleet
    period_ns: int
    step_ns: int
    scratch_size: int
    preview: bool
    """Whether the controllers are of the `preview` formulation."""


def drive_all(entries: Sequence[Entry], threads: int = 1, lost: float = math.inf) -> list[Drive]:
    """Drive all cars; the same as `closed_loop.drive` for each of them.

    Args:
        entries: Cars with controllers of one kind, period and grid of gains, and one step.
        threads: In which the fleet is driven, in equal parts.
        lost: Cross-track error beyond which a drive ends [m].

    Raises:
        ValueError: A controller cannot take its path.
    """
    expedition = prepare(entries, lost)
    return [drive_of(log, expedition.period_ns) for log in run(expedition, threads)]


def prepare(entries: Sequence[Entry], lost: float = math.inf) -> FleetRun:
    """Lay cars, controllers and roads out in matrices; see `drive_all`."""
    first = entries[0]
    preview, period = isinstance(first.controller, PreviewMpc), first.controller.period
    period_ns, step_ns = round(period * NANOSECONDS), first.simulation.step_ns
    for entry in entries:
        same = isinstance(entry.controller, PreviewMpc) == preview
        same &= entry.controller.period == period and entry.simulation.step_ns == step_ns
        if not same:
            raise ValueError("fleet: controllers of one kind and period, and one step, are needed")
        for one, other in zip(entry.controller.table[:2], first.controller.table[:2], strict=True):
            if not np.array_equal(one, other):
                raise ValueError(f"fleet: one grid of gains is needed, not {one} and {other}")
    scenarios = list({id(entry.simulation.scenario): entry for entry in entries}.values())
    roads = lay_roads([e.simulation.scenario for e in scenarios], step_ns, period_ns, not preview)
    places = {id(entry.simulation.scenario): k for k, entry in enumerate(scenarios)}
    road: Integers = np.array([places[id(entry.simulation.scenario)] for entry in entries])
    fleet = line_up(entries, road, period_ns, lost)
    size = max(len(entry.controller.scratch.numbers) for entry in entries)
    return FleetRun(roads, fleet, period_ns, step_ns, size, preview)


def ticks_of(scenario: Scenario, period_ns: int) -> int:
    """Number of control periods in a drive."""
    return -(-round(scenario.duration * NANOSECONDS) // period_ns)


def lay_roads(scenarios: Sequence[Scenario], step_ns: int, period_ns: int, framed: bool) -> Roads:
    """Put drives one after the other.

    Args:
        scenarios: The drives.
        step_ns: Of the integration [ns].
        period_ns: Of the controllers [ns].
        framed: Whether the paths are needed in their inertial frames too.

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
    """Where each of several pieces begins, and where the last one ends."""
    return np.append(0, np.cumsum(lengths)).astype(np.int64)


def line_up(
    entries: Sequence[Entry],
    road: Integers,
    period_ns: int,
    lost: float,
) -> Fleet:
    """Put cars and controllers into rows; the memory and the noise are drawn from them."""
    cars = [entry.simulation.car for entry in entries]
    controllers = [entry.controller for entry in entries]
    ticks = np.array([ticks_of(e.simulation.scenario, period_ns) for e in entries])
    noises = [car.noise or MeasurementNoise() for car in cars]
    most = int(ticks.max()) if any(car.noise for car in cars) else 0
    tables = [controller.table for controller in controllers]
    return Fleet(
        road=road,
        ticks=ticks,
        plant=np.array([flat_numbers(entry.simulation.vehicle) for entry in entries]),
        state=np.array([car.state for car in cars]),
        waiting=padded([car.waiting for car in cars]),
        delay=np.array([len(car.waiting) for car in cars]),
        conditions=np.array(
            [(car.friction, e.misalignment, lost) for car, e in zip(cars, entries, strict=True)]
        ),
        noise=np.array([astuple(noise) for noise in noises]),
        normal=np.array(
            [car.rng.standard_normal((most, 6)) if car.rng else np.zeros((most, 6)) for car in cars]
        ),
        numbers=np.array([controller.numbers for controller in controllers]),
        memory=padded([controller.memory for controller in controllers]),
        nodes=np.array([table.nodes for table in tables]),
        speeds=tables[0].speeds,
        references=tables[0].references,
    )


def padded(rows: Sequence[Array]) -> Array:
    """Rows of several lengths as a matrix, zeros after their ends."""
    matrix = np.zeros((len(rows), max(map(len, rows))))
    for target, row in zip(matrix, rows, strict=True):
        target[: len(row)] = row
    return matrix


def run(expedition: FleetRun, threads: int = 1) -> Array:
    """Drive a fleet; its own matrices stay as they are.

    Returns:
        What happened, (n, most ticks, LOGGED); see `fleet`. Nan after the end of a drive.
    """
    fleet = expedition.fleet
    log = np.full((len(fleet.road), int(fleet.ticks.max()), LOGGED), np.nan)
    parts = [part for part in np.array_split(np.arange(len(log)), threads) if len(part)]
    say = partial(print, file=sys.stderr, flush=True)
    with ThreadPoolExecutor(threads) as pool, announced("fleet of cars", say):
        slices = [slice(part[0], part[-1] + 1) for part in parts]
        list(pool.map(lambda rows: run_part(expedition, rows, log[rows]), slices))
    return log


def run_part(expedition: FleetRun, rows: slice, log: Array) -> None:
    """Drive some rows of a fleet, on copies of what changes."""
    fleet = expedition.fleet
    own = {name: getattr(fleet, name)[rows].copy() for name in Fleet._fields[:-2]}
    clock = FleetTiming(
        expedition.period_ns,
        expedition.step_ns,
        make_scratch(expedition.scratch_size),
        np.zeros(WORK_SIZE),
        np.full(len(log), NOT_CAUGHT),
        np.zeros((0, 3)),
    )
    drive = drive_preview if expedition.preview else drive_paper
    drive(expedition.roads, fleet._replace(**own), log, clock)


def drive_of(log: Array, period_ns: int, start_ns: int = NANOSECONDS) -> Drive:
    """Read one car's log (most ticks, LOGGED)."""
    driven = log[~np.isnan(log[:, STATE])]
    states = [
        VehicleState(start_ns + tick * period_ns, *row)
        for tick, row in enumerate(driven[:, STATE:].tolist())
    ]
    return Drive(states, driven[:, STEERING].copy(), np.zeros(0))
