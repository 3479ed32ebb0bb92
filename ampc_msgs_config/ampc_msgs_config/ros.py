"""Conversion between ROS messages and the types of the project; names and QoS of the topics.

Only the functions that convert headings import compiled code, so that the gate does without it.
"""

import math
from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import MultiArrayDimension, MultiArrayLayout, UInt8MultiArray

from ampc_msgs_config.nodes.qos import *  # noqa: F403 (public names of this module, too)
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.quaternions import quaternion_of, tilt_from_quaternion, yaw_of
from ampc_msgs_config.topics import *  # noqa: F403 (public names of this module, too)
from ampc_msgs_config.topics import BASE_LINK, MAP, STEERING_JOINT, TICK_QUANTITIES
from ampc_msgs_config.types import (
    NANOSECONDS,
    QUATERNION_LENGTH,
    Array,
    Command,
    Plan,
    VehicleState,
)

ODOM_FIELDS = (
    "pose.pose.position.x",
    "pose.pose.position.y",
    "pose.pose.orientation",
    "twist.twist.linear.x",
    "twist.twist.linear.y",
    "twist.twist.angular.z",
)
"""Message fields of the numbers of a VehicleState after its stamp."""
MAX_TILT = math.radians(30.0)
"""Greatest accepted roll and pitch [rad]."""
MAX_STEERING = math.pi / 2
"""Greatest accepted road-wheel angle [rad]."""
ROAD_WHEEL = SteeringParameters(max_angle=1.5)
"""Steering whose topics carry road-wheel angles."""
MAX_TARGET_SPEED = 100.0
"""Greatest accepted target speed [m/s]."""


class Stamped(NamedTuple):
    """Number with its time."""

    stamp_ns: int
    value: float


def decode(data: bytes, message_class: Any) -> Any:
    """Return a message from its CDR bytes.

    Raises:
        ValueError: The bytes do not match the type.
    """
    try:
        return deserialize_message(data, message_class)
    except Exception as error:  # the middleware raises several types
        name = message_class.__name__
        raise ValueError(f"{len(data)} bytes cannot be decoded as {name}") from error


