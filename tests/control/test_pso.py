"""Particle swarms: Eqs. (31)-(34), bounds, boundary rules, integer dimensions."""

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.types import Array
from ampc_ros.pso.minimize import Minimum, minimize, search
from ampc_ros.pso.swarm import Dimension, PsoSettings, Swarm
from launch_scripts.study.pso_variants import VARIANTS, VariantSettings

PLANE = (Dimension("x", -10.0, 10.0), Dimension("y", -4.0, 6.0))
MIXED = (Dimension("N_p", 1, 55, integer=True), Dimension("R", 0.001, 0.1))
UNCLAMPED = math.inf


def sphere(position: Array) -> float:
    """Return the squared distance from the origin."""
    return float(np.square(position).sum())


def minimize_on_plane(variant: str, **chosen: Any) -> Minimum:
    """Minimise the sphere function on PLANE."""
    chosen_settings = VariantSettings(variant=variant, **chosen)
    return minimize(sphere, PLANE, chosen_settings, np.random.default_rng(1))


def swarm_of_two(position: Array, velocity: Array, best: Array, cost: Any) -> Swarm:
    """Return a swarm of two particles in the middle of a search."""
    fitness = np.array([cost(x) for x in best])
    start = next(search(cost, PLANE, PsoSettings(particles=2), np.random.default_rng(5)))
    return start._replace(
        position=position,
        velocity=velocity,
        best_position=best,
        best_fitness=fitness,
    )


def test_particles_move_as_equation_31_says() -> None:
    x, v = np.array([[3.0, 1.0], [-2.0, 5.0]]), np.array([[0.5, -0.25], [0.0, 1.0]])
    best = np.array([[2.0, 1.0], [-1.0, 0.5]])
    swarm = swarm_of_two(x, v, best, sphere)
    chosen = VariantSettings(
        variant="classic",
        particles=2,
        generations=1,
        max_velocity=UNCLAMPED,
        initial_cognitive=1.5,
        initial_social=2.5,
    )
    rng = np.random.default_rng()
    *_, moved = search(sphere, PLANE, chosen, rng, resume=swarm)
    rng.bit_generator.state = swarm.random
    r = rng.random((2, 2, 2))
    for i in range(2):
        for k in range(2):
            own = 1.5 * r[0, i, k] * (best[i, k] - x[i, k])
            common = 2.5 * r[1, i, k] * (best[1, k] - x[i, k])
            assert moved.velocity[i, k] == pytest.approx(0.99 * v[i, k] + own + common, abs=1e-12)
            assert moved.position[i, k] == pytest.approx(x[i, k] + moved.velocity[i, k], abs=1e-12)


def test_inertia_follows_equations_32_and_33() -> None:
    def inertia(variant: str, g: int) -> float:
        return VariantSettings(variant=variant, schedule_length=100).weights(g).inertia

    assert inertia("linear", 0) == 0.99
    assert inertia("linear", 50) == pytest.approx(0.545)
    assert inertia("linear", 200) == pytest.approx(0.1)
    assert inertia("damped", 2) == pytest.approx(0.99**3)
    assert inertia("classic", 70) == 0.99
    assert inertia("proposed", 0) == pytest.approx(0.1 + 2.691234 / 3, abs=1e-6)
    assert inertia("proposed", 10) == pytest.approx(0.1 + math.exp(0.99 - 3.27) / 3)


@pytest.mark.parametrize(
    ("g", "c_1"), [(0, 2.0), (20, 3.0), (35, 3.3), (75, 1.9), (100, 1.8625), (200, 1.7125)]
)
def test_accelerations_follow_equation_34_and_keep_their_sum(g: int, c_1: float) -> None:
    _, cognitive, social = PsoSettings(generations=100).weights(g)
    assert cognitive == pytest.approx(c_1)
    assert cognitive + social == pytest.approx(4.0)


