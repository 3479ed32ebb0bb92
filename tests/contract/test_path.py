"""Paths: geometry against exact curves, projection against brute force."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.paths import path_fitting
from ampc_msgs_config.paths.path import (
    MAX_PROJECTION_DISTANCE,
    Path,
    Progress,
    cross_track_error,
    curvature_between,
    point_at,
    project,
)
from ampc_msgs_config.paths.path_fitting import MAX_ARC, MAX_LENGTH, extended_back, make_path
from ampc_msgs_config.paths.path_frame import along_chord, path_frame, place, rotate, set_point
from ampc_msgs_config.types import Array, VehicleState

many = settings(max_examples=60, deadline=None, derandomize=True)
both_sides = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])


def arc(radius: float, angle: float, count: int = 60) -> Array:
    """Return points of an arc that starts in the origin along x; a negative radius turns right."""
    turned = np.linspace(0.0, angle, count, dtype=np.float64)
    return np.column_stack((abs(radius) * np.sin(turned), radius * (1 - np.cos(turned))))


def wave(count: int = 200) -> Array:
    """Return points of two periods of a sine of 3 m and 60 m."""
    x = np.linspace(0.0, 120.0, count, dtype=np.float64)
    return np.column_stack((x, 3.0 * np.sin(math.tau * x / 60.0)))


@pytest.mark.parametrize("closed", [False, True])
def test_a_path_of_many_points_is_fitted_as_scipy_fits_one_of_few(
    closed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    gaps = np.random.default_rng(5).uniform(0.2, 3.0, 400)
    angle = np.cumsum(gaps) / gaps.sum() * (math.tau if closed else 4.0)
    points = np.column_stack((100.0 * np.cos(angle), 60.0 * np.sin(angle)))
    expected = make_path(points, 0.0)
    monkeypatch.setattr(path_fitting, "MOST_FOR_SCIPY", 0)
    found = make_path(points, 0.0)
    assert found.closed is expected.closed is closed
    for name in ("x", "y", "heading", "curvature"):
        assert np.allclose(getattr(found, name), getattr(expected, name), rtol=0.0, atol=1e-9)


def figure_of_eight() -> Array:
    """Return points of a curve that crosses itself in the origin at right angles."""
    t = np.linspace(-0.9 * math.pi, 0.9 * math.pi, 400, dtype=np.float64)
    return 60.0 * np.column_stack((np.sin(t), np.sin(t) * np.cos(t)))


def moved(points: Array, turn: float = 0.0, by: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Turn points about the origin [rad], then shift them [m]."""
    return np.asarray(np.array([rotate(x, y, turn) for x, y in points]) + np.array(by))


def state_at(path: Path, s: float, left: float = 0.0) -> VehicleState:
    """Return a car that heads along the path at arc length s, some way to its left [m]."""
    x, y, yaw, _ = point_at(path, s)
    x, y = x - left * math.sin(yaw), y + left * math.cos(yaw)
    return VehicleState(0, x, y, wrap_angle(yaw), 9.0, 0.0, 0.0)


@both_sides
@pytest.mark.parametrize("radius", [10.0, 50.0, 1000.0])
def test_arc_has_the_length_heading_and_curvature_of_its_circle(radius: float, side: float) -> None:
    path = make_path(arc(side * radius, 2.0))
    assert path.length == pytest.approx(2.0 * radius, rel=1e-6)
    s = path.spacing * np.arange(len(path.x))
    np.testing.assert_allclose(path.heading, side * s / radius, atol=5e-4)
    np.testing.assert_allclose(path.curvature, side / radius, rtol=2e-2)  # natural ends included
    np.testing.assert_allclose(path.curvature[20:-20], side / radius, rtol=2e-3)
    np.testing.assert_allclose(np.hypot(path.x, path.y - side * radius), radius, rtol=5e-6)


def test_samples_are_equally_spaced_along_the_curve_however_the_points_are() -> None:
    x = np.cumsum(np.random.default_rng(0).uniform(1.0, 6.0, 60))
    path = make_path(np.column_stack((x, 3.0 * np.sin(x / 15.0))))
    gaps = np.hypot(np.diff(path.x), np.diff(path.y))
    np.testing.assert_allclose(gaps, path.spacing, rtol=2e-3)


def test_arc_length_is_the_integral_of_the_curve() -> None:
    path = make_path(wave(2001))
    x = np.linspace(0.0, 120.0, 200_001)
    slope = 3.0 * math.tau / 60.0 * np.cos(math.tau * x / 60.0)
    assert path.length == pytest.approx(float(np.trapezoid(np.sqrt(1 + slope**2), x)), rel=1e-6)