def time_message(stamp_ns: int) -> Time:
    """Return nanoseconds as a ROS time."""
    return Time(sec=stamp_ns // NANOSECONDS, nanosec=stamp_ns % NANOSECONDS)


def nanoseconds(stamp: Time) -> int:
    """Return a ROS time as nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def odometry_message(state: VehicleState, frame_id: str = MAP) -> Odometry:
    """Pack a state: pose in a fixed frame, twist in `base_link`."""
    message = Odometry()
    message.header.stamp = time_message(state.stamp_ns)
    message.header.frame_id, message.child_frame_id = frame_id, BASE_LINK
    message.pose.pose.position.x, message.pose.pose.position.y = state.x, state.y
    q = message.pose.pose.orientation
    q.z, q.w = quaternion_of(state.yaw)
    message.twist.twist.linear.x, message.twist.twist.linear.y = state.v_x, state.v_y
    message.twist.twist.angular.z = state.yaw_rate
    return message


def vehicle_state(message: Odometry) -> VehicleState:
    """Unpack a state, in any fixed frame.

    Raises:
        ValueError: No frame, a number that is not finite, a quaternion far from unit length, or a
            car that lies on its side; with the field's name, its value and the bound.
    """
    require_frame("odom", message.header.frame_id)
    position, q = message.pose.pose.position, message.pose.pose.orientation
    low, high = QUATERNION_LENGTH
    if not low * low <= q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w <= high * high:
        numbers = f"({q.x:g}, {q.y:g}, {q.z:g}, {q.w:g})"
        length = f"must have a length in [{low:g}, {high:g}]"
        raise ValueError(f"odom: pose.pose.orientation = {numbers} {length}")
    tilt = tilt_from_quaternion(q.x, q.y, q.z, q.w)
    for name, angle in zip(("roll", "pitch"), tilt, strict=True):
        if abs(angle) > MAX_TILT:
            degrees, most = math.degrees(angle), math.degrees(MAX_TILT)
            raise ValueError(
                f"odom: {name} of pose.pose.orientation = {degrees:.3g} deg must lie in "
                f"[{-most:g}, {most:g}] deg: x points forward, y to the left, z up"
            )
    state = VehicleState(
        stamp_ns=nanoseconds(message.header.stamp),
        x=position.x,
        y=position.y,
        yaw=yaw_of(q.x, q.y, q.z, q.w),
        v_x=message.twist.twist.linear.x,
        v_y=message.twist.twist.linear.y,
        yaw_rate=message.twist.twist.angular.z,
    )
    for name, value in zip(ODOM_FIELDS, state[1:], strict=True):
        if not math.isfinite(value):
            raise ValueError(f"odom: {name} = {value} must be finite")
    return state


def require_frame(topic: str, frame_id: str) -> None:
    """Raise a ValueError unless a message names its frame."""
    if not frame_id:
        raise ValueError(f"{topic}: header.frame_id = '' must name the fixed frame")


def path_message(points: Array, stamp_ns: int, frame_id: str = MAP) -> Path:
    """Pack points (n, 2) in a fixed frame [m], each oriented towards the next."""
    message = Path()
    message.header.frame_id, message.header.stamp = frame_id, time_message(stamp_ns)
    steps = np.diff(points, axis=0, append=2 * points[-1:] - points[-2:-1])
    for (x, y), (dx, dy) in zip(points.tolist(), steps.tolist(), strict=True):
        pose = PoseStamped()
        pose.header = message.header
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.z, pose.pose.orientation.w = quaternion_of(math.atan2(dy, dx))
        message.poses.append(pose)
    return message


def path_points(message: Path) -> list[tuple[float, float]]:
    """Unpack the positions of a path, in any fixed frame [m].

    Raises:
        ValueError: No frame, a pose in another frame than the path, or a position that is not
            finite; with the field's name, its value and the bound.
    """
    frame_id = message.header.frame_id
    require_frame("reference_path", frame_id)
    points = []
    for i, pose in enumerate(message.poses):
        if pose.header.frame_id not in ("", frame_id):  # empty: that of the path
            where = f"reference_path: poses[{i}].header.frame_id"
            raise ValueError(
                f"{where} = {pose.header.frame_id!r} must be empty or {frame_id!r}, as in the "
                "header of the path"
            )
        x, y = pose.pose.position.x, pose.pose.position.y
        if not (math.isfinite(x) and math.isfinite(y)):
            name, value = ("y", y) if math.isfinite(x) else ("x", x)
            where = f"reference_path: poses[{i}].pose.position.{name}"
            raise ValueError(f"{where} = {value} must be finite")
        points.append((x, y))
    return points


def speed_message(speed: Stamped) -> TwistStamped:
    """Pack a target speed [m/s]."""
    message = TwistStamped()
    message.header.stamp, message.header.frame_id = time_message(speed.stamp_ns), BASE_LINK
    message.twist.linear.x = speed.value
    return message


def target_speed(message: TwistStamped) -> Stamped:
    """Unpack a target speed [m/s].

    Raises:
        ValueError: The speed is not in [0, MAX_TARGET_SPEED].
    """
    speed = message.twist.linear.x
    if not 0.0 <= speed <= MAX_TARGET_SPEED:
        raise ValueError(f"target_speed: {speed:g} must lie in [0, {MAX_TARGET_SPEED:g}] m/s")
    return Stamped(nanoseconds(message.header.stamp), speed)


def steering_message(
    command: Plan | Command, steering: SteeringParameters = ROAD_WHEEL
) -> JointState:
    """Pack a command of a road-wheel angle [rad] and its rate [rad/s]; see `joint_message`."""
    return joint_message(command.stamp_ns, command.steering, command.steering_rate, steering)


def joint_message(
    stamp_ns: int, angle: float, rate: float, steering: SteeringParameters = ROAD_WHEEL
) -> JointState:
    """Pack a road-wheel angle [rad] and its rate [rad/s] as position and velocity.

    Args:
        stamp_ns: Stamp [ns].
        angle: Road-wheel angle [rad].
        rate: Rate of the road-wheel angle [rad/s].
        steering: Ratio and offset of the topic.
    """
    message = JointState()
    message.header.stamp, message.header.frame_id = time_message(stamp_ns), BASE_LINK
    message.name, message.position = [STEERING_JOINT], [steering.position(angle)]
    message.velocity = [steering.ratio * rate]
    return message


def steering_angle(message: JointState, steering: SteeringParameters = ROAD_WHEEL) -> Stamped:
    """Unpack a road-wheel angle [rad].

    Args:
        message: Message of `steering_command` or `steering_state`.
        steering: Ratio and offset of the topic.

    Raises:
        ValueError: The message does not hold exactly one position, or its road-wheel angle is not
            in [-MAX_STEERING, MAX_STEERING].
    """
    return Stamped(
        nanoseconds(message.header.stamp), checked_angle(only_position(message), steering)
    )


def only_position(message: JointState) -> float:
    """Return the position of the only joint of a message.

    Raises:
        ValueError: It does not hold exactly one position.
    """
    positions = list(message.position)
    if len(positions) != 1:
        raise ValueError(f"steering: position = {positions} must hold one angle")
    return float(positions[0])


def checked_angle(position: float, steering: SteeringParameters) -> float:
    """Return the road-wheel angle of a position on the steering topics [rad].

    Raises:
        ValueError: The angle is not in [-MAX_STEERING, MAX_STEERING].
    """
    angle = steering.angle(position)
    if not abs(angle) <= MAX_STEERING:
        low, high = sorted(map(steering.position, (-MAX_STEERING, MAX_STEERING)))
        bounds = f"[{low:.4g}, {high:.4g}] rad"
        raise ValueError(f"steering: position[0] = {position:g} must lie in {bounds}")
    return angle


def tick_message(stamp_ns: int, values: Sequence[float]) -> JointState:
    """Pack the TICK_QUANTITIES of a command."""
    message = JointState()
    message.header.stamp = time_message(stamp_ns)
    message.name, message.position = list(TICK_QUANTITIES), [float(value) for value in values]
    return message


def memory_message(data: bytes, commands: int) -> UInt8MultiArray:
    """Pack the memory of a controller after so many commands."""
    layout = MultiArrayLayout(dim=[MultiArrayDimension(label="commands", size=commands)])
    return UInt8MultiArray(layout=layout, data=array("B", data))


def memory_of(message: UInt8MultiArray) -> tuple[int, bytes]:
    """Unpack the number of commands, and the memory of a controller after them.

    Raises:
        ValueError: The number is missing.
    """
    if not message.layout.dim:
        raise ValueError("memory: layout.dim[0].size must be the number of commands")
    return int(message.layout.dim[0].size), bytes(message.data)


def wind_message(stamp_ns: int, wind: tuple[float, float]) -> Vector3Stamped:
    """Pack a wind velocity in `map` [m/s]."""
    message = Vector3Stamped()
    message.header.stamp, message.header.frame_id = time_message(stamp_ns), MAP
    message.vector.x, message.vector.y = wind
    return message
