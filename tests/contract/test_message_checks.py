"""Rejected messages: the reason names the field, its value and the bound."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.types import VehicleState

STATE = VehicleState(10**18, 1.0, 2.0, 0.3, 9.0, 0.1, 0.2)
NUMBERS = [
    ("pose.pose.position", "x"),
    ("pose.pose.position", "y"),
    ("twist.twist.linear", "x"),
    ("twist.twist.linear", "y"),
    ("twist.twist.angular", "z"),
]


def inner(message: Any, fields: str) -> Any:
    """Return a part of a message by the names of its fields."""
    for name in fields.split("."):
        message = getattr(message, name)
    return message


@pytest.mark.parametrize(("fields", "name"), NUMBERS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_of_odometry_that_is_not_finite_is_named(
    fields: str, name: str, value: float
) -> None:
    message = ros.odometry_message(STATE)
    setattr(inner(message, fields), name, value)
    with pytest.raises(ValueError, match=rf"^odom: {fields}\.{name} = {value} must be finite$"):
        ros.vehicle_state(message)


@pytest.mark.parametrize("frame", ["map", "odom", "/map", "utm"])
def test_odometry_is_unpacked_in_any_frame(frame: str) -> None:
    assert ros.vehicle_state(ros.odometry_message(STATE, frame)).x == STATE.x


def test_a_message_without_a_frame_is_rejected() -> None:
    with pytest.raises(
        ValueError, match=r"^odom: header\.frame_id = '' must name the fixed frame$"
    ):
        ros.vehicle_state(ros.odometry_message(STATE, ""))


def turned(length: float, component: str = "w") -> Odometry:
    """Return odometry whose quaternion has one component that is not 0."""
    message = ros.odometry_message(STATE)
    orientation = message.pose.pose.orientation
    orientation.z = orientation.w = 0.0
    setattr(orientation, component, length)
    return message


@pytest.mark.parametrize("component", ["z", "w"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_quaternion_is_a_rotation_where_its_length_is_near_one(
    component: str, side: float
) -> None:
    for length in (0.9, math.nextafter(0.9, 1.0), 1.0, math.nextafter(1.1, 1.0), 1.1):
        ros.vehicle_state(turned(side * length, component))
    for length in (0.0, 0.9 - 1e-15, 1.1 + 1e-15, 1e200, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"^odom: pose\.pose\.orientation = \(.*\) must have"):
            ros.vehicle_state(turned(side * length, component))


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("yaw", [0.0, 2.0, -3.0])
def test_a_car_whose_roll_or_pitch_exceeds_30_deg_is_rejected_with_its_name(
    yaw: float, axis: str, side: float
) -> None:
    for tilt_deg, is_accepted in ((0.0, True), (29.9, True), (30.1, False), (80.0, False)):
        half = side * math.radians(tilt_deg) / 2
        message = ros.odometry_message(STATE._replace(yaw=yaw))
        q = message.pose.pose.orientation
        z, w, tilt = math.sin(yaw / 2), math.cos(yaw / 2), math.sin(half)
        q.z, q.w = z * math.cos(half), w * math.cos(half)
        q.x, q.y = (w * tilt, z * tilt) if axis == "x" else (-z * tilt, w * tilt)
        if is_accepted:
            assert ros.vehicle_state(message).yaw == pytest.approx(yaw)
            continue
        name = "roll" if axis == "x" else "pitch"
        text = rf"^odom: {name} of pose\.pose\.orientation = {side * tilt_deg:.3g} deg must lie in "
        with pytest.raises(ValueError, match=text):
            ros.vehicle_state(message)


def test_odometry_with_z_down_is_rejected() -> None:
    message = turned(1.0, "x")
    with pytest.raises(ValueError, match=r"roll of .* = 180 deg .* z up$"):
        ros.vehicle_state(message)


def road(change: Callable[[Path], None]) -> Path:
    """Return a path message with one change."""
    message = ros.path_message(np.array([(5.0 * i, 0.0) for i in range(20)]), 0)
    for pose in message.poses:
        pose.header = type(pose.header)(frame_id=ros.MAP)
    change(message)
    return message


@pytest.mark.parametrize("name", ["x", "y"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_position_of_a_path_that_is_not_finite_is_named(name: str, value: float) -> None:
    message = road(lambda path: setattr(path.poses[17].pose.position, name, value))
    field = rf"poses\[17\]\.pose\.position\.{name}"
    with pytest.raises(ValueError, match=rf"^reference_path: {field} = {value} must be finite$"):
        ros.path_points(message)


def test_poses_of_a_path_have_its_frame_or_none() -> None:
    message = road(lambda path: setattr(path.poses[3].header, "frame_id", ""))
    assert len(ros.path_points(message)) == 20
    message = road(lambda path: setattr(path.poses[3].header, "frame_id", "odom"))
    field = r"^reference_path: poses\[3\]\.header\.frame_id"
    with pytest.raises(ValueError, match=rf"{field} = 'odom' must be empty or 'map', as in the "):
        ros.path_points(message)
    message = road(lambda path: setattr(path.header, "frame_id", ""))
    with pytest.raises(ValueError, match=r"^reference_path: header\.frame_id = '' must name the "):
        ros.path_points(message)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_measured_angle_is_at_most_a_right_angle(side: float) -> None:
    for angle in (math.nextafter(math.pi / 2, 0.0), math.pi / 2):
        message = ros.joint_message(0, side * angle, 0.0)
        assert ros.steering_angle(message).value == side * angle
    for angle in (math.nextafter(math.pi / 2, 2.0), math.nan, math.inf):
        message = ros.joint_message(0, side * angle, 0.0)
        with pytest.raises(
            ValueError, match=r"^steering: position\[0\] = .* must lie in \[-1\.571"
        ):
            ros.steering_angle(message)


@pytest.mark.parametrize("angles", [[], [0.1, 0.2]])
def test_a_measured_angle_is_one_number(angles: list[float]) -> None:
    with pytest.raises(ValueError, match=r"^steering: position = \[.*\] must hold one angle$"):
        ros.steering_angle(JointState(position=angles))
