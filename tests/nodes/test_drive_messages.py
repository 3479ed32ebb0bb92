"""The complete command in the types of several stacks, and measured angles in theirs."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS
from ampc_ros.nodes import drive_messages
from ampc_ros.nodes.drive_messages import OUTPUT, OUTPUTS, DriveCommand, Pedals, load_output
from ampc_ros.nodes.gate_node import GateNode
from ampc_ros.nodes.steering_feedback import FEEDBACK, choose_feedback, mean_position
from tests.message_packages import importable
from tests.ros_nodes import ros_context

PACKAGES = ("ackermann_msgs", "autoware_control_msgs", "autoware_vehicle_msgs", "carla_msgs")
COMMAND = DriveCommand(
    stamp=Time(sec=12, nanosec=500),
    angle=0.1,
    rate=-0.2,
    speed=8.0,
    yaw_rate=8.0 * math.tan(0.1) / 2.7,
    measured_speed=9.0,
    deceleration=2.5,
    max_angle=0.5,
    now=3.0,
)


@pytest.fixture(scope="module", autouse=True)
def _packages() -> Iterator[None]:
    """Make the message packages of the stacks importable."""
    with importable(PACKAGES):
        yield


@pytest.mark.parametrize("name", ["twist", "twist_stamped"])
def test_a_twist_carries_speed_and_yaw_rate(name: str) -> None:
    kind, fill = load_output(name)
    message = kind()
    fill(message, COMMAND)
    twist = getattr(message, "twist", message)
    assert (twist.linear.x, twist.angular.z) == (8.0, COMMAND.yaw_rate)
    if name == "twist_stamped":
        assert message.header.stamp == COMMAND.stamp
        assert message.header.frame_id == "base_link"


@pytest.mark.parametrize("name", ["ackermann", "ackermann_stamped"])
def test_an_ackermann_drive_carries_angle_and_speed_and_no_limit_of_their_rates(name: str) -> None:
    kind, fill = load_output(name)
    message = kind()
    fill(message, COMMAND)
    drive = getattr(message, "drive", message)
    assert drive.steering_angle == pytest.approx(0.1, abs=1e-8)
    assert drive.speed == 8.0
    assert drive.steering_angle_velocity == drive.acceleration == drive.jerk == 0.0


def test_autoware_receives_angle_rate_speed_and_an_acceleration_towards_it() -> None:
    kind, fill = load_output("autoware")
    message = kind()
    fill(message, COMMAND)
    assert message.stamp == message.lateral.stamp == message.longitudinal.stamp == COMMAND.stamp
    assert message.lateral.steering_tire_angle == pytest.approx(0.1)
    assert message.lateral.steering_tire_rotation_rate == pytest.approx(-0.2)
    assert message.lateral.is_defined_steering_tire_rotation_rate
    assert message.longitudinal.velocity == 8.0
    assert message.longitudinal.acceleration == pytest.approx(-2.0)
    assert message.longitudinal.is_defined_acceleration
    fill(message, COMMAND._replace(speed=0.0))
    assert message.longitudinal.acceleration == pytest.approx(-COMMAND.deceleration)
    fill(message, COMMAND._replace(speed=0.0, measured_speed=0.0))
    assert message.longitudinal.acceleration < 0.0, "the car is held"
    fill(message, COMMAND._replace(measured_speed=0.0))
    assert message.longitudinal.acceleration == drive_messages.LARGEST_ACCELERATION


@given(angle=st.floats(-1.5, 1.5), speed=st.floats(0.0, 40.0), measured=st.floats(-5.0, 60.0))
def test_carla_receives_shares_within_their_bounds_with_the_opposite_sign(
    angle: float, speed: float, measured: float
) -> None:
    kind, fill = load_output("carla")
    message = kind()
    fill(message, COMMAND._replace(angle=angle, speed=speed, measured_speed=measured))
    assert message.steer == pytest.approx(np.clip(-angle / COMMAND.max_angle, -1.0, 1.0), abs=1e-6)
    assert 0.0 <= message.throttle <= 1.0
    assert 0.0 <= message.brake <= 1.0
    assert message.throttle == 0.0 or message.brake == 0.0
    assert [message.reverse, message.hand_brake, message.manual_gear_shift] == [False] * 3


def test_a_car_that_cannot_steer_receives_no_share() -> None:
    kind, fill = load_output("carla")
    message = kind()
    fill(message, COMMAND._replace(max_angle=0.0))
    assert message.steer == 0.0


@pytest.mark.parametrize("drag", [0.01, 0.1])
@pytest.mark.parametrize("strength", [2.0, 6.0])
def test_the_pedals_reach_a_speed_without_a_lasting_error_and_hold_the_car(
    drag: float, strength: float
) -> None:
    pedals, v, dt = Pedals(), 0.0, 0.02
    speeds = []
    for i in range(2000):
        target = 8.0 if i < 1500 else 0.0
        command = COMMAND._replace(speed=target, measured_speed=v, now=i * dt)
        pedal = pedals.step(command)
        v = max(v + dt * (strength * pedal - drag * v), 0.0)
        speeds.append(v)
    assert speeds[1499] == pytest.approx(8.0, abs=0.1)
    assert max(speeds) < 10.0
    assert speeds[-1] == 0.0
    assert pedals.step(COMMAND._replace(speed=0.0, measured_speed=0.0, now=99.0)) == -1.0


def test_a_pause_does_not_wind_the_pedals_up() -> None:
    pedals = Pedals()
    first = pedals.step(COMMAND._replace(now=0.0))
    assert pedals.step(COMMAND._replace(now=1000.0)) == pytest.approx(first, abs=0.02)


def test_a_missing_package_is_named_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = drive_messages.DriveMessage("acme_robot_msgs", "Drive", lambda: lambda *_: None)
    monkeypatch.setitem(OUTPUTS, "acme", missing)
    text = "output = acme needs the package acme_robot_msgs, .*ros-jazzy-acme-robot-msgs"
    with pytest.raises(ValueError, match=text):
        load_output("acme")
    monkeypatch.setitem(OUTPUTS, "twist", missing._replace(package="geometry_msgs", name="Acme"))
    with pytest.raises(ValueError, match="geometry_msgs/Acme, which geometry_msgs lacks"):
        load_output("twist")


def test_the_gate_takes_every_output_and_feedback_and_names_the_choices() -> None:
    for output in OUTPUTS:
        with ros_context(output=output):
            node = GateNode()
            assert node.outputs.drive_kind.__name__ == OUTPUTS[output].name
            node.destroy_node()
    for feedback in FEEDBACK:
        with ros_context(feedback=feedback):
            node = GateNode()
            assert (node.feedback is None) == (feedback == "none")
            node.destroy_node()
    with (
        ros_context(output="ackerman"),
        pytest.raises(ValueError, match="output = 'ackerman' must"),
    ):
        GateNode()
    assert OUTPUT == "twist_stamped", "as before there was a choice"


@pytest.mark.parametrize("name", FEEDBACK[1:])
def test_a_report_becomes_a_steering_state_with_its_stamp(name: str) -> None:
    feedback = choose_feedback(name, "")
    assert feedback
    message = feedback.kind()
    if name == "joint_state":
        message.name, message.position = ["steer"], [0.25]
    elif name == "autoware":
        message.steering_tire_angle = 0.25
    else:
        getattr(message, "drive", message).steering_angle = 0.25
    stamped = getattr(message, "header", message)
    if hasattr(stamped, "stamp"):
        stamped.stamp = Time(sec=7)
    state = feedback.state(message, 9 * NANOSECONDS)
    assert state
    assert list(state.position) == [0.25]
    assert state.header.stamp.sec == (9 if name == "ackermann" else 7)
    assert ros.steering_angle(state).value == 0.25


def test_named_joints_are_averaged_others_ignored_and_missing_ones_named() -> None:
    both = ["left", "right"]
    message = JointState(name=["wheel", *both], position=[9.0, 0.2, 0.3])
    assert mean_position(message, both) == pytest.approx(0.25)
    assert mean_position(message, ["right"]) == 0.3
    assert mean_position(JointState(name=["wheel"], position=[9.0]), both) is None
    with pytest.raises(ValueError, match="left, right; right is missing"):
        mean_position(JointState(name=["left"], position=[0.2]), both)
    with pytest.raises(ValueError, match="right is missing"):
        mean_position(JointState(name=both, position=[0.2]), both)
    with pytest.raises(ValueError, match="must hold one angle"):
        mean_position(message, [])


@given(angle=st.floats(-0.52, 0.52), ratio=st.floats(0.3, 0.62))
def test_the_mean_of_both_front_wheels_is_the_angle_of_the_single_track_model(
    angle: float, ratio: float
) -> None:
    curvature = math.tan(angle)  # times the wheelbase
    sides = [math.atan(curvature / (1.0 + side * ratio * curvature)) for side in (-0.5, 0.5)]
    message = JointState(name=["left", "right"], position=sides)
    mean = mean_position(message, ["left", "right"])
    assert mean == pytest.approx(angle, abs=math.radians(0.6))
