"""Searches of the reproduction: a fair look-ahead, the best single gains, and a sweep of R."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.config import find
from ampc_msgs_config.metrics import Drive, errors
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import Array
from ampc_ros.mpc.gain_table import Gains, load_gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.pso.minimize import at_once, minimize
from ampc_ros.pso.settings import Dimension, PsoSettings
from launch_scripts.study.cases import (
    FIXED_SPEED,
    Authors,
    Found,
    plant_vehicle,
    road,
    run,
    settings_of,
    single,
)
from launch_scripts.tuning.fleet_rows import Entry, drive_fleet
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import Vehicle, load_vehicle

TASK = ("sc1", "sc2", "sc3_varying")
"""What gains and look-ahead are tuned on; the other roads are held out."""
TIMES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3)
"""Look-ahead times that are tried [s]."""
DISTANCES = (2.0, 4.0, 6.0)
"""Shortest look-ahead distances that are tried [m]."""
GIVEN_UP = 10.0
"""A drive ends at this cross-track error, which its remaining ticks then count as [m]."""
WEIGHTS = (1e-3, 1e-2, 1e-1, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4)
"""R of the sweep, Q = 10."""
SPACE = {
    "paper": ((0.0, 0.9), (1, 6), (1, 30), (5, 60), (-1.0, 2.0), (-3.0, 3.0)),
    "authors_code": ((0.75, 0.99), (1, 9), (1, 18), (1, 55), (-1.0, 1.0), (-3.0, -1.0)),
}
"""Bounds of alpha, N, N_c, N_p and the decadic logarithms of Q and R."""
NAMES = ("alpha", "N", "N_c", "N_p", "log10 Q", "log10 R")


class Tuned(NamedTuple):
    """Result of one search for gains."""

    gains: Gains
    fitness: float
    history: Array
    evaluations: int


def geometric_mean(values: Sequence[float]) -> float:
    """Give the geometric mean, in which no scenario outweighs the others."""
    return float(np.exp(np.mean(np.log(values))))


def mean_square(drive: Drive, scenario: Scenario, to_cg: float, period: float) -> float:
    """Give the MSE of a drive that may have been given up [m^2]."""
    error = errors(drive, scenario.path, to_cg)[:, 0]
    missing = max(round(scenario.duration / period) - len(error), 0)
    return float((np.sum(error**2) + missing * GIVEN_UP**2) / (len(error) + missing))


def tune_look_ahead(roads: Sequence[str], authors: Authors) -> tuple[Found, list[dict[str, Any]]]:
    """Try all look-aheads of the grid; gives the best, and every trial."""
    table3 = load_gain_table("table3").nodes[0]
    scenarios, trials = [road(name) for name in roads], list[dict[str, Any]]()
    for pair in product(TIMES, DISTANCES):
        found = Found(pair, table3, table3)
        drives = [run("pure_pursuit", scenario, found, authors) for scenario in scenarios]
        mse = {s.name: float(np.mean(d.error**2)) for s, d in zip(scenarios, drives, strict=True)}
        fitness = geometric_mean(list(mse.values()))
        trials.append({"time_s": pair[0], "distance_m": pair[1], "fitness_m2": fitness, "mse": mse})
    best = min(trials, key=lambda trial: float(trial["fitness_m2"]))
    return Found((best["time_s"], best["distance_m"]), table3, table3), trials


def dimensions(authors: Authors) -> list[Dimension]:
    """Give what is searched for."""
    bounds = SPACE["authors_code" if "bounds" in authors else "paper"]
    return [
        Dimension(name, *pair, integer=name in ("N", "N_c", "N_p"))
        for name, pair in zip(NAMES, bounds, strict=True)
    ]


def gains_of(position: Array) -> Gains:
    """Read gains off a position; N and N_c are kept below N_p, as the authors' code does."""
    alpha, N, N_c, N_p, log_Q, log_R = position.tolist()
    return Gains(int(N_p), int(min(N_c, N_p)), int(min(N, N_p)), alpha, 10.0**log_Q, 10.0**log_R)


