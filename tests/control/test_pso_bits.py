"""A search is the same, bit for bit, wherever its cost runs and after any interruption."""

import json
import math
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest

from ampc_msgs_config.types import Array
from ampc_ros.pso.minimize import Map, at_once, minimize, search
from ampc_ros.pso.settings import VARIANTS, Dimension, PsoSettings
from ampc_ros.pso.swarm import Swarm, from_json, to_json

PLANE = (Dimension("x", -10.0, 10.0), Dimension("y", -4.0, 6.0))
UNCLAMPED = math.inf


def sphere(position: Array) -> float:
    """Distance from the origin, squared."""
    return float(np.square(position).sum())


def found(variant: str, *, seed: int = 1, map: Map = map) -> Swarm:
    """Minimise on PLANE; gives the last generation."""
    chosen = PsoSettings(variant=variant)
    return minimize(sphere, PLANE, chosen, np.random.default_rng(seed), map).swarm


def sphere_about(centre: Array, position: Array) -> float:
    """Squared distance from a point."""
    return sphere(position - centre)


def assert_same(one: Swarm, other: Swarm) -> None:
    """Bit for bit."""
    for name, left, right in zip(one._fields, one, other, strict=True):
        assert np.array_equal(left, right), name


@pytest.mark.parametrize("variant", VARIANTS)
def test_serial_threads_processes_and_one_call_give_the_same_bits(variant: str) -> None:
    alone = found(variant)
    pools: tuple[Executor, ...] = (ThreadPoolExecutor(3), ProcessPoolExecutor(2))
    for pool in pools:
        with pool:
            assert_same(alone, found(variant, map=pool.map))

    def whole(positions: Array) -> list[float]:
        return [sphere(position) for position in positions]

    chosen = PsoSettings(variant=variant)
    called = minimize(whole, PLANE, chosen, np.random.default_rng(1), at_once)
    assert_same(alone, called.swarm)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_search_resumed_from_a_file_at_any_generation_ends_with_the_same_bits(
    variant: str,
) -> None:
    chosen = PsoSettings(variant=variant)
    swarms = list(search(sphere, PLANE, chosen, np.random.default_rng(3)))
    for saved in swarms[::4]:
        read = from_json(json.loads(json.dumps(to_json(saved), allow_nan=False)))
        assert_same(saved, read)
        end = minimize(sphere, PLANE, chosen, np.random.default_rng(99), resume=read)
        assert_same(swarms[-1], end.swarm)


def test_another_seed_gives_another_search() -> None:
    one, other = found("proposed", seed=1), found("proposed", seed=2)
    assert one.history[-1] != other.history[-1]


@pytest.mark.parametrize("boundary", ["clip", "absorb", "reflect"])
@pytest.mark.parametrize("variant", VARIANTS[:-1])
def test_the_mirrored_problem_has_the_mirrored_search(variant: str, boundary: str) -> None:
    square = tuple(Dimension(name, -10.0, 10.0) for name in "xy")
    chosen = PsoSettings(variant=variant, boundary=boundary, max_velocity=UNCLAMPED)
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
    chosen, rng = PsoSettings(variant=variant), np.random.default_rng(1)
    best = minimize(lambda x: sphere(x / unit), stretched, chosen, rng)
    assert np.array_equal(best.swarm.position, found(variant).position * unit)