def test_the_authors_code_stays_in_the_branch_that_its_number_of_particles_picks() -> None:
    def cognitive(particles: int, length: int) -> float:
        chosen = VariantSettings(
            variant="authors_code", particles=particles, schedule_length=length
        )
        return chosen.weights(10).cognitive

    assert cognitive(10, 5) == pytest.approx(2 - 10 * 0.0015)
    assert cognitive(20, 100) == pytest.approx(2 + 10 * 0.05)


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_best_fitness_never_rises_and_belongs_to_the_position(variant: str) -> None:
    best = minimize_on_plane(variant, generations=30)
    assert np.all(np.diff(best.history) <= 0)
    assert best.history[-1] == best.fitness == sphere(best.position)
    assert best.fitness < best.history[0]
    assert len(best.history) == len(best.evaluations) == 31


@given(
    st.sampled_from(VARIANTS),
    st.sampled_from(("clip", "absorb", "reflect")),
    st.sampled_from((0.01, 0.2, 3.0, UNCLAMPED)),
    st.integers(0, 2**32),
)
@settings(max_examples=60, deadline=None)
def test_no_particle_leaves_its_bounds_or_exceeds_its_speed(
    variant: str, boundary: str, clamp: float, seed: int
) -> None:
    corner = partial(sphere_about, np.array([-10.0, 6.0]))
    chosen = VariantSettings(variant=variant, boundary=boundary, max_velocity=clamp, generations=8)
    low, high = np.array([-10.0, -4.0]), np.array([10.0, 6.0])
    for swarm in search(corner, PLANE, chosen, np.random.default_rng(seed)):
        assert np.all((low <= swarm.position) & (swarm.position <= high))
        assert np.all(np.abs(swarm.velocity) <= clamp * (high - low))


def sphere_about(centre: Array, position: Array) -> float:
    """Return the squared distance from a point."""
    return sphere(position - centre)


@pytest.mark.parametrize(
    ("boundary", "position", "velocity"),
    [("clip", 10.0, 3.0), ("absorb", 10.0, 0.0), ("reflect", 8.0, -3.0)],
)
def test_each_boundary_rule_treats_a_particle_that_leaves_as_documented(
    boundary: str, position: float, velocity: float
) -> None:
    x, v = np.array([[9.0, 0.0], [9.0, 0.0]]), np.array([[3.0, 0.0], [3.0, 0.0]])
    swarm = swarm_of_two(x, v, x, sphere)
    chosen = VariantSettings(
        variant="classic",
        max_inertia=1.0,
        particles=2,
        generations=1,
        boundary=boundary,
        max_velocity=UNCLAMPED,
    )
    *_, moved = search(sphere, PLANE, chosen, np.random.default_rng(), resume=swarm)
    assert moved.position[0].tolist() == [position, 0.0]
    assert moved.velocity[0].tolist() == [velocity, 0.0]


def test_the_cost_sees_the_nearest_whole_number_where_a_dimension_is_an_integer() -> None:
    seen: list[float] = []

    def cost(position: Array) -> float:
        seen.append(position[0])
        return float((position[0] - 7.2) ** 2 + position[1])

    chosen = PsoSettings(generations=20)
    swarms = list(search(cost, MIXED, chosen, np.random.default_rng(2)))
    flown = np.concatenate([swarm.position[:, 0] for swarm in swarms])
    assert set(seen) <= set(range(1, 56))
    assert np.abs(np.array(seen) - flown).max() <= 0.5
    best = minimize(cost, MIXED, chosen, np.random.default_rng(2))
    assert best.position[0] == 7.0 != best.swarm.best_position[best.swarm.leader, 0]


def test_an_equal_fitness_does_not_replace_the_best_position() -> None:
    first, *_, last = search(lambda _: 1.0, PLANE, PsoSettings(), np.random.default_rng(1))
    assert np.array_equal(last.best_position, first.position)


def test_the_variants_end_in_the_order_that_the_paper_claims_on_the_sphere() -> None:
    space = tuple(Dimension(f"x{k}", -10.0, 10.0) for k in range(5))

    def median(variant: str) -> float:
        chosen = VariantSettings(
            variant=variant, generations=41, schedule_length=100, max_velocity=UNCLAMPED
        )
        runs = (minimize(sphere, space, chosen, np.random.default_rng(s)) for s in range(15))
        return float(np.median([run.fitness for run in runs]))

    proposed, linear, damped, classic = map(median, VARIANTS[:4])
    assert proposed < 0.1 < 0.5 < min(linear, damped)
    assert max(linear, damped) < 5 < classic
