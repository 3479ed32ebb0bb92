"""Drives and searches behind the paper's claim over speed: lane changes with four controllers."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ampc_msgs_config.metrics import LOST
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import Array
from ampc_ros.mpc.gain_table import Gains, GainTable
from ampc_ros.paper.controller import LateralMpc
from launch_scripts.study.drives import (
    STUDY_ROADS,
    controller_settings,
    paper_car,
    plant_vehicle,
    study_scenario,
    table3_gains,
)
from launch_scripts.study.switches import Switches
from launch_scripts.tuning.drives import Plant, lane_change, simulated_car
from launch_scripts.tuning.fitness import gains_of_row, repeat_for_gain_sets
from launch_scripts.tuning.fleet import CROSS_TRACK_ERROR, Integers
from launch_scripts.tuning.fleet_rows import Entry, FleetRun, prepare_fleet, run_fleet
from launch_scripts.tuning.methods import SearchRecord, run_method
from launch_scripts.tuning.task import Bounds, geometric_mean, search_space

CLAIM_PLANTS = (
    Plant("nominal"),
    Plant("50 ms unknown delay", delay=0.05),
    Plant("stiffness -20 %", stiffness=0.8),
    Plant("stiffness +20 %", stiffness=1.2),
    Plant("noise", seed=1),
)
"""The five drives at each speed, with the Magic Formula. The last one is repeated in a search."""
UNSEEN_SEED = 1001
"""Seed of the noise at the first speed of the evaluation; the next speed has the next seed."""
LINEAR = "nominal, linear tyre"
"""Drive beside the five, with the linear tyre of the authors' code; in no mean over drives."""
CLAIM_MODEL_SPEED = 9.0
"""Speed of the model of the classic MPC [m/s]."""
CLAIM_GAINS = Gains(25, 12, 3, 0.3, 10.0, 100.0)
"""Horizons, terms and Q are the same at every speed; pole and increment weight are searched."""
POLE_BOUNDS, INCREMENT_WEIGHT_BOUNDS = (0.0, 0.9), (1e-2, 1e4)
CLAIM_CONTENDERS = {
    "classic": "classic MPC, model at 9 m/s",
    "table3": "adaptive model, Table 3",
    "single": "adaptive model, single set",
    "table": "adaptive model, table",
}
CLAIM_ROADS = ("sc1", "sc2", "sc3_constant", "sc3_varying")
"""Roads of the paper on which the found gains are driven, too; no search has seen them."""
CLAIM_RATIOS = {
    "model": ("classic", "table3"),
    "one set": ("table3", "single"),
    "gains": ("single", "table"),
}
"""Adaptation of the model, tuning of one set, adaptation of the gains: errors that are divided."""
Flags = npt.NDArray[np.bool_]


class ClaimPlan(NamedTuple):
    """Extent of the measurement."""

    nodes: tuple[float, ...] = tuple(np.linspace(3.0, 27.0, 11).round(1).tolist())
    """Speeds of the table [m/s]; the speeds half-way are driven, too."""
    evaluations: int = 56
    """Evaluations of the search at each node, and of the single set on all nodes."""
    noise_seeds: int = 4
    """Repetitions of the drive with noise in a search; their mean error counts."""
    pole_change: float = 0.15
    """Largest change of the pole from node to node: sets of different valleys are not mixed."""
    seed: int = 1

    @property
    def steps(self) -> int:
        """Number of steps that `measure_claim` reports."""
        return 1 + len(self.nodes) + 1

    @property
    def speeds(self) -> list[float]:
        """Speeds of the evaluation [m/s]: nodes, and half-way between them."""
        between = [round((a + b) / 2, 3) for a, b in pairwise(self.nodes)]
        return sorted([*self.nodes, *between])


class FoundGains(NamedTuple):
    """Result of a search."""

    gains: Gains
    fitness: float
    """[m^2]."""


class ClaimErrors(NamedTuple):
    """Errors of several drives."""

    mse: Array
    """Mean squared cross-track error [m^2]."""
    lost: Flags
    """Whether the car was lost, same shape."""


