"""How good gains are at a node of the table: a whole generation is one compiled call.

`fitness(node, gains)` is a pure function of what is pickled with ease: it may run in threads,
processes or on another machine. What a node needs is prepared once in each of them.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ControllerSettings
from ampc_ros.mpc.gain_table import Gains, GainTable
from ampc_ros.mpc.internal_model import believed as belief_of
from ampc_ros.mpc.programme import check_conditioning, scratch_numbers
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.tuning.drives import (
    PLANTS,
    ROADS,
    SETTLING_DEADLINE,
    Plant,
    nominal_vehicle,
    simulated_car,
    step_to,
)
from launch_scripts.tuning.fleet import CONVERGED, CROSS_TRACK_ERROR, STEERING, Array, Fleet
from launch_scripts.tuning.fleet_rows import Entry, FleetRun, prepare, run
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import Vehicle

SETTINGS = "table3"
"""Shipped limits under which gains are tuned."""
LOST = {"paper": 50.0, "robust": 10.0}
"""Cross-track error beyond which a drive has failed [m]; steps to 15 m overshoot."""
INCREMENT_WEIGHT = 1.0
"""Weight of the mean squared increment, as the way v T Delta u by which it moves the front wheels
sideways within a tick [m^2]."""
NEGLIGIBLE = 0.005
"""Error that is good enough: below it a drive gains little [m]."""
GENTLE = Gains(25, 20, 6, 0.3, 10.0, 100.0)
"""Any gains, of which a controller is made before it gets those of a particle."""
FITNESS = {
    "paper": "mean squared error [m^2] of a step to the node's lateral reference, 10 s",
    "robust": "geometric mean of average and worst, over drives on a lane change and of joining a "
    "road by cars that differ from the model, of the mean squared error + mean (v T Delta u)^2 "
    "+ (5 mm)^2 [m^2]",
}


class Node(NamedTuple):
    """A place in the table, and how gains are judged there."""

    vehicle: Vehicle
    formulation: str
    """`preview` or `paper`."""
    kind: str
    """Key of FITNESS."""
    speed: float
    """[m/s]."""
    reference: float = 0.0
    """Lateral reference of fitness `paper` [m]."""


def fitness(node: Node, gains: Sequence[Gains] | Array) -> Array:
    """Judge sets of gains.

    Args:
        node: Where, and how.
        gains: (n, 6), a set in each row.

    Returns:
        (n,) smaller is better; infinite where the car is lost, or a programme could not be solved.
    """
    rows = np.asarray(gains, dtype=float)
    sound = np.array([is_sound(node, row) for row in rows])
    result = np.full(len(rows), np.inf)
    if sound.any():
        result[sound] = judged(node, drives(node, rows[sound]))
    return result


def is_sound(node: Node, row: Array) -> bool:
    """Whether the controller would take these gains (6,)."""
    if node.formulation != "paper":
        return True
    belief = belief_of(prepared(node).fleet.numbers[0])
    try:
        check_conditioning(belief.vehicle, gains_of_row(row), belief.limits)
    except ValueError:
        return False
    return True


def gains_of_row(row: Array) -> Gains:
    """Read a row of numbers (6,)."""
    return Gains(int(row[0]), int(row[1]), int(row[2]), *map(float, row[3:]))


def drives(node: Node, rows: Array) -> Array:
    """Drive all cars of a node with each set of gains (n, 6): the log (n, cars, ticks, LOGGED)."""
    expedition = prepared(node)
    log = run(repeat_for_gain_sets(expedition, rows))
    return log.reshape(len(rows), len(expedition.fleet.road), *log.shape[1:])


def repeat_for_gain_sets(expedition: FleetRun, rows: Array) -> FleetRun:
    """Give the cars of an expedition once for each set of gains (n, 6)."""
    fleet, n = expedition.fleet, len(rows)
    many = {name: np.concatenate([getattr(fleet, name)] * n) for name in Fleet._fields[:-2]}
    many["nodes"] = np.repeat(rows, len(fleet.road), axis=0)[:, None, :]
    ticks = int(fleet.numbers[:, 15].max())
    sizes = [scratch_numbers(int(N_p) + ticks, int(N_c), int(N)) for N_p, N_c, N in rows[:, :3]]
    return expedition._replace(fleet=fleet._replace(**many), scratch_size=max(sizes))


def judged(node: Node, log: Array) -> Array:
    """Read the fitness (n,) off the log (n, cars, ticks, LOGGED); not finite where a car failed."""
    error, steering = log[..., CROSS_TRACK_ERROR], log[..., STEERING]
    failed = (~(log[..., CONVERGED] > 0.0)).any(axis=(1, 2))
    if node.kind == "paper":
        cost = np.mean(error**2, axis=(1, 2))
    else:
        period = prepared(node).period_ns / 1e9
        begin = [round(SETTLING_DEADLINE[plant.road] / period) for plant in PLANTS]
        squares = [np.mean(error[:, i, b:] ** 2, axis=1) for i, b in enumerate(begin)]
        way = node.speed * period * np.diff(steering, axis=2)
        effort = INCREMENT_WEIGHT * np.mean(way**2, axis=2)
        cost = combined(np.column_stack(squares) + effort + NEGLIGIBLE**2)
    return np.where(failed, np.inf, cost)


def combined(cost: Array) -> Array:
    """Give the geometric mean of average and worst of the drives (n, cars): (n,).

    Note:
        The average is geometric, too: half the error on a dry road counts as much as half the
        (far larger) error with a delay that nobody told the controller of.
    """
    average = np.exp(np.log(cost).mean(axis=1))
    return np.asarray(np.sqrt(average * cost.max(axis=1)))


@lru_cache(maxsize=1024)
def prepared(node: Node) -> FleetRun:
    """Lay out the cars and roads of a node; they stay as they are."""
    if node.kind == "paper":
        road = step_to(node.speed, node.reference)
        return prepare(
            [_entry(node, Plant("step"), simulated_car(Plant("step"), node.vehicle, road))],
            LOST[node.kind],
        )
    roads = {name: road(node.speed) for name, road in ROADS.items()}
    cars = [(plant, simulated_car(plant, node.vehicle, roads[plant.road])) for plant in PLANTS]
    return prepare([_entry(node, *car) for car in cars], LOST[node.kind])


def _entry(node: Node, plant: Plant, simulation: Simulation) -> Entry:
    settings = load(ControllerSettings, find("controllers", SETTINGS))
    table, known = GainTable([node.speed], [0.0], [GENTLE]), nominal_vehicle(plant, node.vehicle)
    if node.formulation == "paper":
        return Entry(simulation, LateralMpc(known.chassis, settings, table))
    return Entry(simulation, PreviewMpc(known.chassis, known.steering, settings, table))
