"""Measurements of the reproduction: searches, drives, sweeps, faults, wind, test functions."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.metrics import Drive, errors
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.pso.minimize import map_vectorized, minimize
from ampc_ros.pso.swarm import Dimension
from launch_scripts.run.simulated import SimulatedDrive
from launch_scripts.study.attempts import measure_attempts
from launch_scripts.study.drives import (
    CONTENDERS,
    FIXED_SPEED,
    STUDY_ROADS,
    TunedGains,
    constant_table,
    controller_settings,
    drive_contender,
    drive_metrics,
    largest_error,
    mean_square_errors,
    metrics_of,
    paper_car,
    plant_vehicle,
    study_scenario,
    table3_gains,
)
from launch_scripts.study.pso_methods import (
    METHODS,
    PROBLEMS,
    READINGS,
    final_quartiles,
    ordering_bars,
    reading_medians,
    search_curves,
)
from launch_scripts.study.pso_variants import VariantSettings
from launch_scripts.study.speed_sweep import ClaimPlan, measure_claim
from launch_scripts.study.switches import DRIVE_SWITCHES, SEARCH_SWITCHES, WEAK, Switches
from launch_scripts.study.weak_baselines import measure_weak_baselines
from launch_scripts.tuning.fleet_rows import Entry, drive_fleet
from launch_scripts.tuning.task import geometric_mean
from sim_vehicle.closed_loop import Simulation

TUNING_ROADS = ("sc1", "sc2", "sc3_varying")
"""Gains and look-ahead are tuned on these roads; the others are held out."""
LOOK_AHEAD_TIMES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3)
"""Grid of the look-ahead search [s]."""
LOOK_AHEAD_DISTANCES = (2.0, 4.0, 6.0)
"""Minimum distances in the grid of the look-ahead search [m]."""
ABORT_ERROR = 10.0
"""Cross-track error that ends a drive of a search; its remaining ticks count with it [m]."""
INCREMENT_WEIGHTS = (1e-3, 1e-2, 1e-1, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4)
"""R of the sweep, Q = 10."""
GAIN_BOUNDS = {
    "paper": ((0.0, 0.9), (1, 6), (1, 30), (5, 60), (-1.0, 2.0), (-3.0, 3.0)),
    "authors_code": ((0.75, 0.99), (1, 9), (1, 18), (1, 55), (-1.0, 1.0), (-3.0, -1.0)),
}
"""Bounds of alpha, N, N_c, N_p and the decadic logarithms of Q and R."""
GAIN_NAMES = ("alpha", "N", "N_c", "N_p", "log10 Q", "log10 R")
SWARMS = ("proposed", "linear", "damped", "classic", "fitted linear", "Zhan's adaptive")
StepCallback = Callable[[], None]
"""Called after each of the steps that `count_steps` counts."""


class StudyPlan(NamedTuple):
    """Extent of a reproduction."""

    switches: Switches
    """Switches of all measurements: choices of the authors' code, and WEAK."""
    roads: tuple[str, ...] = tuple(STUDY_ROADS)
    tuning_roads: tuple[str, ...] = TUNING_ROADS
    tuning_seeds: tuple[int, ...] = (1, 2, 3)
    swarm: tuple[tuple[str, int], ...] = ()
    """Changed settings of the swarm that tunes the gains."""
    sphere_seeds: int = 51
    problems: int = len(PROBLEMS)
    single_switches: tuple[str, ...] = DRIVE_SWITCHES
    """Switches whose effect is measured one at a time."""
    claim: ClaimPlan = ClaimPlan()
    """Speeds and searches of the claim over speed, always in the paper's reading."""


def study_plan(
    switches: Switches, quick: bool = False, sphere_seeds: int | None = None
) -> StudyPlan:
    """Return the plan of a complete or quick run, with the default number of swarms or another."""
    plan = quick_plan(switches) if quick else StudyPlan(switches)
    return plan._replace(sphere_seeds=sphere_seeds) if sphere_seeds else plan


def quick_plan(switches: Switches) -> StudyPlan:
    """Return the plan of a quick run: two roads and a tiny search."""
    swarm = (("particles", 3), ("generations", 1))
    claim = ClaimPlan((5.4, 15.0), evaluations=6, noise_seeds=1)
    return StudyPlan(switches, ("sc1", "sc2"), ("sc1",), (1,), swarm, 5, 2, ("solver",), claim)


def count_steps(plan: StudyPlan) -> int:
    """Return the number of steps that `measure_study` reports."""
    moves = sum(swarm_settings(s, plan).generations + 1 for _, s, _ in gain_searches(plan))
    return 1 + moves + len(plan.roads) + len(plan.single_switches) + 2 + 4 + plan.claim.steps


