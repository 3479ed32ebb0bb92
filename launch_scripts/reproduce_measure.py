"""Measures all that the reproduction shows, into one dictionary for JSON."""

from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.curves import q
from ampc_msgs_config.path import Array
from ampc_msgs_config.scenario import Scenario
from launch_scripts.bench_pso_tables import READ, bars
from launch_scripts.pso_yardsticks import (
    METHODS,
    PROBLEMS,
    as_in_the_paper,
    curves,
    finals,
    readings,
)
from launch_scripts.reproduce_cases import (
    ROADS,
    SWITCHES,
    Authors,
    Found,
    Run,
    contenders,
    numbers,
    road,
    run,
)
from launch_scripts.reproduce_search import (
    TASK,
    Tuned,
    dimensions,
    swarm_settings,
    sweep,
    tune,
    tune_look_ahead,
)

SWARMS = ("proposed", "linear", "damped", "classic", "fitted linear", "Zhan's adaptive")
LENGTHS = (15.0, 20.0, 30.0, 45.0, 60.0)
"""Of each half of the double lane change, in the sweep of its geometry [m]."""
WIDTH, STRAIGHT = 3.5, 25.0
"""Of the lane change, and between its halves [m]."""
FRAGILE: dict[str, tuple[str, dict[str, float], dict[str, float]]] = {
    "Sc1, 50 ms of steering delay": ("sc1", {}, {"delay": 0.05}),
    "Sc1, 100 ms of steering lag": ("sc1", {}, {"lag": 0.1}),
    "straight, joined from 0.5 m, 9 m/s": ("straight", {"start_offset": 0.5, "speed": 9.0}, {}),
    "straight, joined from 0.5 m, 15 m/s": ("straight", {"start_offset": 0.5, "speed": 15.0}, {}),
    "straight, joined from 0.5 m, 21 m/s": ("straight", {"start_offset": 0.5, "speed": 21.0}, {}),
}
"""What the controller is not told: road, changes of it, and of the steering."""
SEARCH_SWITCHES = frozenset(name for name, switch in SWITCHES.items() if not switch.drives)
Step = Callable[[], None]
"""Called when one of `steps` is done."""


class Plan(NamedTuple):
    """How much is measured."""

    authors: Authors
    """Switches of the whole page at `authors_code`."""
    roads: tuple[str, ...] = tuple(ROADS)
    task: tuple[str, ...] = TASK
    tuning_seeds: tuple[int, ...] = (1, 2)
    swarm: tuple[tuple[str, int], ...] = ()
    """Changes of the swarm that tunes."""
    sphere_seeds: int = 51
    problems: int = len(PROBLEMS)
    switches: tuple[str, ...] = tuple(name for name, s in SWITCHES.items() if s.drives)
    """Shown one at a time."""


def quick(authors: Authors) -> Plan:
    """Give the plan of a first look."""
    few = (("particles", 3), ("generations", 1))
    return Plan(authors, ("sc1", "sc2"), ("sc1",), (1,), few, 5, 2, ("solver",))


def steps(plan: Plan) -> int:
    """Number of steps that `measure` reports."""
    moves = sum(
        replace(swarm_settings(authors), **dict(plan.swarm)).generations + 1
        for _, authors, _ in searches_of(plan)
    )
    rows = len(plan.switches) + 1
    return 1 + moves + len(plan.roads) + rows + 3


def measure(plan: Plan, step: Step) -> tuple[dict[str, Any], dict[str, dict[str, Run]]]:
    """Give all numbers, and the drives that are drawn, by road and contender."""
    found, searched = search(plan, step)
    runs = drive_roads(plan, found, step)
    results: dict[str, Any] = {
        "roads": {name: {n: numbers(r) for n, r in row.items()} for name, row in runs.items()},
        **searched,
        "wind_effect": wind_effect(plan, runs, found),
        "switches": switch_table(plan, found, step),
        "sweep": sweep(plan.task[:2], plan.authors),
    }
    step()
    results |= {"geometry": geometry(found, plan), "fragile": fragile(found, plan)}
    step()
    results["sphere"] = sphere(plan)
    step()
    return results, runs


def searches_of(plan: Plan) -> list[tuple[bool, Authors, int]]:
    """Give the searches for gains: whether the model is fixed, switches, seed."""
    own = [(fixed, plan.authors, s) for fixed, s in product((False, True), plan.tuning_seeds)]
    code = plan.authors | SEARCH_SWITCHES
    other = [(fixed, code, plan.tuning_seeds[0]) for fixed in (False, True)]
    return own + (other if code != plan.authors else [])


def search(plan: Plan, step: Step) -> tuple[Found, dict[str, Any]]:
    """Tune look-ahead and single gain sets."""
    found, trials = tune_look_ahead(plan.task, plan.authors)
    step()
    tuned = [
        (key, tune(key[0], plan.task, key[1], key[2], step, **dict(plan.swarm)))
        for key in searches_of(plan)
    ]

    def best(fixed: bool) -> Tuned:
        own = [t for key, t in tuned if key[:2] == (fixed, plan.authors)]
        return min(own, key=lambda t: t.fitness)

    found = found._replace(fixed=best(True).gains, adaptive=best(False).gains)
    return found, {
        "look_ahead": {
            "best": dict(zip(("time_s", "distance_m"), found.look_ahead, strict=True)),
            "trials": trials,
            "best_alone": {
                name: min(trials, key=lambda t, n=name: t["mse"][n]) for name in plan.task
            },
        },
        "tuning": [tuning_row(key, t, plan, found) for key, t in tuned],
    }


