"""Search methods of the tuner on its real fitness: two nodes, many seeds, small budgets."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.types import Array
from launch_scripts.reporting.pages import markdown_table
from launch_scripts.tune import build_parser
from launch_scripts.tuning.methods import SEARCH_METHODS, SearchRecord, has_cma, run_method
from launch_scripts.tuning.task import TABLE_SEARCH, read_task

EVALUATIONS = (30, 45, 90)
"""Budgets at which the methods are compared; each search has the largest one."""
LONG = 400
"""Evaluations of the search that looks for the best known gains."""
NEAR = 1.02
"""Fitness relative to the best known from which on a search counts as finished."""
BEST = "long pso"
"""Name of the search that looks for the best known gains."""
TARGETS = {"paper car, 11 m/s": 1.02, "ordinary car, 5 m/s": 1.05}
"""Largest allowed fitness of the worst seed of `pso` after all evaluations, relative to the best
known."""
MOST_EVALUATIONS = 45
"""Largest allowed median of the evaluations of `pso` until NEAR."""


class TuningProblem(NamedTuple):
    """A node of the gain table of a car, with the options of `tune.py`."""

    name: str
    options: tuple[str, ...]


TUNING_PROBLEMS = (
    TuningProblem("paper car, 11 m/s", ("--speeds", "11")),
    TuningProblem("ordinary car, 5 m/s", ("--vehicle", "ordinary", "--speeds", "5")),
)


def method_names() -> list[str]:
    """Return the methods that are installed."""
    return [name for name in SEARCH_METHODS if name != "cma" or has_cma()]


def best_curve(problem: TuningProblem, method: str, seed: int, budget: int) -> Array:
    """Return the best fitness after each evaluation of a search (budget,)."""
    task = read_task(build_parser().parse_args(problem.options))
    search = task.search(TABLE_SEARCH, seed, 0, tuple(task.nodes()), budget)
    record = SearchRecord(search.cost, search.space.dimensions, budget)
    best = np.minimum.accumulate(run_method(method, record, search.rng).fitness)
    return np.append(best, np.full(budget - len(best), best[-1]))


def tuning_curves(number: int, method: str, seeds: Sequence[int], budget: int) -> Array:
    """Return the curves of several seeds (seeds, budget) on one of TUNING_PROBLEMS."""
    problem = TUNING_PROBLEMS[number]
    return np.array([best_curve(problem, method, seed, budget) for seed in seeds])


def tuning_results(curves: Mapping[str, Mapping[str, Array]]) -> dict[str, Any]:
    """Return the results as JSON values.

    Args:
        curves: Curves (seeds, evaluations) by problem and method; BEST is the long search.
    """
    results: dict[str, Any] = {}
    for problem, by_method in curves.items():
        known = min(float(each.min()) for each in by_method.values())
        results[problem] = {"best_known": known, "methods": {}}
        for method in [name for name in by_method if name != BEST]:
            ratio = by_method[method] / known
            first = [
                int(np.argmax(row <= NEAR)) + 1 if row[-1] <= NEAR else math.inf for row in ratio
            ]
            median = float(np.median(first))
            results[problem]["methods"][method] = {
                "median": {str(n): float(np.median(ratio[:, n - 1])) for n in EVALUATIONS},
                "worst": {str(n): float(ratio[:, n - 1].max()) for n in EVALUATIONS},
                "evaluations": median if math.isfinite(median) else None,
            }
    return results


def tuning_bars(results: Mapping[str, Any]) -> dict[str, bool]:
    """Check the targets of the default method; return the result of each bar."""
    bars = {}
    for problem, limit in TARGETS.items():
        found = results[problem]["methods"]["pso"]
        worst, count = found["worst"][str(EVALUATIONS[-1])], found["evaluations"] or math.inf
        bars[f"{problem}: worst seed <= {limit}"] = worst <= limit
        bars[f"{problem}: median evaluations <= {MOST_EVALUATIONS}"] = count <= MOST_EVALUATIONS
    return bars


def tuning_tables(results: Mapping[str, Any], seeds: int) -> list[str]:
    """Return the tables in Markdown: a row for each problem and method."""
    headings = [
        "problem",
        "method",
        *(f"after {n}" for n in EVALUATIONS),
        f"evaluations to {NEAR:g}",
    ]
    rows: list[Sequence[str]] = []
    for problem, found in results.items():
        for method, each in found["methods"].items():
            cells = [
                f"{each['median'][str(n)]:.3f} / {each['worst'][str(n)]:.3f}" for n in EVALUATIONS
            ]
            count = each["evaluations"]
            last = f"> {EVALUATIONS[-1]}" if count is None else f"{count:g}"
            rows.append([problem, method, *cells, last])
    known = "; ".join(f"{name}: {found['best_known']:.4g}" for name, found in results.items())
    return [
        "## The tuner's own fitness",
        "",
        f"Fitness relative to the best known, median / worst of {seeds} seeds. Best known (by all",
        f"these searches and a `pso` of {LONG} evaluations): {known}.",
        "",
        *markdown_table(headings, rows, "ll"),
        "",
        "Targets of `pso`:",
        "",
        *(
            f"* {bar}: {'met' if holds else '**not met**'}"
            for bar, holds in tuning_bars(results).items()
        ),
        "",
    ]