def test_points_far_apart_are_met_exactly() -> None:
    points = np.array([[0.0, 0.0], [20.0, 1.0], [45.0, -3.0], [70.0, 5.0], [90.0, 5.0]])
    path = make_path(points)
    for x, y in points:
        s = project(path, x, y, 0, len(path.x))
        nearest = point_at(path, s)
        assert math.hypot(nearest.x - x, nearest.y - y) < 1e-3


def test_two_points_give_a_straight_line() -> None:
    path = make_path([(1.0, 2.0), (4.0, 6.0)])
    assert path.length == pytest.approx(5.0)
    np.testing.assert_allclose(path.heading, math.atan2(4.0, 3.0))
    np.testing.assert_allclose(path.curvature, 0.0, atol=1e-12)


def test_duplicate_points_change_nothing() -> None:
    points = wave()
    doubled = np.repeat(points, 3, axis=0)
    for one, other in zip(make_path(points), make_path(doubled), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("at", [(0.0, 0.0), (5.0e5, -4.0e6)], ids=["near", "UTM"])
def test_moved_and_turned_points_give_the_moved_and_turned_path(at: tuple[float, float]) -> None:
    turn = 2.5
    path, other = make_path(wave()), make_path(moved(wave(), turn, at))
    expected = moved(np.column_stack((path.x, path.y)), turn, at)
    np.testing.assert_allclose(np.column_stack((other.x, other.y)), expected, atol=1e-6)
    np.testing.assert_allclose(other.curvature, path.curvature, atol=1e-6)
    np.testing.assert_allclose(other.heading - path.heading, turn, atol=1e-6)


BAD: dict[str, Any] = {
    r"shape \(3,\) must be \(n, 2\)": [1.0, 2.0, 3.0],
    r"shape \(2, 3\) must be \(n, 2\)": [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]],
    r"point 1 = \[nan, 1.0\] must be finite": [[0.0, 0.0], [math.nan, 1.0]],
    r"point 2 = \[3.0, inf\] must be finite": [[0.0, 0.0], [1.0, 1.0], [3.0, math.inf]],
    r"1 different points, at least 2 are needed": [[1.0, 1.0], [1.0, 1.0]],
    r"length = 5e\+06 must be at most 2e\+06 m": [[0.0, 0.0], [5.0e6, 0.0]],
}


@pytest.mark.parametrize("complaint", BAD)
def test_bad_points_are_refused_by_name(complaint: str) -> None:
    with pytest.raises(ValueError, match=f"path: {complaint}"):
        make_path(BAD[complaint])


def test_longest_path_stays_within_memory() -> None:
    assert len(make_path([(0.0, 0.0), (0.9 * MAX_LENGTH, 0.0)]).x) <= 1_000_001


@many
@given(s=st.floats(0.0, 120.0), left=st.floats(-8.0, 8.0))
def test_projection_is_the_nearest_point_of_a_dense_search(s: float, left: float) -> None:
    path = make_path(wave())
    x, y, *_ = state_at(path, s, left)[1:]
    found = project(path, x, y, 0, len(path.x))
    dense = np.linspace(-10.0, path.length + 10.0, 140_001)
    points = np.array([point_at(path, float(t))[:2] for t in dense[::50]])
    coarse = dense[::50][np.argmin(np.hypot(points[:, 0] - x, points[:, 1] - y))]
    fine = np.linspace(coarse - 0.1, coarse + 0.1, 401)
    points = np.array([point_at(path, float(t))[:2] for t in fine])
    distance = np.hypot(points[:, 0] - x, points[:, 1] - y)
    nearest = point_at(path, found)
    assert found == pytest.approx(fine[np.argmin(distance)], abs=0.02)
    assert math.hypot(nearest.x - x, nearest.y - y) == pytest.approx(distance.min(), abs=1e-3)


@many
@given(s=st.floats(1.0, 119.0), left=st.floats(-5.0, 5.0))
def test_cross_track_error_is_the_distance_to_the_left(s: float, left: float) -> None:
    path = make_path(wave())
    error, heading_error = Progress(path).errors(state_at(path, s, left))
    assert error == pytest.approx(left, abs=2e-3)
    assert heading_error == pytest.approx(0.0, abs=5e-3)