def measure_study(
    plan: StudyPlan, step: StepCallback
) -> tuple[dict[str, Any], dict[str, dict[str, SimulatedDrive]]]:
    """Return all results for JSON, and the drives for the figures by road and contender."""
    # searches: look-ahead, then the best single gain sets
    tuned, searches = search_gains(plan, step)
    # every contender on every road, with wind also in calm air
    driven: dict[str, dict[str, SimulatedDrive]] = {}
    wind_effect = {}
    for road in plan.roads:
        scenario, calm = study_scenario(road), study_scenario(road, wind=())
        driven[road] = {n: drive_contender(n, scenario, tuned, plan.switches) for n in CONTENDERS}
        if scenario.wind:
            wind_effect[road] = {
                n: {
                    "wind_m": largest_error(d),
                    "calm_m": largest_error(drive_contender(n, calm, tuned, plan.switches)),
                }
                for n, d in driven[road].items()
            }
        step()
    # one difference at a time taken from the authors' code, then all of them
    cases = {"none": (), **{s: (s,) for s in plan.single_switches}, "all": DRIVE_SWITCHES}
    effects, reading = {}, plan.switches & {WEAK}
    for name, changed in cases.items():
        own = reading | {*changed}
        effects[name] = {
            road: metrics_of(("paper", "classic"), study_scenario(road), tuned, own)
            for road in plan.roads
        }
        step()
    # the increment weight, with the other gains of Table 3
    table3, sweep = table3_gains(), []
    for R in INCREMENT_WEIGHTS:
        gains = TunedGains((0.6, 4.0), table3, table3._replace(increment_weight=R))
        mse = mean_square_errors("paper_one", plan.tuning_roads[:2], gains, plan.switches)
        sweep.append({"R": R, "mse_m2": mse})
    step()
    attempts = measure_attempts(tuned, plan.switches)
    step()
    swarms = measure_swarms(plan.sphere_seeds, plan.problems)
    step()
    claim_by_speed = measure_claim(plan.claim, step)
    weak_baselines = measure_weak_baselines(plan.roads, plan.switches)
    step()
    return {
        "roads": {r: {n: drive_metrics(d) for n, d in row.items()} for r, row in driven.items()},
        **searches,
        "wind_effect": wind_effect,
        "switches": effects,
        "sweep": sweep,
        **attempts,
        "sphere": swarms,
        "claim_by_speed": claim_by_speed,
        "weak_baselines": weak_baselines,
    }, driven


def gain_searches(plan: StudyPlan) -> list[tuple[bool, Switches, int]]:
    """Return the searches: with the plan's switches, then as in the authors' code.

    Each is: whether the model is fixed, switches, seed.
    """
    own = [(fixed, plan.switches, s) for fixed, s in product((False, True), plan.tuning_seeds)]
    code = plan.switches.union(SEARCH_SWITCHES)
    other = [(fixed, code, plan.tuning_seeds[0]) for fixed in (False, True)]
    return own + (other if code != plan.switches else [])


def search_gains(plan: StudyPlan, step: StepCallback) -> tuple[TunedGains, dict[str, Any]]:
    """Search for the look-ahead and the single gain sets; return the best, and all results."""
    table3, trials = table3_gains(), list[dict[str, Any]]()
    searched = plan.switches - {WEAK}  # which has a look-ahead of its own
    for time, distance in product(LOOK_AHEAD_TIMES, LOOK_AHEAD_DISTANCES):
        tuned = TunedGains((time, distance), table3, table3)
        mse = mean_square_errors("pure_pursuit", plan.tuning_roads, tuned, searched)
        fitness = float(geometric_mean(np.array(list(mse.values()))))
        trials.append({"time_s": time, "distance_m": distance, "fitness_m2": fitness, "mse": mse})
    first = min(trials, key=lambda trial: float(trial["fitness_m2"]))
    step()
    rows = [search_gain_set(*search, plan, step) for search in gain_searches(plan)]

    def best(model: str) -> Gains:
        own = [row for row in rows if row["used"] and row["model"] == model]
        return Gains(**min(own, key=lambda row: float(row["fitness_m2"]))["gains"])

    look_ahead = (first["time_s"], first["distance_m"])
    return TunedGains(look_ahead, fixed=best("fixed"), adaptive=best("adaptive")), {
        "look_ahead": {
            "best": {key: first[key] for key in ("time_s", "distance_m")},
            "trials": trials,
            "best_alone": {
                road: min(trials, key=lambda t: float(t["mse"][road])) for road in plan.tuning_roads
            },
        },
        "tuning": rows,
    }


