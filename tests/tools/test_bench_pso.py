"""Benchmark of the particle swarm: equal budgets, and all losses of the proposed variant."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ampc_msgs_config.types import Array
from ampc_ros.pso.minimize import map_vectorized, minimize
from ampc_ros.pso.swarm import Dimension
from launch_scripts.reporting.style import spread
from launch_scripts.study.bench_pso import (
    Runs,
    bench_results,
    bench_tables,
    draw_methods,
    main,
)
from launch_scripts.study.pso_methods import (
    BOUND,
    BUDGET,
    GENERATIONS,
    METHODS,
    PARTICLES,
    PROBLEMS,
    READING_VARIANTS,
    READINGS,
    BenchmarkProblem,
    Cost,
    comparison_settings,
    ordering_bars,
    rosenbrock,
    search_curve,
    shifted_sphere,
    sphere,
)
from launch_scripts.study.pso_tuning import (
    BEST,
    LONG,
    TUNING_PROBLEMS,
    TuningProblem,
    best_curve,
    tuning_bars,
    tuning_results,
    tuning_tables,
)
from launch_scripts.tune import build_parser
from launch_scripts.tuning.methods import SearchRecord, run_method
from launch_scripts.tuning.task import TABLE_SEARCH, read_task

GAP = 0.062
SMALL = BenchmarkProblem(sphere, 3)
GOOD = {"proposed": 0.01, "linear": 1.5, "damped": 1.4, "classic": 7.0}


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)
def test_a_test_function_is_zero_at_its_only_published_minimum(problem: BenchmarkProblem) -> None:
    n = problem.dimensions
    where: dict[Cost, Array] = {
        rosenbrock: np.ones(n),
        shifted_sphere: np.resize([6.0, -6.0], n),
    }
    lowest = where.get(problem.function, np.zeros(n))
    around: Array = lowest + np.random.default_rng(1).normal(0, 2, (200, n))
    assert problem.function(lowest[None]) == pytest.approx([0.0], abs=1e-12)
    assert np.all(problem.function(around) > 0)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_has_the_same_budget_and_stays_inside_the_bounds(method: str) -> None:
    seen: list[Array] = []

    def watched(x: Array) -> Array:
        seen.extend(x)
        return sphere(x)

    METHODS[method](watched, 3, np.random.default_rng(1))
    jumps = GENERATIONS if method == "Zhan's adaptive" else 0
    least = 1 if method == "pso of the tuner" else BUDGET  # it ends where a polish converged
    assert least <= len(seen) <= BUDGET + jumps
    assert np.all(np.abs(seen) <= BOUND)


@pytest.mark.parametrize("method", METHODS)
def test_a_curve_has_a_point_for_each_generation_falls_and_repeats(method: str) -> None:
    best = search_curve(METHODS[method], SMALL, seed=3)
    assert best.shape == (BUDGET // PARTICLES,)
    assert np.all(np.diff(best) <= 0)
    assert np.array_equal(best, search_curve(METHODS[method], SMALL, seed=3))
    assert not np.array_equal(best, search_curve(METHODS[method], SMALL, seed=4))


def test_the_curve_of_a_swarm_is_its_history() -> None:
    space = [Dimension(f"x{k}", -BOUND, BOUND) for k in range(3)]
    rng = np.random.default_rng(3)
    best = minimize(sphere, space, comparison_settings("linear"), rng, map_vectorized)
    assert np.array_equal(search_curve(METHODS["linear"], SMALL, seed=3), best.history)


@pytest.mark.parametrize(
    ("name", "value"),
    [("proposed", 0.2), ("linear", 0.4), ("linear", 6.0), ("damped", 0.4), ("classic", 1.45)],
)
def test_a_missed_bar_is_detected(name: str, value: float) -> None:
    assert all(ordering_bars(GOOD).values())
    assert not all(ordering_bars({**GOOD, name: value}).values())


def example_runs() -> Runs:
    """Return three runs of every method: `random` is best, `proposed` second."""
    order = [
        "random",
        "proposed",
        *(name for name in METHODS if name not in ("random", "proposed")),
    ]
    fall = np.geomspace(1.0, 0.1, GENERATIONS + 1)
    return {
        (problem.name, name): np.outer([1.0, 2.0, 4.0], fall) * (k + 1)
        for problem in PROBLEMS
        for k, name in enumerate(order)
    }


def example_results() -> dict[str, Any]:
    """Return the results of the example runs; every reading has the same medians."""
    return bench_results(
        example_runs(), {name: dict.fromkeys(READING_VARIANTS, 1.0) for name in READINGS}
    )


def test_the_tables_list_the_methods_that_beat_the_proposed_variant() -> None:
    lines = bench_tables(example_results()).splitlines()
    assert [line for line in lines if line.startswith("* ")] == [
        f"* {problem.name}: random" for problem in PROBLEMS
    ]


def test_the_best_of_a_column_is_bold() -> None:
    bold = [line for line in bench_tables(example_results()).splitlines() if "**" in line]
    assert [line.split(" | ")[0] for line in bold] == ["| random"]
    assert bold[0].count("**0.2 (0.15-0.3)**") == len(PROBLEMS)


def test_every_reading_has_a_row_with_its_verdict() -> None:
    lines = bench_tables(example_results()).splitlines()
    for name in READINGS:
        assert f"| {name} | 1 | 1 | 1 | 1 | 1 | no |" in lines


def test_json_contains_every_run() -> None:
    content = json.loads(json.dumps(example_results(), allow_nan=False))
    one = content["problems"]["ackley, n = 5"]["random"]
    assert one["final"] == pytest.approx([0.1, 0.2, 0.4])
    assert one["quartiles"] == pytest.approx([0.15, 0.2, 0.3])
    assert len(one["median_curve"]) == GENERATIONS + 1
    assert content["bars"]["proposed < linear < classic"]
    assert not content["bars"]["proposed < 0.1"]


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_labels_keep_their_order_and_a_gap(places: list[float]) -> None:
    named = {str(k): place for k, place in enumerate(places)}
    moved = list(spread(named, GAP).values())
    assert np.all(np.diff(moved) >= 0.9 * GAP)
    assert sorted(named, key=lambda name: named[name]) == list(spread(named, GAP))


def test_the_picture_shows_every_problem(tmp_path: Path) -> None:
    draw_methods(example_results(), tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("option", ["--seeds", "--workers"])
def test_a_number_below_one_is_rejected(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([option, "0"])
    assert f"{option} 0 must be at least 1" in capsys.readouterr().err


def tuning_example() -> dict[str, Any]:
    """Return results in which `pso` is within 2 % after 40 evaluations, except for one seed."""
    fall = np.linspace(2.0, 1.0, 51).tolist() + [1.0] * 39
    curve = np.array([fall, fall, [*fall[:50], *[1.2] * 40]])
    by_method = {"pso": curve, "random": 2.0 * curve, BEST: np.full((1, LONG), 1.0)}
    return tuning_results({problem.name: by_method for problem in TUNING_PROBLEMS})


def test_a_search_of_the_tuner_is_judged_by_its_worst_seed_and_its_median_evaluations() -> None:
    results = tuning_example()
    found = results["paper car, 11 m/s"]["methods"]
    assert found["pso"]["worst"]["90"] == pytest.approx(1.2)
    assert found["pso"]["median"]["90"] == pytest.approx(1.0)
    assert found["pso"]["evaluations"] == 50.0
    assert found["random"]["evaluations"] is None
    assert not any(tuning_bars(results).values())
    lines = tuning_tables(results, 3)
    assert any(line.startswith("| paper car, 11 m/s | pso |") for line in lines)
    assert any(line.endswith("| > 90 |") for line in lines)


@pytest.mark.parametrize("problem", TUNING_PROBLEMS, ids=lambda problem: problem.name)
def test_a_curve_of_the_tuner_is_the_fitness_of_its_best_gains(problem: TuningProblem) -> None:
    curve = best_curve(problem, "random", 1, 12)
    assert curve.shape == (12,)
    assert np.all(np.diff(curve) <= 0.0)
    task = read_task(build_parser().parse_args(problem.options))
    search = task.search(TABLE_SEARCH, 1, 0, tuple(task.nodes()), 12)
    record = run_method(
        "random", SearchRecord(search.cost, search.space.dimensions, 12), search.rng
    )
    assert curve[-1] == record.best[1]