def measure_claim(plan: ClaimPlan, step: Callable[[], None]) -> dict[str, Any]:
    """Search for gains and drive all contenders; return the results for JSON."""
    single, table = search_claim_gains(plan, step)
    table3 = [table3_gains()]
    rows = {"classic": table3, "table3": table3, "single": [single.gains]}
    rows["table"] = [found.gains for found in table]
    controllers = [
        claim_controller(plan.nodes, gains, CLAIM_MODEL_SPEED if name == "classic" else 0.0)
        for name, gains in rows.items()
    ]
    mse, lost = drive_claim(controllers, plan.speeds)
    roads = {plant: drive_claim_roads(controllers, plant) for plant in CLAIM_PLANTS[:2]}
    step()
    five, at_node = len(CLAIM_PLANTS), np.isin(plan.speeds, plan.nodes)
    groups = {"nodes": at_node, "between": ~at_node, "all": at_node | True}
    every = [plant.name for plant in CLAIM_PLANTS] + [LINEAR]

    def part(speeds: Any, drives: Any) -> dict[str, Any]:
        return claim_summary(mse[:, speeds][:, :, drives], lost[:, speeds][:, :, drives])

    return {
        "speeds": [
            {"speed_mps": v, "node": bool(at_node[k]), **part([k], slice(five))}
            for k, v in enumerate(plan.speeds)
        ],
        "means": {name: part(chosen, slice(five)) for name, chosen in groups.items()},
        "drives": {name: part(slice(None), [k]) for k, name in enumerate(every)},
        "roads": {
            f"{STUDY_ROADS[road]}, {plant.name}": claim_summary(mse[:, [k]], lost[:, [k]])
            for plant, (mse, lost) in roads.items()
            for k, road in enumerate(CLAIM_ROADS)
        },
        "gains": {
            "single": single.gains._asdict(),
            "table": [found.gains._asdict() for found in table],
        },
        "search": {
            "fitness_m2": {"single": single.fitness, "table": [row.fitness for row in table]},
            "evaluations_per_node": plan.evaluations,
            "seed": plan.seed,
        },
    }


def claim_summary(mse: Array, lost: Flags) -> dict[str, Any]:
    """Return mean errors, number of lost drives and ratios; arguments (contenders, ...)."""
    means, count = geometric_mean(mse.reshape(len(mse), -1).T), lost.reshape(len(mse), -1).sum(1)
    mean = dict(zip(CLAIM_CONTENDERS, means.tolist(), strict=True))
    return {
        "mse_m2": mean,
        "lost": dict(zip(CLAIM_CONTENDERS, count.tolist(), strict=True)),
        "ratio": {name: mean[a] / mean[b] for name, (a, b) in CLAIM_RATIOS.items()},
    }


def search_claim_gains(
    plan: ClaimPlan, step: Callable[[], None]
) -> tuple[FoundGains, list[FoundGains]]:
    """Search for the best single set, and for the best set of each node from low to high speed."""
    nodes = [prepare_claim_node(speed, plan.noise_seeds) for speed in plan.nodes]

    def best_gains(chosen: Sequence[FleetRun], key: int, poles: Bounds) -> FoundGains:
        def cost(positions: Array) -> Array:
            gains = space.gains_at(positions)
            return geometric_mean(np.array([claim_cost(node, gains) for node in chosen]))

        space = search_space({"alpha": poles, "R": INCREMENT_WEIGHT_BOUNDS}, CLAIM_GAINS)
        record = SearchRecord(cost, space.dimensions, plan.evaluations)
        position, fitness = run_method("pso", record, np.random.default_rng([plan.seed, key])).best
        step()
        return FoundGains(gains_of_row(space.gains_at(position[None])[0]), fitness)

    single, table, poles = (
        best_gains(nodes, len(nodes), POLE_BOUNDS),
        list[FoundGains](),
        POLE_BOUNDS,
    )
    for k, node in enumerate(nodes):
        table.append(best_gains([node], k, poles))
        pole, (low, high) = table[-1].gains.laguerre_pole, POLE_BOUNDS
        poles = max(low, pole - plan.pole_change), min(high, pole + plan.pole_change)
    return single, table


