"""Search methods of the tuner: budgets, repetition, and the choice of similar neighbours."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ampc_msgs_config.types import Array
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.pso.swarm import Dimension
from launch_scripts.tuning.methods import SEARCH_METHODS, SearchRecord, has_cma, polish, run_method
from launch_scripts.tuning.smoothness import jump_penalty, smoothest

BOUNDS = [Dimension("pole", -2.0, 2.0), Dimension("weight", 0.0, 50.0)]
INSTALLED = [name for name in SEARCH_METHODS if name != "cma" or has_cma()]


def two_valleys(x: Array) -> Array:
    """Compute a function with minima 1 at (1, 30) and 1.3 at (-1, 10)."""
    u, v = x[:, 0], x[:, 1] / 25.0
    deep, flat = (u - 1.0) ** 2 + (v - 1.2) ** 2, (u + 1.0) ** 2 + (v - 0.4) ** 2
    return np.asarray(np.minimum(1.0 + deep, 1.3 + 0.5 * flat))


def searched(name: str, budget: int, seed: int = 1) -> SearchRecord:
    return run_method(
        name, SearchRecord(two_valleys, BOUNDS, budget, 8), np.random.default_rng(seed)
    )


@pytest.mark.parametrize("name", INSTALLED)
@pytest.mark.parametrize("budget", [12, 45, 90])
def test_a_method_keeps_to_budget_and_bounds_and_repeats_itself(name: str, budget: int) -> None:
    one, other = searched(name, budget), searched(name, budget)
    assert len(one.fitness) <= budget
    assert len(one.fitness) >= budget - 8 or name == "pso"
    np.testing.assert_array_equal(one.positions, other.positions)
    np.testing.assert_array_equal(one.fitness, two_valleys(one.positions))
    assert np.all((one.unit >= 0.0) & (one.unit <= 1.0))


@pytest.mark.parametrize("name", INSTALLED)
def test_a_search_that_knows_its_first_evaluations_does_not_repeat_them(name: str) -> None:
    whole, asked = searched(name, 60), [0]

    def counted(x: Array) -> Array:
        asked[0] += len(x)
        return two_valleys(x)

    known = whole.positions[:41], whole.fitness[:41]
    record = SearchRecord(counted, BOUNDS, 60, 8, known)
    again = run_method(name, record, np.random.default_rng(1))
    np.testing.assert_array_equal(again.positions, whole.positions)
    assert asked[0] <= len(whole.fitness) - 41 + 8


def test_the_adapted_swarm_finds_the_deeper_valley_from_every_seed() -> None:
    finals = [searched("pso", 90, seed).best[1] for seed in range(20)]
    assert max(finals) < 1.001
    random = [searched("random", 90, seed).best[1] for seed in range(20)]
    assert np.median(random) > 1.01


def test_a_cost_without_any_finite_value_ends_the_search() -> None:
    for name in INSTALLED:
        record = SearchRecord(lambda x: np.full(len(x), np.nan), BOUNDS, 40, 8)
        assert math.isinf(run_method(name, record, np.random.default_rng(1)).best[1])


def test_a_polish_reaches_the_minimum_of_a_quadratic_within_its_limit() -> None:
    record = SearchRecord(
        lambda x: 1.0 + np.sum((x - [0.5, 20.0]) ** 2 / [1.0, 400.0], axis=1), BOUNDS, 99
    )
    polish(record, np.array([0.55, 0.5]), 60)
    assert len(record.fitness) <= 61
    np.testing.assert_allclose(record.best[0], [0.5, 20.0], atol=0.2)


def test_whole_numbers_reach_the_cost_rounded() -> None:
    where = [Dimension("n", 1, 9, integer=True), Dimension("x", 0.0, 1.0)]
    seen: list[Array] = []
    record = SearchRecord(lambda x: seen.append(x) or np.sum(x, axis=1), where, 30)  # type: ignore[func-returns-value]
    run_method("pso", record, np.random.default_rng(1))
    assert all(float(value).is_integer() for x in seen for value in x[:, 0])


def gains(pole: float, weight: float = 100.0) -> Gains:
    return Gains(25, 20, 3, pole, 10.0, weight)


def test_the_penalty_depends_on_the_size_of_a_jump_only() -> None:
    assert jump_penalty(gains(0.5), gains(0.5)) == 0.0
    assert jump_penalty(gains(0.2), gains(0.6)) == pytest.approx(
        jump_penalty(gains(0.6), gains(0.2))
    )
    doubled = gains(0.5)._replace(output_weight=20.0, increment_weight=200.0)
    assert jump_penalty(gains(0.5), doubled) == pytest.approx(0.0)
    assert jump_penalty(gains(0.2), gains(0.6)) > 10.0 * jump_penalty(gains(0.3), gains(0.5))


values = st.tuples(st.floats(0.0, 0.9), st.floats(1.0, 1e4), st.floats(1e-4, 1.0))


@given(st.lists(st.lists(values, min_size=1, max_size=4), min_size=1, max_size=4))
def test_the_choice_is_the_best_of_all_combinations(
    nodes: list[list[tuple[float, float, float]]],
) -> None:
    sets = [[(gains(pole, weight), value) for pole, weight, value in node] for node in nodes]

    def cost(chosen: tuple[tuple[Gains, float], ...]) -> float:
        jumps = itertools.pairwise(g for g, _ in chosen)
        return sum(math.log(v) for _, v in chosen) + sum(jump_penalty(*pair) for pair in jumps)

    best = min(map(cost, itertools.product(*sets)))
    found = smoothest(sets)
    cheapest = [min(v for g, v in node if g == one) for one, node in zip(found, sets, strict=True)]
    assert cost(tuple(zip(found, cheapest, strict=True))) == pytest.approx(best, rel=1e-9, abs=1e-9)
