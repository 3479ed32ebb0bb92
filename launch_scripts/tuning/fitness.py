"""Fitness of gains at a node of the gain table: a whole generation is one compiled call.

`fitness(node, gains)` is a pure function of values that can be pickled, so it may run in threads,
processes or on another machine. The fleet of a node is prepared once in each process.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.types import Array
from ampc_ros.mpc.gain_table import Gains, GainTable
from ampc_ros.mpc.internal_model import unpack_internal_model
from ampc_ros.mpc.qp_solver import scratch_numbers
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.paper.qp_assembly import check_conditioning
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.tuning.choices import SETTINGS
from launch_scripts.tuning.drives import (
    CURVATURE,
    HELD_OUT,
    PLANTS,
    ROADS,
    SETTLING_DEADLINE,
    STRAIGHT_CURVATURE,
    Plant,
    lane_change,
    nominal_vehicle,
    simulated_car,
    step_to,
)
from launch_scripts.tuning.fleet import CONVERGED, CROSS_TRACK_ERROR, LOG_STEERING
from launch_scripts.tuning.fleet_rows import (
    Entry,
    FleetRun,
    map_rows,
    prepare_fleet,
    run_fleet,
)
from sim_vehicle.parameters import Vehicle

REFERENCE_PERIOD = 0.1
"""Time over which an increment is measured, so that the fitness does not depend on the rate [s]."""
JUDGED = "held-out"
"""Kind of the fitness `robust` on the held-out plants, which no search uses."""
SITUATION = "situation"
"""Kind of the fitness `robust` at one curvature and latency, for learned schedules."""
LOST_ERROR = {"paper": 50.0, "robust": 10.0, JUDGED: 10.0, SITUATION: 10.0}
"""Cross-track error beyond which a drive has failed, by kind of fitness [m].

