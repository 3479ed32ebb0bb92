"""Conversion between ROS messages and commands, angles and speeds; needs no compiled code."""

import math
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TwistStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.topics import BASE_LINK, STEERING_JOINT
from ampc_msgs_config.types import NANOSECONDS

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
    positions = list(message.position)
    if len(positions) != 1:
        raise ValueError(f"steering: position = {positions} must hold one angle")
    position, angle = positions[0], steering.angle(positions[0])
    if not abs(angle) <= MAX_STEERING:
        low, high = sorted(map(steering.position, (-MAX_STEERING, MAX_STEERING)))
        bounds = f"[{low:.4g}, {high:.4g}] rad"
        raise ValueError(f"steering: position[0] = {position:g} must lie in {bounds}")
    return Stamped(nanoseconds(message.header.stamp), angle)
