"""Pure pursuit against the circle that it is the geometry of."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.paths.path import Path, point_at
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import VehicleState
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.pure_pursuit import PurePursuit

CHASSIS = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
SETTINGS = load(ControllerSettings, find("controllers", "table3"))
ROAD = make_path([(0.0, 0.0), (100.0, 0.0)])
both_sides = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])


def circle(radius: float, turn: float = 2.0) -> Path:
    """Return an arc from the origin along x, to the right for a negative radius."""
    a = np.linspace(0.0, turn, 200, dtype=np.float64)
    return make_path(np.column_stack((abs(radius) * np.sin(a), radius * (1 - np.cos(a)))))


def rear(x: float, y: float, yaw: float = 0.0, v_x: float = 9.0) -> VehicleState:
    """Return a state of the rear axle."""
    return VehicleState(0, x, y, yaw, v_x, 0.0, 0.0)


@both_sides
@pytest.mark.parametrize("radius", [10.0, 30.0, 200.0])
@pytest.mark.parametrize("v_x", [0.0, 5.0, 12.0])
def test_rear_axle_on_a_circle_is_kept_on_it(radius: float, v_x: float, side: float) -> None:
    path = circle(side * radius)
    x, y, yaw, _ = point_at(path, 0.3 * radius)
    command = PurePursuit(CHASSIS, SETTINGS).step(rear(x, y, yaw, v_x), path)
    expected = side * math.atan(CHASSIS.wheelbase / radius)
    assert command.steering == pytest.approx(expected, rel=2e-3)


@both_sides
@pytest.mark.parametrize("v_x", [0.0, 9.0, 30.0])
def test_offset_from_a_straight_road_gives_the_chord_s_angle(v_x: float, side: float) -> None:
    look_ahead = max(SETTINGS.look_ahead_time * v_x, SETTINGS.min_look_ahead)
    distance = math.hypot(look_ahead, 0.5)
    expected = -side * math.atan(2 * CHASSIS.wheelbase * (0.5 / distance) / distance)
    command = PurePursuit(CHASSIS, SETTINGS).step(rear(20.0, 0.5 * side, v_x=v_x), ROAD)
    assert command.steering == pytest.approx(expected, rel=1e-9)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    y=st.floats(-20, 20),
    yaw=st.floats(-math.pi, math.pi),
    v_x=st.floats(-5, 40),
    x=st.floats(-50, 150),
)
def test_angle_is_finite_and_within_its_bound_wherever_the_car_is(
    x: float, y: float, yaw: float, v_x: float
) -> None:
    command = PurePursuit(CHASSIS, SETTINGS).step(rear(x, y, yaw, v_x), ROAD)
    assert abs(command.steering) <= SETTINGS.max_angle
    mirrored = PurePursuit(CHASSIS, SETTINGS).step(rear(x, -y, wrap_angle(-yaw), v_x), ROAD)
    assert mirrored.steering == pytest.approx(-command.steering, abs=1e-12)


def test_both_conventions_of_base_link_command_the_same() -> None:
    at_axle, at_cg = PurePursuit(CHASSIS, SETTINGS), PurePursuit(CHASSIS, SETTINGS, 0.0)
    one = rear(20.0, 0.5, 0.1)
    other = at_distance(one, CHASSIS.cg_to_rear_axle)
    command = at_axle.step(one, ROAD)
    assert at_cg.step(other, ROAD).steering == pytest.approx(command.steering, abs=1e-12)
    assert command.diagnosis.cross_track_error == pytest.approx(0.5 + 1.6 * math.sin(0.1))


def test_rate_is_that_of_the_change_of_angle() -> None:
    pursuit = PurePursuit(CHASSIS, SETTINGS)
    before = pursuit.step(rear(10.0, 0.5), ROAD).steering
    command = pursuit.step(rear(10.9, -0.5), ROAD)
    assert command.steering_rate == pytest.approx((command.steering - before) / 0.1)
    pursuit.reset()
    assert pursuit.steering == 0.0


def test_longer_look_ahead_steers_less() -> None:
    angles = [
        abs(PurePursuit(CHASSIS, replace(SETTINGS, look_ahead_time=t)).step(rear(20, 1), ROAD)[1])
        for t in (0.5, 0.7, 1.0, 2.0)
    ]
    assert angles == sorted(angles, reverse=True)


def test_car_beyond_the_end_of_the_path_is_led_on_straight() -> None:
    command = PurePursuit(CHASSIS, SETTINGS).step(rear(140.0, 0.0), ROAD)
    assert command.steering == pytest.approx(0.0, abs=1e-12)
