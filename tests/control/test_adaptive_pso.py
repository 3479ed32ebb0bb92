"""Zhan's adaptive swarm: state estimation, weights, elitist learning."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ampc_msgs_config.types import Array
from ampc_ros.pso.minimize import search
from ampc_ros.pso.swarm import Dimension, Swarm, SwarmContext, Weights, swarm_space
from launch_scripts.study.pso_variants import (
    CONVERGENCE,
    EXPLOITATION,
    EXPLORATION,
    JUMPING_OUT,
    MEMBERSHIP,
    VariantSettings,
    adapt_weights,
    classify_state,
    evolutionary_factor,
    leader_jump,
    learn_from_jump,
)

PLANE = (Dimension("x", -10.0, 10.0), Dimension("y", -4.0, 6.0))
STATES = (EXPLORATION, EXPLOITATION, CONVERGENCE, JUMPING_OUT)


def test_the_evolutionary_factor_is_0_at_the_centre_of_the_swarm_and_1_far_away() -> None:
    line = np.array([[0.0], [1.0], [2.0], [9.0]])  # mean distances 4, 10/3, 10/3, 8
    factors = [evolutionary_factor(line, leader) for leader in range(4)]
    assert factors == pytest.approx([1 / 7, 0, 0, 1])
    assert evolutionary_factor(line[:2], 1) == 0


@pytest.mark.parametrize(
    ("f", "degrees"),
    [
        (0.05, (0, 0, 1, 0)),
        (0.25, (0, 0.5, 0.25, 0)),
        (0.35, (0, 1, 0, 0)),
        (0.45, (0.25, 0.75, 0, 0)),
        (0.65, (1, 0, 0, 0)),
        (0.75, (0.5, 0, 0, 0.25)),
        (0.95, (0, 0, 0, 1)),
    ],
)
def test_membership_is_as_published(f: float, degrees: tuple[float, ...]) -> None:
    assert [np.interp(f, *corners) for corners in MEMBERSHIP] == pytest.approx(degrees)


@given(st.floats(0, 1), st.sampled_from(STATES))
def test_the_state_is_always_one_that_is_possible(f: float, before: int) -> None:
    assert np.interp(f, *MEMBERSHIP[classify_state(f, before)]) > 0


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (EXPLORATION, EXPLORATION),
        (EXPLOITATION, EXPLOITATION),
        (CONVERGENCE, EXPLOITATION),
        (JUMPING_OUT, EXPLORATION),
    ],
)
def test_between_two_states_the_one_before_decides(before: int, after: int) -> None:
    assert classify_state(0.45, before) == after


@pytest.mark.parametrize(
    ("state", "signs", "most"),
    [
        (EXPLORATION, (1, -1), 0.1),
        (EXPLOITATION, (1, -1), 0.05),
        (CONVERGENCE, (1, 1), 0.05),
        (JUMPING_OUT, (-1, 1), 0.1),
    ],
)
def test_accelerations_change_as_table_1_says(
    state: int, signs: tuple[int, int], most: float
) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        after = adapt_weights(Weights(0.9, 1.9, 1.8), 0.5, state, rng)
        changes = np.array(after[1:]) - (1.9, 1.8)
        assert np.sign(changes).tolist() == list(signs)
        assert np.all(np.abs(changes) <= most + 1e-12)
        assert np.all(np.abs(changes) >= most / 2 - 1e-12)


def test_accelerations_stay_in_their_range_and_their_sum_below_4() -> None:
    rng, weights = np.random.default_rng(1), Weights(0.9, 2.0, 2.0)
    for state in np.repeat(STATES, 40):
        weights = adapt_weights(weights, 0.5, int(state), rng)
        assert weights.cognitive + weights.social <= 4 + 1e-12
        assert 1.5 <= weights.cognitive <= 2.5
        assert 1.5 <= weights.social <= 2.5


def test_inertia_grows_with_the_factor_from_0_4_to_0_9() -> None:
    rng = np.random.default_rng(1)
    inertia = [adapt_weights(Weights(0.9, 2, 2), f, 0, rng).inertia for f in (0.0, 0.5, 1.0)]
    assert inertia == pytest.approx([0.4, 1 / (1 + 1.5 * math.exp(-1.3)), 0.9], abs=1e-3)


def converged() -> tuple[Swarm, SwarmContext]:
    """Return a converged swarm before its jump, and a context where each jump has fitness 0.5."""
    chosen = VariantSettings(variant="adaptive", particles=4, generations=10)
    rng = np.random.default_rng(8)
    swarm = next(search(lambda x: 1.0 + x[0] ** 2, PLANE, chosen, rng))

    def lowest(positions: Array) -> Array:
        return np.full(len(positions), 0.5)

    return swarm._replace(state=CONVERGENCE), SwarmContext(lowest, swarm_space(PLANE), chosen, rng)


def test_a_better_jump_becomes_the_leaders_best_and_differs_in_one_dimension() -> None:
    swarm, context = converged()
    after = learn_from_jump(swarm, context)
    old, new = swarm.best_position[swarm.leader], after.best_position[swarm.leader]
    assert np.count_nonzero(old != new) == 1
    assert after.best_fitness[after.leader] == 0.5
    assert np.array_equal(after.position, swarm.position)


def test_a_worse_jump_becomes_the_position_of_the_worst_particle() -> None:
    swarm, context = converged()
    after = learn_from_jump(swarm, context._replace(evaluate=lambda x: np.full(len(x), 1e6)))
    worst = int(np.argmax(swarm.fitness))
    changed = np.any(after.position != swarm.position, axis=1)
    assert np.flatnonzero(changed).tolist() == [worst]
    assert np.array_equal(after.best_position, swarm.best_position)


def test_a_jump_that_beats_only_the_worst_particle_becomes_the_best_of_that_one() -> None:
    swarm, context = converged()
    worst = int(np.argmax(swarm.fitness))
    between = np.sort(swarm.fitness)[-2:].mean()
    after = learn_from_jump(swarm, context._replace(evaluate=lambda x: np.full(len(x), between)))
    assert after.best_fitness[worst] == between
    assert np.array_equal(after.best_position[worst], after.position[worst])
    assert after.leader == swarm.leader


@pytest.mark.parametrize(("generation", "sigma"), [(0, 1.0), (5, 0.55), (10, 0.1), (30, 0.1)])
def test_jumps_shrink_linearly_along_the_schedule(generation: int, sigma: float) -> None:
    swarm, context = converged()
    places = np.array(
        [leader_jump(swarm._replace(generation=generation), context) for _ in range(2000)]
    )
    low, high, _ = context.space
    shares = (places - swarm.best_position[swarm.leader]) / (high - low)
    moved = np.where(shares[:, 0] != 0, shares[:, 0], shares[:, 1])
    assert np.mean(np.abs(moved) < 0.2) == pytest.approx(math.erf(0.2 / sigma / 2**0.5), abs=0.04)
    assert np.all((low <= places) & (places <= high))


def test_only_a_converged_swarm_jumps() -> None:
    swarm, context = converged()
    exploring = swarm._replace(state=EXPLORATION)
    assert learn_from_jump(exploring, context) is exploring


def test_every_jump_is_counted_as_an_evaluation() -> None:
    calls = []

    def cost(position: Array) -> float:
        calls.append(position)
        return float(np.square(position).sum())

    chosen = VariantSettings(variant="adaptive", generations=40)
    *_, last = search(cost, PLANE, chosen, np.random.default_rng(1))
    assert last.evaluations[-1] == len(calls) > 41 * 20
