"""Topics, quality of service, and the way between messages and our types. ROS starts here."""

import math
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry, Path
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.path import Array
from ampc_msgs_config.path_file import choose_scenario
from ampc_msgs_config.scenario import Scenario
from ampc_msgs_config.types import (
    NANOSECONDS,
    Command,
    Diagnosis,
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


def path_message(points: Array, stamp_ns: int) -> Path:
    """Pack points (n, 2) in `map` [m], each heading for the next."""
    message = Path()
    message.header.frame_id, message.header.stamp = MAP, time_message(stamp_ns)
    steps = np.diff(points, axis=0, append=2 * points[-1:] - points[-2:-1])
    for (x, y), (dx, dy) in zip(points.tolist(), steps.tolist(), strict=True):
        pose = PoseStamped()
        pose.header = message.header
        pose.pose.position.x, pose.pose.position.y = x, y
        orientation = pose.pose.orientation
        orientation.z, orientation.w = quaternion_from_yaw(math.atan2(dy, dx))
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


DEBUG_QUANTITIES = (*Diagnosis._fields, "solve_time")
"""Topics below `~/debug/` of the controller, one std_msgs/Float64 each."""


def diagnostics_message(node: Node, trouble: str, values: dict[str, float]) -> DiagnosticArray:
    """Pack the health of a node: WARN with the trouble in words, or OK."""
    status = DiagnosticStatus(
        level=DiagnosticStatus.WARN if trouble else DiagnosticStatus.OK,
        name=node.get_fully_qualified_name(),
        message=trouble or "OK",
        values=[KeyValue(key=key, value=f"{value:.6g}") for key, value in values.items()],
    )
    message = DiagnosticArray(status=[status])
    message.header.stamp = node.get_clock().now().to_msg()
    return message


def declare_scenario(node: Node) -> Scenario:
    """Declare the parameters that choose a drive, and load it."""
    vehicle = declare(node, "vehicle", "paper", "shipped vehicle, or YAML file")
    name = declare(node, "scenario", "sc1", "shipped scenario, or YAML file")
    path = declare(node, "path", "", "CSV of x_m,y_m[,v_mps] or t_s,x_m,y_m instead")
    speed = declare(node, "speed", -1.0, "constant speed instead [m/s]; -1: as given", (-1, 100))
    size = load(SizeParameters, find("vehicles", vehicle), "size")
    return choose_scenario(name, path, None if speed < 0 else speed, size)


def declare(node: Node, name: str, default: Any, description: str, bounds: Any = None) -> Any:
    """Declare a read-only parameter with its description and range, and give its value.

    Args:
        node: Owner.
        name: Of the parameter.
        default: Value, which sets the type.
        description: For `ros2 param describe`.
        bounds: (low, high) of a number, or a list of the words that are allowed.
    """
    descriptor = ParameterDescriptor(description=description, read_only=True)
    if isinstance(default, float) and bounds:
        span = FloatingPointRange(from_value=float(bounds[0]), to_value=float(bounds[1]))
        descriptor.floating_point_range = [span]
    elif bounds:
        descriptor.additional_constraints = "one of: " + ", ".join(bounds)
    value = node.declare_parameter(name, default, descriptor).value
    if isinstance(bounds, list) and value not in bounds:
        raise ValueError(f"parameter {name} = {value!r} must be one of {', '.join(bounds)}")
    return value


def spin(make_node: Callable[[], Node]) -> int:
    """Run one node until it ends itself, or is told to; gives the exit code of the process.

    A set-up that is wrong ends in one line on stderr and exit code 2.
    """
    rclpy.init()
    node = None
    try:
        node = make_node()
        rclpy.spin(node)
    except (ValueError, ParameterException) as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
