"""Shapes of a drive: position of the car, Ackermann angles, thinned paths."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ampc_msgs_config.config import find
from ampc_msgs_config.nodes.scene import (
    CALM,
    MAX_DRAWN_POINTS,
    STOP_COLOUR,
    WIND_TIME,
    Outline,
    Shape,
    View,
    car_of,
    shapes,
    thin_points,
    wheel_angles,
)
from ampc_msgs_config.parameters import ChassisParameters, SizeParameters
from ampc_msgs_config.types import VehicleState
from ampc_msgs_config.vehicle_file import load_section

CAR = Outline(wheelbase=2.8, width=1.8, front_overhang=0.9, rear_overhang=1.0)
NORTH = VehicleState(0, 10.0, 20.0, math.pi / 2, 9.0, 0.0, 0.0)
LINE = np.array([[0.0, 0.0], [5.0, 0.0]])


def drawn(view: View, car: Outline = CAR) -> dict[tuple[str, int], Shape]:
    """Return the shapes by name and number, which must be unique."""
    found = shapes(view, car)
    by_name = {(shape.name, shape.number): shape for shape in found}
    assert len(by_name) == len(found)
    return by_name


def test_body_reaches_from_bumper_to_bumper_about_the_rear_axle() -> None:
    body = drawn(View(NORTH))["car", 0]
    assert body.size[:2] == pytest.approx((0.9 + 2.8 + 1.0, 1.8))
    assert body.position[:2] == pytest.approx((10.0, 20.0 + (2.8 + 0.9 - 1.0) / 2))
    assert body.yaw == NORTH.yaw


def test_wheels_stand_at_the_axles_and_only_the_front_ones_turn() -> None:
    actual = drawn(View(NORTH, steering=0.3))
    front_left, front_right, rear_left, rear_right = (actual["car", i] for i in range(1, 5))
    assert front_left.position[1] == front_right.position[1] == pytest.approx(22.8)
    assert rear_left.position[1] == rear_right.position[1] == pytest.approx(20.0)
    assert front_left.position[0] < 10.0 < front_right.position[0]
    half_track = (CAR.width - front_left.size[1]) / 2  # outer sides in line with the body's
    assert rear_left.position[0] == pytest.approx(10.0 - half_track)
    assert rear_right.position[0] == pytest.approx(10.0 + half_track)
    assert front_left.yaw > front_right.yaw > NORTH.yaw == rear_left.yaw == rear_right.yaw


@pytest.mark.parametrize(("at", "to_cg"), [("rear axle", -1.0), ("centre of gravity", 0.0)])
def test_rear_axle_follows_from_the_point_of_the_odometry(at: str, to_cg: float) -> None:
    chassis = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
    size = load_section(SizeParameters, find("vehicles", "paper"), "size")
    car = car_of(chassis, size, to_cg)
    ahead = 0.0 if at == "rear axle" else -chassis.cg_to_rear_axle
    actual = drawn(View(NORTH), car)
    assert actual["car", 3].position[1] == pytest.approx(20.0 + ahead)
    assert actual["car", 1].position[1] == pytest.approx(20.0 + ahead + chassis.wheelbase)


@given(st.floats(-1.2, 1.2), st.floats(1.5, 4.0), st.floats(1.0, 2.0))
def test_both_front_wheels_turn_about_one_point(
    steering: float, wheelbase: float, track: float
) -> None:
    left, right = wheel_angles(steering, wheelbase, track)
    if abs(steering) > 0.01:  # cot(left) + t/2L = cot(middle) = cot(right) - t/2L
        middle = wheelbase / math.tan(steering)
        assert wheelbase / math.tan(left) + track / 2 == pytest.approx(middle)
        assert wheelbase / math.tan(right) - track / 2 == pytest.approx(middle)
    assert wheel_angles(-steering, wheelbase, track) == pytest.approx((-right, -left))


def test_stop_request_changes_colour_and_text() -> None:
    calm, stop = drawn(View(NORTH)), drawn(View(NORTH, stop=True))
    assert stop["car", 0].colour == STOP_COLOUR != calm["car", 0].colour
    assert "STOP" in stop["text", 0].text
    assert "STOP" not in calm["text", 0].text
    assert "9.0 m/s" in calm["text", 0].text


def test_missing_values_are_not_drawn() -> None:
    assert {name for name, _ in drawn(View(NORTH))} == {"car", "text"}
    view = View(NORTH, wind=(0.0, 8.0), reference=LINE, prediction=LINE)
    names = {"car", "text", "reference_path", "predicted_path", "wind"}
    actual = drawn(view)
    assert {name for name, _ in actual} == names
    for name in ("reference_path", "predicted_path"):  # of a line strip only the width is used
        assert actual[name, 0].size[1:] == (0, 0)
    too_short = View(NORTH, wind=(CALM / 2, 0.0), reference=LINE[:1], prediction=LINE[:1])
    assert {name for name, _ in drawn(too_short)} == {"car", "text"}


def test_wind_blows_from_the_car_in_its_own_direction() -> None:
    arrow = drawn(View(NORTH, wind=(-3.0, 4.0)))["wind", 0]
    assert arrow.points[1] - arrow.points[0] == pytest.approx(WIND_TIME * np.array([-3.0, 4.0]))


@given(st.integers(0, 3000))
def test_paths_are_thinned_evenly_and_keep_their_ends(count: int) -> None:
    points = np.column_stack((np.arange(count), np.zeros(count)))
    thin = thin_points(points)
    assert len(thin) == min(count, MAX_DRAWN_POINTS)
    if count:
        assert (thin[0] == points[0]).all()
        assert (thin[-1] == points[-1]).all()
        steps = np.diff(thin[:, 0])
        assert steps.max(initial=1) - steps.min(initial=steps.max(initial=1)) <= 1


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_paths_that_are_not_finite_are_refused(number: float) -> None:
    with pytest.raises(ValueError, match="1 numbers are not finite"):
        thin_points(np.array([[0.0, 0.0], [number, 1.0]]))
