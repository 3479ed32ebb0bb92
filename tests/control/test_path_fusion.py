"""A new path is averaged with the driven one, and continued backwards by it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.paths.path import Path, project
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array
from ampc_ros.supervision.path_fusion import (
    FUSION_TIME,
    MAX_BLENDED,
    RUN_IN,
    extended,
    fused,
    samples_at,
)

RADIUS = 50.0


def bend(first: float, last: float, radius: float = RADIUS) -> Path:
    """Return an arc to the left about (0, radius), from one arc length of the circle to another."""
    a = np.arange(first, last, 0.5) / RADIUS
    return make_path(np.column_stack((radius * np.sin(a), RADIUS - radius * np.cos(a))), 0.0)


def distances(path: Path) -> Array:
    """Return the distance of all samples from the centre of the circle (n,) [m]."""
    return np.hypot(path.x, path.y - RADIUS)


def mirrored(path: Path) -> Path:
    return path._replace(y=-path.y, heading=-path.heading, curvature=-path.curvature)


def test_the_same_path_again_is_not_changed() -> None:
    path = bend(0.0, 150.0)
    again = fused(path, 40.0, path, 40.0, 0.1)
    np.testing.assert_allclose(again[1:5], path[1:5], atol=1e-9)
    assert again.entry == round(40.0 / path.spacing)


@given(lead=st.floats(0.5, 8.0), elapsed=st.floats(0.0, 2.0), sign=st.sampled_from([1.0, -1.0]))
@settings(max_examples=50, deadline=None)
def test_a_path_that_begins_ahead_of_the_car_is_continued_backwards_along_the_road(
    lead: float, elapsed: float, sign: float
) -> None:
    old, new = bend(0.0, 100.0), bend(40.0 + lead, 130.0)
    if sign < 0:
        old, new = mirrored(old), mirrored(new)
    path = fused(old, 40.0, new, -lead, elapsed)
    np.testing.assert_allclose(np.hypot(path.x, path.y - sign * RADIUS), RADIUS, atol=0.02)
    np.testing.assert_allclose(path.curvature[5:-5], sign / RADIUS, atol=1e-3)
    assert np.hypot(np.diff(path.x), np.diff(path.y)) == pytest.approx(path.spacing, rel=1e-3)
    assert (path.entry * path.spacing) == pytest.approx(RUN_IN, abs=2 * path.spacing)
    car = RADIUS * math.sin(40.0 / RADIUS), sign * RADIUS * (1.0 - math.cos(40.0 / RADIUS))
    s = project(path, *car, 0, len(path.x))
    assert s == pytest.approx(path.entry * path.spacing, abs=2 * path.spacing)


def test_a_first_path_that_begins_ahead_is_continued_by_the_bend_of_its_beginning() -> None:
    path = extended(bend(43.0, 130.0), -3.0)
    near = path.spacing * (np.arange(len(path.x)) - path.entry) > -5.0
    np.testing.assert_allclose(distances(path)[near], RADIUS, atol=0.01)


@given(shift=st.floats(-0.29, 0.29), elapsed=st.floats(0.0, 3.0))
@settings(max_examples=50, deadline=None)
def test_a_small_shift_is_averaged_by_the_time_since_the_last_path(
    shift: float, elapsed: float
) -> None:
    path = fused(bend(0.0, 150.0), 60.0, bend(0.0, 150.0, RADIUS + shift), 60.0, elapsed)
    s: Array = np.arange(55.0, 90.0, dtype=np.float64)
    here = samples_at(path, s * ((RADIUS + shift) / RADIUS))
    expected = RADIUS + shift * (1.0 - math.exp(-elapsed / FUSION_TIME))
    np.testing.assert_allclose(np.hypot(here.x, here.y - RADIUS), expected, atol=0.01)
    direction = np.unwrap(np.arctan2(np.diff(path.y), np.diff(path.x)))
    np.testing.assert_allclose(direction, (path.heading[1:] + path.heading[:-1]) / 2, atol=2e-3)


@pytest.mark.parametrize("shift", [-1.0, -0.4, 0.4, 3.5])
def test_another_path_replaces_the_driven_one_at_once(shift: float) -> None:
    assert abs(shift) > MAX_BLENDED
    new = bend(0.0, 150.0, RADIUS + shift)
    np.testing.assert_array_equal(fused(bend(0.0, 150.0), 60.0, new, 60.0, 0.1)[1:5], new[1:5])


@pytest.mark.parametrize("radius", [10.0, 15.0, RADIUS])
@pytest.mark.parametrize("share", [0.01, 0.3, 0.99])
def test_laps_stay_closed_and_smooth(share: float, radius: float) -> None:
    """The laps of the small circles are shorter than the range of the average."""
    a = np.arange(0.0, math.tau, 1.0 / radius)
    lap = make_path(radius * np.column_stack((np.sin(a), 1.0 - np.cos(a))))
    other = make_path(
        np.column_stack((0.1 + radius * np.sin(a + 1.0), radius - radius * np.cos(a + 1.0)))
    )
    place = share * lap.length
    assert lap.closed
    assert other.closed
    path = fused(lap, place, other, (place - radius) % other.length, 0.1)
    assert (path.x[0], path.y[0]) == (path.x[-1], path.y[-1])
    turn = other.heading[-1] - other.heading[0]
    assert path.heading[-1] - path.heading[0] == pytest.approx(turn)
    assert np.hypot(np.diff(path.x), np.diff(path.y)).max() < 1.02 * path.spacing
    assert np.hypot(path.x - 0.1, path.y - radius) == pytest.approx(radius, abs=0.12)
    assert np.abs(np.diff(path.heading) / path.spacing - 1.0 / radius).max() < 0.01


@pytest.mark.parametrize("s_new", [-1e15, -1e6, -21.0, 1e6, 1e15])
@pytest.mark.parametrize("s_old", [-1e15, 40.0, 1e15])
def test_a_car_far_from_both_paths_needs_no_memory_and_gets_a_valid_entry(
    s_old: float, s_new: float
) -> None:
    for old in (bend(0.0, 100.0), bend(0.0, 20.0)):
        path = fused(old, s_old, bend(30.0, 130.0), s_new, 0.1)
        assert 0 <= path.entry < len(path.x)
        assert len(path.x) < 1000
        assert np.isfinite(np.concatenate(path[1:5])).all()