def search_gain_set(
    fixed: bool, switches: Switches, seed: int, plan: StudyPlan, step: StepCallback
) -> dict[str, Any]:
    """Search for the best single gain set with the paper's swarm; measure it on the tuning roads.

    Args:
        fixed: Whether the model does not follow the speed.
        switches: Switches of the search.
        seed: Seed of the swarm.
        plan: Tuning roads, sizes, and switches of the drives.
        step: Called after each generation.
    """
    fitness = gain_fitness(fixed, plan.tuning_roads, switches)

    def counted(positions: Array) -> Array:
        values = fitness(positions)
        step()
        return values

    settings, dimensions = swarm_settings(switches, plan), gain_dimensions(switches)
    best = minimize(counted, dimensions, settings, np.random.default_rng(seed), map_vectorized)
    gains = gains_from_position(best.position)
    name, tuned = "classic_pso" if fixed else "paper_one", TunedGains((0.0, 0.0), gains, gains)
    mse = {
        road: metrics_of([name], study_scenario(road), tuned, plan.switches)[name]["mse_m2"]
        for road in plan.tuning_roads
    }
    return {
        "model": "fixed" if fixed else "adaptive",
        "search": "authors_code" if switches.issuperset(SEARCH_SWITCHES) else "paper",
        "used": switches == plan.switches,
        "seed": seed,
        "gains": gains._asdict(),
        "fitness_m2": best.fitness,
        "history_m2": best.history.tolist(),
        "evaluations": int(best.evaluations[-1]),
        "mse_m2": mse,
        "swarm": asdict(settings),
        "bounds": {d.name: [d.low, d.high] for d in dimensions},
    }


def gain_dimensions(switches: Switches) -> list[Dimension]:
    """Return the dimensions of a search for gains."""
    bounds = GAIN_BOUNDS["authors_code" if "bounds" in switches else "paper"]
    return [
        Dimension(name, *pair, integer=name in ("N", "N_c", "N_p"))
        for name, pair in zip(GAIN_NAMES, bounds, strict=True)
    ]


def gains_from_position(position: Array) -> Gains:
    """Return the gains of a position (6,); N and N_c are at most N_p, as in the authors' code."""
    alpha, N, N_c, N_p, log_Q, log_R = position.tolist()
    return Gains(int(N_p), int(min(N_c, N_p)), int(min(N, N_p)), alpha, 10.0**log_Q, 10.0**log_R)


def swarm_settings(switches: Switches, plan: StudyPlan) -> VariantSettings:
    """Return Table 2 of the paper, or the settings of the authors' code."""
    settings = VariantSettings(variant="authors_code" if "schedule" in switches else "proposed")
    if "sizes" in switches:
        settings = replace(settings, generations=5, particles=10, max_inertia=0.9, min_inertia=0.4)
    changes: dict[str, Any] = dict(plan.swarm)
    return replace(settings, **changes)


def gain_fitness(fixed: bool, roads: Sequence[str], switches: Switches) -> Callable[[Array], Array]:
    """Return the fitness function of a generation (n, 6): geometric mean of the MSE [m^2].

    With switch `fitness` the only scenario is that of the authors: a straight road, joined from
    3.5 m at 9 m/s. Numerically singular gains have an infinite fitness.
    """
    if "fitness" in switches:
        scenarios = [study_scenario("straight", start_offset=-3.5)]
    else:
        scenarios = [study_scenario(name) for name in roads]
    speeds = [FIXED_SPEED.get(s.name, 9.0) if fixed else 0.0 for s in scenarios]
    settings = [controller_settings(speed, switches) for speed in speeds]
    plant, chassis = plant_vehicle(switches), paper_car().chassis

    def fitness(positions: Array) -> Array:
        result, cars = np.full(len(positions), np.inf), dict[int, list[Entry]]()
        for k, position in enumerate(positions):
            with suppress(ValueError):  # singular gains
                table = constant_table(gains_from_position(position), switches)
                cars[k] = [
                    Entry(Simulation(plant, scenario), LateralMpc(chassis, chosen, table))
                    for scenario, chosen in zip(scenarios, settings, strict=True)
                ]
        fleet = [entry for row in cars.values() for entry in row]
        drives = iter(drive_fleet(fleet, 2, ABORT_ERROR) if fleet else [])
        for k, row in cars.items():
            result[k] = geometric_mean(np.array([aborted_mse(next(drives), car) for car in row]))
        return result

    return fitness


def aborted_mse(drive: Drive, car: Entry) -> float:
    """Return the MSE of a drive; the ticks after an abort count with ABORT_ERROR [m^2]."""
    scenario, to_cg = car.simulation.scenario, car.simulation.vehicle.chassis.cg_to_rear_axle
    error = errors(drive, make_path(scenario.points), to_cg)[:, 0]
    missing = max(round(scenario.duration / car.controller.period) - len(error), 0)
    return float((np.sum(error**2) + missing * ABORT_ERROR**2) / (len(error) + missing))


def measure_swarms(seeds_each: int, problems: int) -> dict[str, Any]:
    """Return the curves of the swarms on the sphere, final quartiles, medians of the readings."""
    seeds = range(seeds_each)
    runs = {
        problem.name: {name: search_curves(METHODS[name], problem, seeds) for name in SWARMS}
        for problem in PROBLEMS[:problems]
    }
    medians = {name: reading_medians(name, seeds) for name in READINGS}
    return {
        "curves": {name: values.tolist() for name, values in runs[PROBLEMS[0].name].items()},
        "final": {
            problem: {name: final_quartiles(values) for name, values in row.items()}
            for problem, row in runs.items()
        },
        "readings": {
            name: {"median": median, "holds": all(ordering_bars(median).values())}
            for name, median in medians.items()
        },
    }