@both_sides
@pytest.mark.parametrize("beyond", [0.1, 3.0, 40.0])
def test_path_goes_on_straight_at_both_ends(beyond: float, side: float) -> None:
    path = make_path(arc(side * 30.0, 1.0))
    for s, end in ((-beyond, 0.0), (path.length + beyond, path.length)):
        last = point_at(path, end)
        point = point_at(path, s)
        assert point.x == pytest.approx(last.x + (s - end) * math.cos(last.heading), abs=1e-9)
        assert point.y == pytest.approx(last.y + (s - end) * math.sin(last.heading), abs=1e-9)
        assert (point.heading, point.curvature) == pytest.approx((last.heading, 0.0))
        assert project(path, point.x, point.y, 0, len(path.x)) == pytest.approx(s, abs=1e-6)


@both_sides
@pytest.mark.parametrize("length", [0.1, 3.0, 10.0])
def test_path_is_extended_backwards_along_its_first_arc(length: float, side: float) -> None:
    radius = side * 30.0
    path = make_path(arc(radius, 1.0))
    longer = extended_back(path, length)
    added = len(longer.x) - len(path.x)
    assert length <= added * path.spacing < length + path.spacing
    assert longer.spacing == path.spacing
    for one, other in zip(longer[1:5], path[1:5], strict=True):
        np.testing.assert_array_equal(one[added:], other)
    s = path.spacing * np.arange(-added, 0)
    np.testing.assert_allclose(longer.x[:added], radius * np.sin(s / radius), atol=0.02)
    np.testing.assert_allclose(longer.y[:added], radius * (1 - np.cos(s / radius)), atol=0.02)
    np.testing.assert_allclose(longer.heading[:added], s / radius, atol=0.01)
    np.testing.assert_allclose(longer.curvature[:added], 1 / radius, rtol=0.02)


def test_arc_behind_a_sharp_start_turns_by_one_radian_at_most() -> None:
    path = make_path(arc(3.0, 3.0))
    longer = extended_back(path, 50.0)
    assert longer.heading[0] == pytest.approx(path.heading[0] - MAX_ARC, abs=0.1)
    assert longer.curvature[0] == 0.0
    gaps = np.hypot(np.diff(longer.x), np.diff(longer.y))
    np.testing.assert_allclose(gaps, path.spacing, rtol=5e-3)


def test_closed_path_is_not_extended() -> None:
    path = make_path(arc(40.0, math.tau, 121)[:-1])
    assert extended_back(path, 10.0) is path


def test_arc_length_read_off_points_comes_back_from_them() -> None:
    path = make_path(wave())
    for s in np.linspace(-5.0, path.length + 5.0, 300):
        point = point_at(path, float(s))
        assert project(path, point.x, point.y, 0, len(path.x)) == pytest.approx(s, abs=2e-3)


@many
@given(a=st.floats(0.0, 100.0), length=st.floats(0.0, 20.0))
def test_mean_curvature_is_that_of_the_samples_between(a: float, length: float) -> None:
    path = make_path(wave())
    s = np.linspace(a, a + length, 500)
    mean = np.mean([point_at(path, float(t)).curvature for t in s])
    assert curvature_between(path, a, a + length) == pytest.approx(float(mean), abs=2e-4)


@pytest.mark.parametrize("yaw_known", [True, False])
def test_progress_decides_where_a_path_crosses_itself(yaw_known: bool) -> None:
    path = make_path(figure_of_eight())
    progress = Progress(path)
    for s in np.arange(0.0, path.length, 1.0):
        car = state_at(path, float(s), left=0.3)
        actual = progress.advance(car.x, car.y, car.yaw if yaw_known else math.nan)
        assert actual == pytest.approx(s, abs=0.1)


def test_car_is_first_caught_by_a_part_of_the_path_that_leads_its_way() -> None:
    out = np.column_stack((np.arange(0.0, 100.0, 2.0), np.zeros(50)))
    bend = moved(arc(5.0, math.pi, 20), by=(100.0, 0.0))
    path = make_path(np.concatenate((out, bend, moved(out[::-1], by=(0.0, 10.0)))))
    assert Progress(path).advance(50.0, 2.0, 0.1) == pytest.approx(50.0, abs=0.01)
    back = path.length - 50.0
    assert Progress(path).advance(50.0, 2.0, math.pi - 0.1) == pytest.approx(back, abs=0.01)
    assert Progress(path).advance(50.0, 2.0) == pytest.approx(50.0, abs=0.01)  # heading unknown


def test_of_equally_near_points_the_first_one_counts() -> None:
    path = make_path(arc(40.0, math.tau, 121)[:-1])
    samples = len(path.x) - 1
    assert project(path, path.x[7], path.y[7], 0, 2 * samples) == pytest.approx(7 * path.spacing)


