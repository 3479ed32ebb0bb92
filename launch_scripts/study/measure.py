"""Measures all that the reproduction shows, into one dictionary for JSON."""

from collections.abc import Callable
from dataclasses import asdict, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ampc_ros.pso.settings import PsoSettings
from launch_scripts.run.simulated import SimulatedDrive
from launch_scripts.study.cases import (
    ROADS,
    SWITCHES,
    Authors,
    Found,
    contenders,
    numbers,
    road,
    run,
)
from launch_scripts.study.pso_yardsticks import PROBLEMS
from launch_scripts.study.search import (
    TASK,
    Tuned,
    dimensions,
    swarm_settings,
    sweep,
    tune,
    tune_look_ahead,
)
from launch_scripts.study.tried import fragile, geometry, sphere, wind_effect, wind_speeds

SEARCH_SWITCHES = frozenset(name for name, switch in SWITCHES.items() if not switch.drives)
DRIVE_SWITCHES = tuple(name for name, switch in SWITCHES.items() if switch.drives)
Step = Callable[[], None]
"""Called when one of `steps` is done."""


class Plan(NamedTuple):
    """How much is measured."""

    authors: Authors
    """Switches of the whole page at `authors_code`."""
    roads: tuple[str, ...] = tuple(ROADS)
    task: tuple[str, ...] = TASK
    tuning_seeds: tuple[int, ...] = (1, 2, 3)
    swarm: tuple[tuple[str, int], ...] = ()
    """Changes of the swarm that tunes."""
    sphere_seeds: int = 51
    problems: int = len(PROBLEMS)
    switches: tuple[str, ...] = DRIVE_SWITCHES
    """Shown one at a time."""


def quick(authors: Authors) -> Plan:
    """Give the plan of a first look."""
    few = (("particles", 3), ("generations", 1))
    return Plan(authors, ("sc1", "sc2"), ("sc1",), (1,), few, 5, 2, ("solver",))


def steps(plan: Plan) -> int:
    """Number of steps that `measure` reports."""
    moves = sum(settings_in(plan, authors).generations + 1 for _, authors, _ in searches_of(plan))
    rows = len(plan.switches) + 2
    return 1 + moves + len(plan.roads) + rows + 3


def measure(plan: Plan, step: Step) -> tuple[dict[str, Any], dict[str, dict[str, SimulatedDrive]]]:
    """Give all numbers, and the drives that are drawn, by road and contender."""
    found, searched = search(plan, step)
    runs = drive_roads(plan, found, step)
    results: dict[str, Any] = {
        "roads": {name: {n: numbers(r) for n, r in row.items()} for name, row in runs.items()},
        **searched,
        "wind_effect": wind_effect(runs, found, plan.authors),
        "switches": switch_table(plan, found, step),
        "sweep": sweep(plan.task[:2], plan.authors),
    }
    step()
    results |= {"geometry": geometry(found, plan.authors), "fragile": fragile(found, plan.authors)}
    results["wind_speeds"] = wind_speeds(found, plan.authors)
    step()
    results["sphere"] = sphere(plan.sphere_seeds, plan.problems)
    step()
    return results, runs


def settings_in(plan: Plan, authors: Authors) -> PsoSettings:
    """Give the settings of the swarm that tunes."""
    changes: dict[str, Any] = dict(plan.swarm)
    return replace(swarm_settings(authors), **changes)


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
    changes: dict[str, Any] = dict(plan.swarm)
    tuned = [
        (key, tune(key[0], plan.task, key[1], key[2], step, **changes)) for key in searches_of(plan)
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
                name: trials[int(np.argmin([t["mse"][name] for t in trials]))] for name in plan.task
            },
        },
        "tuning": [tuning_row(key, t, plan, found) for key, t in tuned],
    }


def tuning_row(
    key: tuple[bool, Authors, int], tuned: Tuned, plan: Plan, found: Found
) -> dict[str, Any]:
    """Say what a search found, and what the gains do on the roads of the task."""
    fixed, authors, seed = key
    name = "classic_pso" if fixed else "paper_one"
    own = found._replace(fixed=tuned.gains, adaptive=tuned.gains)
    drives = {r: numbers(run(name, road(r), own, plan.authors)) for r in plan.task}
    return {
        "model": "fixed" if fixed else "adaptive",
        "search": "authors_code" if authors >= SEARCH_SWITCHES else "paper",
        "used": authors == plan.authors,
        "seed": seed,
        "gains": tuned.gains._asdict(),
        "fitness_m2": tuned.fitness,
        "history_m2": tuned.history.tolist(),
        "evaluations": tuned.evaluations,
        "mse_m2": {name: row["mse_m2"] for name, row in drives.items()},
        "swarm": asdict(settings_in(plan, authors)),
        "bounds": {d.name: [d.low, d.high] for d in dimensions(authors)},
    }


def drive_roads(plan: Plan, found: Found, step: Step) -> dict[str, dict[str, SimulatedDrive]]:
    """Drive every road with every contender."""
    runs: dict[str, dict[str, SimulatedDrive]] = {}
    for name in plan.roads:
        runs[name] = {n: run(n, road(name), found, plan.authors) for n in contenders()}
        step()
    return runs


def switch_table(plan: Plan, found: Found, step: Step) -> dict[str, Any]:
    """Drive with one difference at a time taken from the authors' code, then with all of them."""
    table: dict[str, Any] = {}
    single = [(switch, frozenset([switch])) for switch in plan.switches]
    for name, authors in [("none", frozenset[str]()), *single, ("all", frozenset(DRIVE_SWITCHES))]:
        table[name] = {
            r: {n: numbers(run(n, road(r), found, authors)) for n in ("paper", "classic")}
            for r in plan.roads
        }
        step()
    return table
