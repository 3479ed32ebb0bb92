"""Topics, quality of service, and the way between messages and our types. ROS starts here."""

import math
from typing import NamedTuple

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from ampc_msgs_config.types import (
    NANOSECONDS,
    Command,
    VehicleState,
    quaternion_from_yaw,
    yaw_from_quaternion,
)

ODOM = "odom"
REFERENCE_PATH = "reference_path"
TARGET_SPEED = "target_speed"
STEERING_COMMAND = "steering_command"
STEERING_STATE = "steering_state"
WIND = "wind"
CLOCK = "/clock"
DIAGNOSTICS = "/diagnostics"

MAP = "map"
BASE_LINK = "base_link"
STEERING_JOINT = "front_steering"

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Subscribers of measurements: a late sample is worth nothing."""
RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""Publishers, and subscribers that want all: ten samples cover a recorder's hiccup."""
COMMAND = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Whoever acts on a command acts on the newest."""
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""The path: who comes late gets it too."""
EVERYTHING = QoSProfile(
    depth=0, history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE
)
"""The recorder."""


class Stamped(NamedTuple):
    """A number and the time to which it belongs."""

    stamp_ns: int
    value: float


def time_message(stamp_ns: int) -> Time:
    """Give nanoseconds as a ROS time."""
    return Time(sec=stamp_ns // NANOSECONDS, nanosec=stamp_ns % NANOSECONDS)


def nanoseconds(stamp: Time) -> int:
    """Give a ROS time as nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def odometry_message(state: VehicleState) -> Odometry:
    """Pack a state: pose in `map`, twist in `base_link`."""
    message = Odometry()
    message.header.stamp = time_message(state.stamp_ns)
    message.header.frame_id, message.child_frame_id = MAP, BASE_LINK
    message.pose.pose.position.x, message.pose.pose.position.y = state.x, state.y
    orientation = message.pose.pose.orientation
    orientation.z, orientation.w = quaternion_from_yaw(state.yaw)
    message.twist.twist.linear.x, message.twist.twist.linear.y = state.v_x, state.v_y
    message.twist.twist.angular.z = state.yaw_rate
    return message


def vehicle_state(message: Odometry) -> VehicleState:
    """Unpack a state.

    Raises:
        ValueError: A number is not finite, or the quaternion is zero.
    """
    position, q = message.pose.pose.position, message.pose.pose.orientation
    if q.x == q.y == q.z == q.w == 0.0:
        raise ValueError("odom: pose.pose.orientation = (0, 0, 0, 0) is no rotation")
    state = VehicleState(
        stamp_ns=nanoseconds(message.header.stamp),
        x=position.x,
        y=position.y,
        yaw=yaw_from_quaternion(q.x, q.y, q.z, q.w),
        v_x=message.twist.twist.linear.x,
        v_y=message.twist.twist.linear.y,
        yaw_rate=message.twist.twist.angular.z,
    )
    for name, value in state._asdict().items():
        if not math.isfinite(value):
            raise ValueError(f"odom: {name} = {value} must be finite")
    return state


def path_message(points: list[tuple[float, float, float]], stamp_ns: int) -> Path:
    """Pack points (x [m], y [m], heading [rad]) in `map`."""
    message = Path()
    message.header.frame_id, message.header.stamp = MAP, time_message(stamp_ns)
    for x, y, heading in points:
        pose = PoseStamped()
        pose.header = message.header
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.z, pose.pose.orientation.w = quaternion_from_yaw(heading)
        message.poses.append(pose)
    return message


def path_points(message: Path) -> list[tuple[float, float]]:
    """Unpack the positions of a path [m].

    Raises:
        ValueError: The path is in another frame than `map`.
    """
    if message.header.frame_id != MAP:
        raise ValueError(f"reference_path: frame_id = {message.header.frame_id!r} must be {MAP!r}")
    return [(pose.pose.position.x, pose.pose.position.y) for pose in message.poses]


def speed_message(speed: Stamped) -> TwistStamped:
    """Pack a target speed [m/s]."""
    message = TwistStamped()
    message.header.stamp, message.header.frame_id = time_message(speed.stamp_ns), BASE_LINK
    message.twist.linear.x = speed.value
    return message


def target_speed(message: TwistStamped) -> Stamped:
    """Unpack a target speed [m/s]."""
    return Stamped(nanoseconds(message.header.stamp), message.twist.linear.x)


def steering_message(command: Command) -> JointState:
    """Pack a command: position = angle [rad], velocity = rate [rad/s]."""
    return joint_message(command.stamp_ns, command.steering, command.steering_rate)


def joint_message(stamp_ns: int, angle: float, rate: float) -> JointState:
    """Pack a road-wheel angle [rad] and its rate [rad/s]."""
    message = JointState()
    message.header.stamp, message.header.frame_id = time_message(stamp_ns), BASE_LINK
    message.name, message.position, message.velocity = [STEERING_JOINT], [angle], [rate]
    return message


def steering_angle(message: JointState) -> Stamped:
    """Unpack a road-wheel angle [rad].

    Raises:
        ValueError: The message holds no position, or one that is not finite.
    """
    if not message.position or not math.isfinite(message.position[0]):
        raise ValueError(f"steering: position = {list(message.position)} must hold a finite angle")
    return Stamped(nanoseconds(message.header.stamp), message.position[0])


def wind_message(stamp_ns: int, wind: tuple[float, float]) -> Vector3Stamped:
    """Pack a wind velocity in `map` [m/s]."""
    message = Vector3Stamped()
    message.header.stamp, message.header.frame_id = time_message(stamp_ns), MAP
    message.vector.x, message.vector.y = wind
    return message