@both_sides
def test_rear_axle_behind_the_start_of_a_circle_is_before_it_not_at_its_end(side: float) -> None:
    points = arc(side * 50.0, 6.6, 700)  # more than a whole turn: it comes by its start again
    path = make_path(points)
    rear = at_distance(state_at(path, 0.0), -1.6)
    assert Progress(path).advance(rear.x, rear.y) == pytest.approx(-1.6, abs=0.05)
    assert Progress(path).advance(rear.x, rear.y, rear.yaw) == pytest.approx(-1.6, abs=0.05)


@pytest.mark.parametrize("distance", [10.0, 100.0])
def test_first_catch_from_afar_is_the_nearest_point(distance: float) -> None:
    path = make_path([(0.0, 0.0), (300.0, 0.0)])
    assert Progress(path).advance(200.0, distance) == pytest.approx(200.0, abs=1e-6)


def test_car_that_is_carried_away_is_caught_again() -> None:
    path = make_path([(0.0, 0.0), (500.0, 0.0)])
    progress = Progress(path)
    progress.advance(10.0, 0.0)
    assert progress.advance(400.0, 1.0) == pytest.approx(400.0, abs=1e-6)
    assert MAX_PROJECTION_DISTANCE < 390.0


def test_circuit_is_closed_and_goes_on_lap_after_lap() -> None:
    points = arc(40.0, math.tau, 121)[:-1]
    path = make_path(points)
    assert path.closed
    assert path.length == pytest.approx(math.tau * 40.0, rel=1e-5)
    progress = Progress(path)
    for s in np.arange(0.0, 3 * path.length, 2.0):
        car = state_at(path, float(s), left=0.5)
        assert progress.advance(car.x, car.y, car.yaw) == pytest.approx(s, abs=0.02)
        assert point_at(path, float(s)).heading == pytest.approx(s / 40.0, abs=1e-3)
        assert point_at(path, float(s)).curvature == pytest.approx(1 / 40.0, rel=1e-2)


def test_path_that_only_ends_near_its_start_is_open() -> None:
    assert not make_path(wave()).closed
    there_and_back = np.concatenate((wave(), moved(wave()[::-1], by=(0.0, 0.3))))
    assert not make_path(there_and_back).closed


@many
@given(turn=st.floats(-math.pi, math.pi), x=st.floats(-1e4, 1e4), y=st.floats(-1e4, 1e4))
def test_inertial_frame_does_not_see_where_in_the_map_the_path_lies(
    turn: float, x: float, y: float
) -> None:
    path = make_path(wave(60))
    plain, frame = path_frame(path), path_frame(make_path(moved(wave(60), turn, by=(x, y))))
    car = state_at(path, 33.0, left=1.0)
    x_car, y_car = rotate(car.x, car.y, turn)
    moved_car = car._replace(x=x_car + x, y=y_car + y, yaw=wrap_angle(car.yaw + turn))
    assert place(frame, *moved_car[1:4]) == pytest.approx(place(plain, *car[1:4]), abs=1e-7)
    along = along_chord(frame, np.array([moved_car[1:3]]))
    np.testing.assert_allclose(along, [place(plain, *car[1:4])[:2]], atol=1e-7)
    assert set_point(frame, 33.0) == pytest.approx(set_point(plain, 33.0), abs=1e-7)


def test_set_point_is_the_path_over_its_chord_and_is_held_beyond_its_ends() -> None:
    frame = path_frame(make_path(wave()))
    for X in (0.0, 15.0, 40.0, 100.0):
        assert set_point(frame, X) == pytest.approx(3.0 * math.sin(math.tau * X / 60.0), abs=1e-3)
    assert set_point(frame, -50.0) == pytest.approx(0.0, abs=1e-9)
    assert set_point(frame, 500.0) == pytest.approx(0.0, abs=1e-9)


@both_sides
def test_path_that_turns_by_ninety_degrees_is_no_graph(side: float) -> None:
    with pytest.raises(ValueError, match=r"turns by .* degrees against its chord"):
        path_frame(make_path(arc(side * 30.0, math.pi)))
    assert path_frame(make_path(arc(side * 30.0, 0.9 * math.pi))).Y.shape  # +- 81 degrees


def test_cross_track_error_is_positive_to_the_left() -> None:
    path = make_path([(0.0, 0.0), (0.0, 50.0)])  # to the north
    assert cross_track_error(point_at(path, 10.0), -2.0, 10.0) == pytest.approx(2.0)
    assert cross_track_error(point_at(path, 10.0), 2.0, 10.0) == pytest.approx(-2.0)
