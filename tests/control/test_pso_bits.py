"""A search is the same, bit for bit, wherever its cost runs and after any interruption."""

import math
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest

from ampc_msgs_config.types import Array
from ampc_ros.pso.minimize import MapFunction, map_vectorized, minimize, search
from ampc_ros.pso.swarm import Dimension, Swarm
from launch_scripts.study.pso_variants import VARIANTS, VariantSettings

PLANE = (Dimension("x", -10.0, 10.0), Dimension("y", -4.0, 6.0))
UNCLAMPED = math.inf


def sphere(position: Array) -> float:
    """Return the squared distance from the origin."""
    return float(np.square(position).sum())


def last_swarm(variant: str, *, seed: int = 1, map: MapFunction = map) -> Swarm:
    """Return the last generation of a search on PLANE."""
    chosen = VariantSettings(variant=variant)
    return minimize(sphere, PLANE, chosen, np.random.default_rng(seed), map).swarm


def sphere_about(centre: Array, position: Array) -> float:
    """Return the squared distance from a point."""
    return sphere(position - centre)


def assert_same(one: Swarm, other: Swarm) -> None:
    """Check that two swarms are equal bit for bit."""
    for name, left, right in zip(one._fields, one, other, strict=True):
        assert np.array_equal(left, right), name


@pytest.mark.parametrize("variant", VARIANTS)
def test_serial_threads_processes_and_one_call_give_the_same_bits(variant: str) -> None:
    alone = last_swarm(variant)
    pools: tuple[Executor, ...] = (ThreadPoolExecutor(3), ProcessPoolExecutor(2))
    for pool in pools:
        with pool:
            assert_same(alone, last_swarm(variant, map=pool.map))

    def whole(positions: Array) -> list[float]:
        return [sphere(position) for position in positions]

    chosen = VariantSettings(variant=variant)
    called = minimize(whole, PLANE, chosen, np.random.default_rng(1), map_vectorized)
    assert_same(alone, called.swarm)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_search_resumed_at_any_generation_ends_with_the_same_bits(
    variant: str,
) -> None:
    chosen = VariantSettings(variant=variant)
    swarms = list(search(sphere, PLANE, chosen, np.random.default_rng(3)))
    for saved in swarms[::4]:
        end = minimize(sphere, PLANE, chosen, np.random.default_rng(99), resume=saved)
        assert_same(swarms[-1], end.swarm)


def test_another_seed_gives_another_search() -> None:
    one, other = last_swarm("proposed", seed=1), last_swarm("proposed", seed=2)
    assert one.history[-1] != other.history[-1]


@pytest.mark.parametrize("boundary", ["clip", "absorb", "reflect"])
@pytest.mark.parametrize("variant", VARIANTS[:-1])
def test_the_mirrored_problem_has_the_mirrored_search(variant: str, boundary: str) -> None:
    square = tuple(Dimension(name, -10.0, 10.0) for name in "xy")
    chosen = VariantSettings(variant=variant, boundary=boundary, max_velocity=UNCLAMPED)
    centre = np.array([9.0, -3.0])
    there, back = partial(sphere_about, centre), partial(sphere_about, -centre)
    swarms = list(search(there, square, chosen, np.random.default_rng(4)))
    first = swarms[0]
    mirrored = first._replace(position=-first.position, best_position=-first.best_position)
    end = minimize(back, square, chosen, np.random.default_rng(), resume=mirrored).swarm
    assert np.array_equal(end.position, -swarms[-1].position)
    assert np.array_equal(end.history, swarms[-1].history)


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_unit_of_a_dimension_does_not_change_the_search(variant: str) -> None:
    stretched = (PLANE[0], Dimension("y", -4.0 * 1024, 6.0 * 1024))
    unit = np.array([1.0, 1024.0])
    chosen, rng = VariantSettings(variant=variant), np.random.default_rng(1)
    best = minimize(lambda x: sphere(x / unit), stretched, chosen, rng)
    assert np.array_equal(best.swarm.position, last_swarm(variant).position * unit)