def tuning_row(
    key: tuple[bool, Authors, int], tuned: Tuned, plan: Plan, found: Found
) -> dict[str, Any]:
    """Say what a search found, and what the gains do on the roads of the task."""
    fixed, authors, seed = key
    settings = replace(swarm_settings(authors), **dict(plan.swarm))
    name = "classic_pso" if fixed else "paper_one"
    own = found._replace(fixed=tuned.gains, adaptive=tuned.gains)
    drives = {r: numbers(run(name, road(r), own, plan.authors)) for r in plan.task}
    return {
        "model": "fixed" if fixed else "adaptive",
        "search": "paper" if authors == plan.authors else "authors_code",
        "seed": seed,
        "gains": tuned.gains._asdict(),
        "fitness_m2": tuned.fitness,
        "history_m2": tuned.history.tolist(),
        "evaluations": tuned.evaluations,
        "mse_m2": {name: row["mse_m2"] for name, row in drives.items()},
        "swarm": asdict(settings),
        "bounds": {d.name: [d.low, d.high] for d in dimensions(authors)},
    }


def drive_roads(plan: Plan, found: Found, step: Step) -> dict[str, dict[str, Run]]:
    """Drive every road with every contender."""
    runs: dict[str, dict[str, Run]] = {}
    for name in plan.roads:
        runs[name] = {n: run(n, road(name), found, plan.authors) for n in contenders()}
        step()
    return runs


def wind_effect(plan: Plan, runs: dict[str, dict[str, Run]], found: Found) -> dict[str, Any]:
    """Give the largest error with and without the wind, on the roads that have some."""
    table: dict[str, Any] = {}
    for name in plan.roads:
        windy = road(name)
        if not windy.wind:
            continue
        calm = {n: run(n, windy._replace(wind=()), found, plan.authors) for n in runs[name]}
        table[name] = {
            n: {
                "wind_m": float(np.abs(runs[name][n].error).max()),
                "calm_m": float(np.abs(calm[n].error).max()),
            }
            for n in calm
        }
    return table


def switch_table(plan: Plan, found: Found, step: Step) -> dict[str, Any]:
    """Drive with one difference at a time taken from the authors' code, then with all of them."""
    table: dict[str, Any] = {}
    every = frozenset(name for name, switch in SWITCHES.items() if switch.drives)
    for name, authors in [*((s, frozenset([s])) for s in plan.switches), ("all", every)]:
        table[name] = {
            r: {n: numbers(run(n, road(r), found, authors)) for n in ("paper", "classic")}
            for r in plan.roads
        }
        step()
    return table


def lane_change(length: float) -> Scenario:
    """Give Sc1 with another length of each of its two moves [m]."""
    sc1 = road("sc1")
    X = np.arange(0.0, 30.0 + 2 * length + STRAIGHT + 150.0, 0.5)
    Y: Array = WIDTH * (q((X - 30.0) / length) - q((X - 30.0 - length - STRAIGHT) / length))
    duration = round((30.0 + 2 * length + STRAIGHT + 40.0) / 9.0, 1)
    return sc1._replace(points=np.column_stack((X, Y)), duration=duration)


def geometry(found: Found, plan: Plan) -> list[dict[str, Any]]:
    """Give the MSE of the paper's three controllers over the length of the lane change."""
    names = ("paper", "classic", "pure_pursuit")
    return [
        {
            "length_m": length,
            "mse_m2": {
                n: numbers(run(n, lane_change(length), found, plan.authors))["mse_m2"]
                for n in names
            },
        }
        for length in LENGTHS
    ]


def fragile(found: Found, plan: Plan) -> dict[str, Any]:
    """Give what delay, lag and a start beside the path do."""
    names = ("paper", "pure_pursuit", "preview")
    return {
        what: {
            n: numbers(run(n, road(name, **changes), found, plan.authors, **unknown)) for n in names
        }
        for what, (name, changes, unknown) in FRAGILE.items()
    }


def sphere(plan: Plan) -> dict[str, Any]:
    """Run the swarms on the test functions: curves on the sphere, final quartiles on all."""
    seeds = range(plan.sphere_seeds)
    final: dict[str, Any] = {}
    runs: dict[str, Array] = {}
    for problem in PROBLEMS[: plan.problems]:
        own = {name: curves(METHODS[name], problem, seeds) for name in SWARMS}
        runs = runs or own
        final[problem.name] = {
            name: np.percentile(values[:, -1], (25, 50, 75)).tolist()
            for name, values in own.items()
        }
    ways = {}
    for name, changes in readings().items():
        settings = [as_in_the_paper(variant, **changes) for variant in READ]
        medians = np.median(finals(settings, PROBLEMS[0], seeds), axis=1).tolist()
        median = dict(zip(READ, medians, strict=True))
        ways[name] = {"median": median, "holds": all(bar.holds for bar in bars(median))}
    return {
        "curves": {name: values.tolist() for name, values in runs.items()},
        "final": final,
        "readings": ways,
    }