def swarm_settings(authors: Authors) -> PsoSettings:
    """Give Table 2 of the paper, or what its authors' code has."""
    variant = "authors_code" if "schedule" in authors else "proposed"
    if "sizes" in authors:
        return PsoSettings(
            variant=variant, generations=5, particles=10, max_inertia=0.9, min_inertia=0.4
        )
    return PsoSettings(variant=variant)


def step_road() -> Scenario:
    """Give the step of the authors' fitness: a straight road, joined from 3.5 m at 9 m/s."""
    return road("straight", start_offset=-3.5)


class Task(NamedTuple):
    """What gains are judged on."""

    plant: Vehicle
    scenarios: list[Scenario]
    settings: list[ControllerSettings]
    """Of the controller, for each scenario."""
    authors: Authors

    def entries(self, gains: Gains) -> list[Entry]:
        """Give a car for each scenario; refuses gains that are numerically singular."""
        chassis, table = (
            load_vehicle(find("vehicles", "paper")).chassis,
            single(gains, self.authors),
        )
        return [
            Entry(Simulation(self.plant, scenario), LateralMpc(chassis, chosen, table))
            for scenario, chosen in zip(self.scenarios, self.settings, strict=True)
        ]


def fitness_of(fixed: bool, roads: Sequence[str], authors: Authors) -> Callable[[Array], Array]:
    """Give the fitness of a generation (n, 6) of gains [m^2]; infinite where they are singular."""
    stepping = "fitness" in authors
    scenarios = [step_road()] if stepping else [road(name) for name in roads]
    speeds = [FIXED_SPEED.get(s.name, 9.0) if fixed else 0.0 for s in scenarios]
    settings = [settings_of(speed, authors) for speed in speeds]
    task = Task(plant_vehicle(authors), scenarios, settings, authors)

    def fitness(positions: Array) -> Array:
        result, cars = np.full(len(positions), np.inf), dict[int, list[Entry]]()
        for k, position in enumerate(positions):
            with suppress(ValueError):
                cars[k] = task.entries(gains_of(position))
        everybody = [entry for row in cars.values() for entry in row]
        drives = iter(drive_fleet(everybody, 2, GIVEN_UP) if everybody else [])
        for k, row in cars.items():
            result[k] = geometric_mean([judge(next(drives), entry) for entry in row])
        return result

    return fitness


def judge(drive: Drive, entry: Entry) -> float:
    """Give the MSE of one car of the fleet [m^2]."""
    simulation, period = entry.simulation, entry.controller.period
    to_cg = simulation.vehicle.chassis.cg_to_rear_axle
    return mean_square(drive, simulation.scenario, to_cg, period)


def tune(
    fixed: bool,
    roads: Sequence[str],
    authors: Authors,
    seed: int,
    report: Callable[[], None] = lambda: None,
    **changes: Any,
) -> Tuned:
    """Search for the best single gains with the paper's swarm.

    Args:
        fixed: Whether the model does not follow the speed.
        roads: Tuned on these.
        authors: Switches.
        seed: Of the swarm.
        report: Called after every generation.
        changes: Of the swarm's settings.
    """
    evaluate = fitness_of(fixed, roads, authors)

    def counted(positions: Array) -> Array:
        values = evaluate(positions)
        report()
        return values

    settings = PsoSettings(**{**vars(swarm_settings(authors)), **changes})
    rng = np.random.default_rng(seed)
    best = minimize(counted, dimensions(authors), settings, rng, at_once)
    gains = gains_of(best.position)
    return Tuned(gains, best.fitness, best.history, int(best.evaluations[-1]))


def sweep(roads: Sequence[str], authors: Authors) -> list[dict[str, Any]]:
    """Give the MSE of the AMPC over the increment weight R, all else from Table 3 [m^2]."""
    table3 = load_gain_table("table3").nodes[0]
    rows = []
    for R in WEIGHTS:
        found = Found((0.6, 4.0), table3, table3._replace(increment_weight=R))
        drives = {name: run("paper_one", road(name), found, authors) for name in roads}
        mse = {name: float(np.mean(np.square(d.error))) for name, d in drives.items()}
        rows.append({"R": R, "mse_m2": mse})
    return rows