The larger one leaves room for the overshoot of steps to 15 m."""
INCREMENT_WEIGHT = 1.0
"""Weight of the mean squared increment. The increment is measured as the lateral displacement
v T Delta u of the front wheels in T = REFERENCE_PERIOD [m]."""
NEGLIGIBLE = 0.005
"""Error below which a further reduction hardly improves the fitness [m]."""
GENTLE = Gains(25, 20, 6, 0.3, 10.0, 100.0)
"""Placeholder gains of a controller before it receives those of a particle."""


class Node(NamedTuple):
    """Node of a gain table, and the kind of fitness."""

    vehicle: Vehicle
    formulation: str
    """`preview` or `paper`."""
    kind: str
    """Key of FITNESS."""
    speed: float
    """[m/s]."""
    reference: float = 0.0
    """Lateral reference of fitness `paper` [m]."""
    settings: str = SETTINGS
    """Shipped controller settings, or file."""
    curvature: float = CURVATURE
    """Largest curvature of the lane change [1/m]."""

    @property
    def plants(self) -> tuple[Plant, ...]:
        """Drives that determine the fitness."""
        if self.kind == "paper":
            return (Plant("step", "step"),)
        if self.kind == SITUATION:
            return tuple(plant for plant in PLANTS if occurs(plant, self.curvature))
        return HELD_OUT if self.kind == JUDGED else PLANTS


def fitness(node: Node, gains: Sequence[Gains] | Array) -> Array:
    """Compute the fitness of gain sets.

    Args:
        node: Node and kind of fitness.
        gains: (n, 6), one set per row.

    Returns:
        (n,) smaller is better; infinite if a car is lost or a QP could not be solved.
    """
    rows = np.asarray(gains, dtype=float)
    accepted = np.array([is_accepted(node, row) for row in rows])
    result = np.full(len(rows), np.inf)
    if accepted.any():
        result[accepted] = fitness_of_log(node, drive_gain_sets(node, rows[accepted]))
    return result


def occurs(plant: Plant, curvature: float) -> bool:
    """Return whether a plant belongs to a situation: known latency is part of its vehicle.

    A straight road is joined where the curvature is at most STRAIGHT_CURVATURE.
    """
    is_own = plant.known_delay == plant.known_lag == 0.0
    return is_own and (plant.road == "lane change" or curvature <= STRAIGHT_CURVATURE)


def is_accepted(node: Node, row: Array) -> bool:
    """Return whether the controller accepts these gains (6,)."""
    if node.formulation != "paper":
        return True
    model = unpack_internal_model(prepared(node).fleet.model[0])
    try:
        check_conditioning(model.vehicle, gains_of_row(row), model.limits)
    except ValueError:
        return False
    return True


def gains_of_row(row: Array) -> Gains:
    """Return the gains in a row of numbers (6,)."""
    return Gains(int(row[0]), int(row[1]), int(row[2]), *map(float, row[3:]))


def drive_gain_sets(node: Node, rows: Array) -> Array:
    """Drive all cars of a node with each gain set (n, 6); return (n, cars, ticks, LOGGED)."""
    fleet_run = prepared(node)
    log = run_fleet(repeat_for_gain_sets(fleet_run, rows))
    return log.reshape(len(rows), len(fleet_run.fleet.road), *log.shape[1:])


def repeat_for_gain_sets(fleet_run: FleetRun, rows: Array) -> FleetRun:
    """Return a fleet in which all cars are repeated for each gain set (n, 6)."""
    cars, n = len(fleet_run.fleet.road), len(rows)
    fleet = map_rows(fleet_run.fleet, lambda array: np.concatenate([array] * n))
    fleet = fleet._replace(nodes=np.repeat(rows, cars, axis=0)[:, None, :])
    ticks = max(unpack_internal_model(row).actuator.ticks for row in fleet_run.fleet.model)
    sizes = [scratch_numbers(int(N_p) + ticks, int(N_c), int(N)) for N_p, N_c, N in rows[:, :3]]
    return fleet_run._replace(fleet=fleet, scratch_size=max(sizes))


def fitness_of_log(node: Node, log: Array) -> Array:
    """Return the fitness (n,) of a log (n, cars, ticks, LOGGED); infinite if a car failed."""
    error, steering = log[..., CROSS_TRACK_ERROR], log[..., LOG_STEERING]
    failed = (~(log[..., CONVERGED] > 0.0)).any(axis=(1, 2))
    if node.kind == "paper":
        cost = np.mean(error**2, axis=(1, 2))
    else:
        period = prepared(node).period_ns / 1e9
        begin = [round(SETTLING_DEADLINE[plant.road] / period) for plant in node.plants]
        squares = [np.mean(error[:, i, b:] ** 2, axis=1) for i, b in enumerate(begin)]
        rate = np.diff(steering, axis=2) / period
        way = node.speed * REFERENCE_PERIOD**2 * rate
        effort = INCREMENT_WEIGHT * np.mean(way**2, axis=2)
        cost = combined(np.column_stack(squares) + effort + NEGLIGIBLE**2)
    return np.where(failed, np.inf, cost)


def combined(cost: Array) -> Array:
    """Return the geometric mean (n,) of average and worst cost of the drives (n, cars).

    Note:
        The average is geometric as well: halving the error on a dry road counts as much as halving
        the much larger error with a delay that is unknown to the controller.
    """
    average = np.exp(np.log(cost).mean(axis=1))
    return np.asarray(np.sqrt(average * cost.max(axis=1)))


@lru_cache(maxsize=1024)
def prepared(node: Node) -> FleetRun:
    """Return the fleet of a node, which is prepared once and never changed."""
    roads = {name: road(node.speed) for name, road in ROADS.items()}
    roads["lane change"] = lane_change(node.speed, node.curvature)
    roads["step"] = step_to(node.speed, node.reference)
    settings = load(ControllerSettings, find("controllers", node.settings))
    entries = []
    for plant in node.plants:
        known, table = (
            nominal_vehicle(plant, node.vehicle),
            GainTable([node.speed], [0.0], [GENTLE]),
        )
        controller: LateralMpc | PreviewMpc
        if node.formulation == "paper":
            controller = LateralMpc(known.chassis, settings, table)
        else:
            controller = PreviewMpc(known.chassis, known.steering, settings, table)
        car = simulated_car(plant, node.vehicle, roads[plant.road])
        entries.append(Entry(car, controller, plant.misalignment))
    return prepare_fleet(entries, LOST_ERROR[node.kind])
