"""Any list of points becomes a path that can be driven; projections onto it take constant time."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ampc_msgs_config.paths.path import (
    AHEAD,
    BEHIND,
    NOT_CAUGHT,
    Path,
    Progress,
    advance,
    curvature_between,
    point_at,
)
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array

RADIUS = 50.0


def arc(angles: NDArray[Any]) -> Array:
    """Points of a left-hand circle about (0, RADIUS) that starts at the origin."""
    return RADIUS * np.column_stack((np.sin(angles), 1 - np.cos(angles)))


def on_circle(path: Path) -> Array:
    """Distance of each sample from the circle [m]."""
    return np.asarray(np.hypot(path.x, path.y - RADIUS) - RADIUS)


@pytest.mark.parametrize("spacing", [0.05, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0])
def test_points_of_any_spacing_give_the_same_bend(spacing: float) -> None:
    path = make_path(arc(np.arange(0.0, 4.0, spacing / RADIUS)))
    assert np.abs(on_circle(path)).max() < 0.01
    inner = path.curvature[40:-40]
    np.testing.assert_allclose(inner, 1 / RADIUS, rtol=0.05)


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_uneven_points_with_duplicates_give_the_same_bend(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.cumsum(rng.uniform(0.05, 4.0, 80)) / RADIUS
    path = make_path(arc(np.repeat(angles[angles < 4.0], rng.integers(1, 4))))
    assert np.abs(on_circle(path)).max() < 0.02
    assert path.curvature[20:-20] == pytest.approx(1 / RADIUS, rel=0.25)


def test_points_that_jitter_are_averaged() -> None:
    points = arc(np.arange(0.0, 4.0, 0.05 / RADIUS))
    jitter = 0.01 * np.random.default_rng(1).standard_normal(points.shape)
    path = make_path(points + jitter)
    assert np.abs(on_circle(path)).max() < 0.02
    assert np.abs(np.diff(path.heading)).max() < 0.1


def test_a_right_angle_becomes_a_bend_near_the_corner() -> None:
    path = make_path([*((x, 0.0) for x in range(21)), *((20.0, y) for y in range(1, 21))])
    assert path.heading[0] == pytest.approx(0.0, abs=0.01)
    assert path.heading[-1] == pytest.approx(math.pi / 2, abs=0.01)
    corner = np.maximum(np.abs(path.y), np.abs(path.x - 20.0))
    assert np.minimum(np.abs(path.y), np.abs(path.x - 20.0)).max() < 0.3
    assert np.isfinite(path.curvature).all()
    assert np.abs(path.curvature[corner > 8.0]).max() < 0.01


def test_samples_lie_at_equal_arc_length() -> None:
    path = make_path(arc(np.array([0.0, 0.1, 0.15, 0.4, 0.8, 1.0, 1.5])))
    steps = np.hypot(np.diff(path.x), np.diff(path.y))
    np.testing.assert_allclose(steps, path.spacing, rtol=1e-3)


def test_a_path_that_starts_behind_the_car_is_met_beside_the_car() -> None:
    progress = Progress(make_path([(-100.0, 0.0), (100.0, 0.0)]))
    assert progress.advance(0.0, 2.0, 0.0) == pytest.approx(100.0)


def test_a_path_that_starts_ahead_of_the_car_is_extended_back() -> None:
    path = make_path([(10.0, 0.0), (100.0, 0.0)])
    assert Progress(path).advance(0.0, 2.0, 0.0) == pytest.approx(-10.0)
    assert point_at(path, -10.0)[:2] == pytest.approx((0.0, 0.0))


def test_a_closed_path_goes_on_for_any_number_of_laps() -> None:
    path = make_path(arc(np.arange(0.0, math.tau, 0.02)))
    assert path.closed
    progress = Progress(path)
    for angle in np.arange(0.0, 3 * math.tau, 0.05).tolist():
        x, y = arc(np.array([angle]))[0]
        s = progress.advance(x, y, angle)
        assert s == pytest.approx(RADIUS * angle, abs=0.02)
    assert curvature_between(path, s - 10.0, s + 500.0) == pytest.approx(1 / RADIUS, rel=1e-3)


def test_a_path_far_from_the_origin_keeps_its_digits() -> None:
    points, far = arc(np.arange(0.0, 4.0, 0.01)), np.array([1e6, -1e6])
    here, there = make_path(points), make_path(points + far)
    np.testing.assert_allclose(there.curvature, here.curvature, rtol=0, atol=1e-6)
    np.testing.assert_allclose(there.heading, here.heading, rtol=0, atol=1e-7)


def test_where_a_path_crosses_itself_progress_decides() -> None:
    t = np.arange(0.0, math.tau, 0.01)
    eight = make_path(60.0 * np.column_stack((np.sin(t), np.sin(2 * t) / 2)))
    progress, last = Progress(eight), 0.0
    for s in np.arange(0.0, 2 * eight.length, 1.0).tolist():
        point = point_at(eight, s)
        actual = progress.advance(point.x, point.y, point.heading)
        assert actual == pytest.approx(s, abs=0.05)
        assert actual >= last
        last = actual


@pytest.mark.parametrize("count", [1_000, 20_000])
def test_each_step_looks_at_a_window_of_constant_size(count: int) -> None:
    x = np.arange(count, dtype=float)
    path = make_path(np.column_stack((x, 5 * np.sin(x / 100))))
    for share in (0.1, 0.5, 0.9):
        car = point_at(path, share * path.length)
        s, index = advance(path, NOT_CAUGHT, car.x, car.y, car.heading)
        ahead = point_at(path, s + 5.0)
        behind, before = math.ceil(BEHIND / path.spacing), math.ceil(AHEAD / path.spacing)
        seen = slice(index - behind, index + before + 1)
        lure = path._replace(x=np.full_like(path.x, ahead.x), y=np.full_like(path.y, ahead.y))
        lure.x[seen], lure.y[seen] = path.x[seen], path.y[seen]
        actual = advance(lure, index, ahead.x, ahead.y, ahead.heading)
        assert actual == advance(path, index, ahead.x, ahead.y, ahead.heading)
        assert actual[0] == pytest.approx(s + 5.0, abs=1e-3)
