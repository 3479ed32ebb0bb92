"""Swarms with a cost that fails, and invalid settings and bounds."""

import math
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.types import Array
from ampc_ros.pso.minimize import minimize, search
from ampc_ros.pso.swarm import Dimension, PsoSettings
from launch_scripts.study.pso_variants import VARIANTS, VariantSettings

LINE = (Dimension("x", -10.0, 10.0),)
RNG = np.random.default_rng


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_fitness_that_is_not_finite_never_wins(variant: str, bad: float) -> None:
    def cost(position: Array) -> float:
        return bad if position[0] < 2 else float(position[0])

    best = minimize(cost, LINE, VariantSettings(variant=variant, generations=30), RNG(1))
    assert 2 <= best.fitness < 2.2
    assert np.all(best.history[np.isfinite(best.history)] >= 2)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_cost_that_always_fails_ends_with_the_worst_fitness(variant: str) -> None:
    best = minimize(
        lambda _: math.nan, LINE, VariantSettings(variant=variant, generations=3), RNG(1)
    )
    assert best.fitness == math.inf
    assert np.all(np.isinf(best.history))
    assert best.evaluations.tolist() == [20, 40, 60, 80]
    assert best.swarm.best_fitness.tolist() == [math.inf] * 20


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_swarm_without_a_finite_fitness_restarts_until_it_has_one(variant: str) -> None:
    def narrow(position: Array) -> float:
        return float(position[0]) if position[0] > 9.8 else math.nan

    chosen = VariantSettings(variant=variant, particles=2, generations=200)
    swarms = list(search(narrow, LINE, chosen, RNG(6)))
    lost = [swarm for swarm in swarms if math.isinf(swarm.history[-1])]
    assert 5 < len(lost) < len(swarms)
    assert not any(swarm.velocity.any() for swarm in lost)
    assert np.ptp([swarm.position for swarm in lost[1:]]) > 15
    assert swarms[-1].history[-1] > 9.8


def test_an_error_in_the_cost_is_passed_on() -> None:
    def cost(position: Array) -> float:
        raise RuntimeError("no car")

    with pytest.raises(RuntimeError, match="no car"):
        minimize(cost, LINE, PsoSettings(), RNG(1))


def test_a_cost_must_return_one_number_for_each_particle() -> None:
    with pytest.raises(ValueError, match=r"cost: returned shape \(20, 2\), .* \(20,\)"):
        minimize(lambda x: (x[0], 1.0), LINE, PsoSettings(), RNG(1))
    with pytest.raises(ValueError, match=r"cost: returned shape \(3,\), .* \(20,\)"):
        minimize(lambda x: 1.0, LINE, PsoSettings(), RNG(1), lambda cost, x: map(cost, x[:3]))


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ((), "bounds = [] must have at least one dimension"),
        ((Dimension("R", 0.1, 0.001),), "bounds: R.low = 0.1 must be below R.high = 0.001"),
        ((Dimension("R", 0.1, 0.1),), "bounds: R.low = 0.1 must be below R.high = 0.1"),
        ((Dimension("R", math.nan, 1.0),), "bounds: R.low = nan must lie in [-1e+100, 1e+100]"),
        ((Dimension("R", 0.0, math.inf),), "bounds: R.high = inf must lie in [-1e+100, 1e+100]"),
        ((Dimension("N", 1, 2.5, integer=True),), "bounds: N.high = 2.5 must be a whole number"),
        ((*LINE, Dimension("y", 0.0, 1.0), *LINE), "bounds: x occurs 2 times"),
    ],
)
def test_invalid_bounds_are_rejected_with_name_value_and_bound(
    bounds: tuple[Dimension, ...], message: str
) -> None:
    with pytest.raises(ValueError) as error:  # noqa: PT011
        minimize(lambda x: 0.0, bounds, PsoSettings(), RNG(1))
    assert str(error.value) == message


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"particles": 1}, r"particles = 1 must lie in \[2, 1e\+06\]"),
        ({"particles": 20.5}, "particles = 20.5 must be a whole number"),
        ({"generations": -1}, r"generations = -1 must lie in \[0, 1e\+06\]"),
        ({"max_velocity": 0.0}, "max_velocity = 0.0 must lie in"),
        ({"max_velocity": math.nan}, "max_velocity = nan must lie in"),
        ({"variant": "bees"}, "variant = 'bees' must be one of proposed, linear"),
        ({"boundary": "wrap"}, "boundary = 'wrap' must be one of clip, absorb, reflect"),
        ({"schedule_length": 2.5}, "schedule_length = 2.5 must be a whole number"),
        ({"min_inertia": 1.0}, "min_inertia = 1.0 must be at most max_inertia = 0.99"),
    ],
)
def test_invalid_settings_are_rejected_with_name_value_and_bound(
    chosen: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        VariantSettings(**chosen)


def test_a_swarm_of_another_size_is_not_resumed() -> None:
    swarm = minimize(lambda x: x[0], LINE, PsoSettings(), RNG(1)).swarm
    with pytest.raises(ValueError, match=r"resume: .* = \(20, 1\) must be \(10, 1\)"):
        search(lambda x: x[0], LINE, PsoSettings(particles=10), RNG(1), resume=swarm)
