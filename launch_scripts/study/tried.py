"""Measures what was tried where the paper does not reproduce: wind, geometry, faults, swarms."""

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from ampc_msgs_config.paths.curves import q
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import Array
from launch_scripts.run.simulated import SimulatedDrive
from launch_scripts.study.bench_pso_tables import READ, bars
from launch_scripts.study.cases import Authors, Found, numbers, road, run
from launch_scripts.study.pso_yardsticks import (
    METHODS,
    PROBLEMS,
    as_in_the_paper,
    curves,
    finals,
    readings,
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
WIND_SPEEDS = (11.0, 13.0, 15.0, 16.0, 17.0, 18.0)
"""At which the stretched road is driven with and without wind [m/s]."""


def wind_effect(
    runs: Mapping[str, Mapping[str, SimulatedDrive]], found: Found, authors: Authors
) -> dict[str, Any]:
    """Give the largest error with and without the wind, on the roads that have some."""
    table: dict[str, Any] = {}
    for name in runs:
        windy = road(name)
        if not windy.wind:
            continue
        calm = {n: run(n, windy._replace(wind=()), found, authors) for n in runs[name]}
        table[name] = {
            n: {
                "wind_m": float(np.abs(runs[name][n].error).max()),
                "calm_m": float(np.abs(calm[n].error).max()),
            }
            for n in calm
        }
    return table


def wind_speeds(found: Found, authors: Authors) -> list[dict[str, Any]]:
    """Give the largest errors over speed, model adaptive or fixed at 11 m/s, with wind and not."""
    rows = []
    for speed in WIND_SPEEDS:
        windy = road("sc3_fast_wind", speed=speed)
        row: dict[str, Any] = {"speed_mps": speed}
        for name, (air, one) in product(
            ("paper", "classic"), (("calm", windy._replace(wind=())), ("wind", windy))
        ):
            error = run(name, one, found, authors).error
            row[f"{name}_{air}_m"] = float(np.abs(error).max())
        rows.append(row)
    return rows


def lane_change(length: float) -> Scenario:
    """Give Sc1 with another length of each of its two moves [m]."""
    sc1 = road("sc1")
    X = np.arange(0.0, 30.0 + 2 * length + STRAIGHT + 150.0, 0.5)
    Y: Array = WIDTH * (q((X - 30.0) / length) - q((X - 30.0 - length - STRAIGHT) / length))
    duration = round((30.0 + 2 * length + STRAIGHT + 40.0) / 9.0, 1)
    return sc1._replace(points=np.column_stack((X, Y)), duration=duration)


def geometry(found: Found, authors: Authors) -> list[dict[str, Any]]:
    """Give the MSE of the paper's three controllers over the length of the lane change."""
    names = ("paper", "classic", "pure_pursuit")
    return [
        {
            "length_m": length,
            "mse_m2": {
                n: numbers(run(n, lane_change(length), found, authors))["mse_m2"] for n in names
            },
        }
        for length in LENGTHS
    ]


def fragile(found: Found, authors: Authors) -> dict[str, Any]:
    """Give what delay, lag and a start beside the path do."""
    names = ("paper", "pure_pursuit", "preview")
    return {
        what: {n: numbers(run(n, road(name, **changes), found, authors, **unknown)) for n in names}
        for what, (name, changes, unknown) in FRAGILE.items()
    }


def sphere(runs_each: int, problems: int) -> dict[str, Any]:
    """Run the swarms on the test functions: curves on the sphere, final quartiles on all."""
    seeds = range(runs_each)
    final: dict[str, Any] = {}
    runs: dict[str, Array] = {}
    for problem in PROBLEMS[:problems]:
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