def prepare_claim_node(speed: float, noise_seeds: int) -> FleetRun:
    """Return the fleet of a search at a speed [m/s], with placeholder gains."""
    controller, road = claim_controller([speed], [CLAIM_GAINS]), claim_road(speed)
    *plants, noisy = CLAIM_PLANTS
    plants += [noisy._replace(seed=1 + k) for k in range(noise_seeds)]
    car = plant_vehicle(frozenset())
    return prepare_fleet([Entry(simulated_car(p, car, road), controller) for p in plants], LOST)


def claim_cost(node: FleetRun, gains: Array) -> Array:
    """Return the geometric mean over the five drives of the MSE (n,) of gain sets (n, 6) [m^2]."""
    fleet_run = repeat_for_gain_sets(node, gains)
    mse = claim_errors(run_fleet(fleet_run, 2), fleet_run.fleet.ticks).mse
    mse, single = mse.reshape(len(gains), -1), len(CLAIM_PLANTS) - 1
    return geometric_mean(np.vstack((mse[:, :single].T, mse[:, single:].mean(axis=1))))


def drive_claim(controllers: Sequence[LateralMpc], speeds: Sequence[float]) -> ClaimErrors:
    """Drive all controllers at all speeds [m/s] with noise that no search has seen.

    Returns:
        Errors (controllers, speeds, drives), the last of which is LINEAR.
    """
    car, linear = plant_vehicle(frozenset()), plant_vehicle(Switches({"tyre"}))
    cars, roads = list[Entry](), [claim_road(speed) for speed in speeds]
    for controller in controllers:
        for k, road in enumerate(roads):
            seen = [plant._replace(seed=plant.seed and UNSEEN_SEED + k) for plant in CLAIM_PLANTS]
            cars += [Entry(simulated_car(plant, car, road), controller) for plant in seen]
            cars.append(Entry(simulated_car(Plant(LINEAR), linear, road), controller))
    mse, lost = drive_claim_cars(cars)
    shape = len(controllers), len(speeds), len(CLAIM_PLANTS) + 1
    return ClaimErrors(mse.reshape(shape), lost.reshape(shape))


def drive_claim_roads(controllers: Sequence[LateralMpc], plant: Plant) -> ClaimErrors:
    """Drive all controllers on CLAIM_ROADS with one plant; return errors (controllers, roads)."""
    roads, car = [study_scenario(road) for road in CLAIM_ROADS], paper_car()
    cars = [Entry(simulated_car(plant, car, road), c) for c in controllers for road in roads]
    mse, lost = drive_claim_cars(cars)
    shape = len(controllers), len(roads)
    return ClaimErrors(mse.reshape(shape), lost.reshape(shape))


def drive_claim_cars(cars: Sequence[Entry]) -> ClaimErrors:
    """Drive cars until they are lost; return their errors (n,)."""
    fleet_run = prepare_fleet(cars, LOST)
    return claim_errors(run_fleet(fleet_run, 2), fleet_run.fleet.ticks)


def claim_controller(
    nodes: Sequence[float], gains: Sequence[Gains], fixed_speed: float = 0.0
) -> LateralMpc:
    """Return a controller with a table over speed, or with one set at all of its nodes.

    Args:
        nodes: Speeds of the nodes [m/s].
        gains: A set per node, or one for all.
        fixed_speed: Speed of the model [m/s]; 0: the measured one.
    """
    chassis = paper_car().chassis
    rows = list(gains) * (len(nodes) if len(gains) == 1 else 1)
    settings = controller_settings(fixed_speed, frozenset())
    return LateralMpc(chassis, settings, GainTable(list(nodes), [0.0], rows))


def claim_road(speed: float) -> Scenario:
    """Return the lane change of the tuner at a speed [m/s], without its offset and its gust."""
    return lane_change(speed)._replace(wind=(), start_offset=0.0)


def claim_errors(log: Array, ticks: Integers) -> ClaimErrors:
    """Return the errors (n,) of a log (n, most ticks, LOGGED); missing ticks count with LOST.

    Args:
        log: Log of a fleet.
        ticks: (n,) number of ticks of each drive.
    """
    error = log[..., CROSS_TRACK_ERROR]
    error = np.where(np.isnan(error), LOST, error)
    error[np.arange(log.shape[1]) >= ticks[:, None]] = 0.0
    return ClaimErrors(np.sum(error**2, axis=1) / ticks, np.abs(error).max(axis=1) >= LOST)
