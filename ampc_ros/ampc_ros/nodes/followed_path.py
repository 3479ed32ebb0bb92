"""Paths of other planners, for which our planner publishes the target speed.

`path`: a nav_msgs/Path on `reference_path`, with a constant speed or a limit of the lateral
acceleration. `timed_path`: the stamps of its poses are arrival times, from which the speed follows.
`autoware`: an Autoware Trajectory on `trajectory`, with a speed for each point; its positions are
published as `reference_path`.
"""

import pickle
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node

from ampc_msgs_config import ros, topics
from ampc_msgs_config.nodes.base_node import BaseNode, declare
from ampc_msgs_config.nodes.inputs import Inputs
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_file import SpeedLimits
from ampc_msgs_config.scenarios.scenario import PathWithSpeed
from ampc_msgs_config.types import NANOSECONDS, Array
from ampc_ros.nodes.background import NICENESS, Background
from ampc_ros.nodes.fixed_frame import FixedFrame
from ampc_ros.nodes.message_packages import import_message
from ampc_ros.nodes.received_path import Shift, points_of, prepare

NO_ROUTE = "none"
"""The planner drives the route of its own parameters."""
AUTOWARE = "autoware"
FOLLOW = [NO_ROUTE, "path", "timed_path", AUTOWARE]
"""Values of the parameter `follow`."""
MOST_TIMED_POINTS = 100_000
"""Largest number of points with a speed each."""


class FollowedPath(NamedTuple):
    """Path of another planner."""

    points: Array | None
    """(n, 2) in the fixed frame [m]; None: path and speed are those of the message before."""
    stamp_ns: int
    route: PathWithSpeed | None = None
    """None also for a message without points."""


_last_built: Any = None


def declare_limits(node: BaseNode, kind: str) -> SpeedLimits:
    """Declare the limits of the speed on followed paths.

    Raises:
        ValueError: Nothing defines a speed, or the drive is in lock-step.
    """
    text = "largest speed [m/s]; -1: that of the path, or the limit of the lateral acceleration"
    speed = declare(node, "speed", -1.0, text, (-1, 100))
    text = "largest lateral acceleration [m/s^2]; -1: no limit"
    acceleration = declare(node, "lateral_acceleration", -1.0, text, (-1, 20))
    if kind == "path" and speed <= 0.0 and acceleration <= 0.0:
        raise ValueError(
            f"follow = {kind} needs a speed: speed = {speed:g} or lateral_acceleration = "
            f"{acceleration:g} must be greater than 0"
        )
    if node.lock_step:
        raise ValueError(f"follow = {kind} needs lock_step = false")
    limits = SpeedLimits()
    return limits._replace(
        speed=speed if speed > 0.0 else limits.speed,
        lateral_acceleration=acceleration if acceleration > 0.0 else limits.lateral_acceleration,
    )


class Follower:
    """Receives the paths of another planner; another process builds them."""

    def __init__(
        self,
        node: Node,
        inputs: Inputs,
        kind: str,
        limits: SpeedLimits,
        on_path: Callable[[FollowedPath], None],
        reject: Callable[[ValueError], None],
    ) -> None:
        """Subscribe.

        Args:
            node: Owner.
            inputs: Its subscriptions.
            kind: One of FOLLOW but the first.
            limits: Limits of the speed.
            on_path: Receives each new path.
            reject: Receives what is wrong with one.

        Raises:
            ValueError: The package of the message is missing.
        """
        self.kind, self.limits, self.on_path, self.reject = kind, limits, on_path, reject
        self.topic = topics.TRAJECTORY if kind == AUTOWARE else topics.REFERENCE_PATH
        self.frame: FixedFrame | None = None
        self.newest: bytes | None = None
        self.is_built = node.create_guard_condition(self.on_built)
        self.builder = Background(self.is_built.trigger, NICENESS)
        self.builder.submit(None, prepare)
        message = trajectory_class() if kind == AUTOWARE else PathMessage
        inputs.add(message, self.topic, self.on_data, *ros.ANY_PUBLISHER, raw=True)

    def use_frame(self, frame: FixedFrame) -> None:
        """Use paths from now on, in the frame of the odometry."""
        self.frame = frame
        if self.newest is not None:
            self.on_data(self.newest)

    def on_data(self, data: bytes) -> None:
        """Have a path built; before the first odometry, the newest one waits."""
        self.newest = data
        if self.frame is None:
            return
        try:
            stamp_ns, frame_id = header(data)
            shift = self.frame.shift(frame_id, stamp_ns)
        except ValueError as error:
            self.reject(error)
            return
        request = self.kind, stamp_ns, shift, self.limits
        self.builder.submit(True, build_route, pickle.PickleBuffer(data), *request)

    def on_built(self) -> None:
        """Pass the paths on that are built."""
        for tag, outcome in self.builder.take():
            try:
                path = outcome.result()
                if tag:
                    self.on_path(path)
            except ValueError as error:
                self.reject(error)
        if not self.builder.is_alive:
            self.builder = Background(self.is_built.trigger, NICENESS)

    def close(self) -> None:
        """End the process."""
        self.builder.close()


def trajectory_class() -> Any:
    """Return Autoware's Trajectory.

    Raises:
        ValueError: The package is missing.
    """
    return import_message("autoware_planning_msgs", "Trajectory", f"follow = {AUTOWARE}")


def header(data: bytes) -> tuple[int, str]:
    """Return stamp [ns] and frame of any message that begins with a header.

    Raises:
        ValueError: No header, or no frame.
    """
    from std_msgs.msg import Header

    found = ros.decode(data, Header)
    ros.require_frame("path", found.frame_id)
    return ros.nanoseconds(found.stamp), found.frame_id


def build_route(
    data: Any, kind: str, stamp_ns: int, shift: Shift, limits: SpeedLimits
) -> FollowedPath:
    """Build path and speed from a serialised message; an equal one only once.

    Args:
        data: Serialised message.
        kind: One of FOLLOW but the first.
        stamp_ns: Stamp of the message [ns].
        shift: Transform into the fixed frame.
        limits: Limits of the speed.

    Raises:
        ValueError: Field, value and bound.
    """
    global _last_built
    from ampc_msgs_config.paths.path_fitting import make_path

    points, columns = with_speeds(bytes(data), kind)
    points = shift.apply(points)
    key = points.tobytes(), *(each.tobytes() for each in columns.values()), limits
    if _last_built == key:
        return FollowedPath(None, stamp_ns)
    followed = FollowedPath(points, stamp_ns)
    if len(points):
        path = make_path(points)
        followed = followed._replace(route=with_limits(path, points, columns, limits))
    _last_built = key
    return followed


def with_limits(
    path: Path, points: Array, columns: dict[str, Array], limits: SpeedLimits
) -> PathWithSpeed:
    """Return a path with its speed within the limits.

    Raises:
        ValueError: A speed is out of range; index, value and bound.
    """
    from ampc_msgs_config.paths.path_file import speed_along
    from ampc_msgs_config.scenarios.scenario import SpeedProfile

    speed = speed_along(path, points, columns, None, limits)
    at = np.asarray(path.spacing * np.arange(len(speed)))
    period = path.length if path.closed else np.inf
    return PathWithSpeed(path, SpeedProfile(True, at, speed, float(period)))


def with_speeds(data: bytes, kind: str) -> tuple[Array, dict[str, Array]]:
    """Return the positions of a message (n, 2) [m], and speed `v` or time `t` of each (n,).

    Raises:
        ValueError: Field, value and bound.
    """
    if kind == "path":
        return points_of(data), {}
    if kind == AUTOWARE:
        return trajectory_points(ros.decode(data, trajectory_class()))
    message = ros.decode(data, PathMessage)
    if (count := len(message.poses)) > MOST_TIMED_POINTS:
        raise ValueError(f"reference_path: {count} poses must be at most {MOST_TIMED_POINTS}")
    points = np.array(ros.path_points(message), dtype=float).reshape(-1, 2)
    times = [ros.nanoseconds(pose.header.stamp) for pose in message.poses]
    for i in range(1, len(times)):
        if times[i] <= times[i - 1] and (points[i] != points[i - 1]).any():
            raise ValueError(
                f"reference_path: poses[{i}].header.stamp = {times[i] / NANOSECONDS:.3f} s must be "
                f"later than {times[i - 1] / NANOSECONDS:.3f} s before it: it is the arrival time"
            )
    seconds = (np.array(times, dtype=np.int64) - (times[0] if times else 0)) / NANOSECONDS
    return points, {"t": seconds}


def trajectory_points(message: Any) -> tuple[Array, dict[str, Array]]:
    """Return positions (n, 2) [m] and speeds `v` (n,) [m/s] of an Autoware Trajectory.

    Raises:
        ValueError: A field is not finite, or a speed leads backwards; with index and value.
    """
    if len(message.points) > MOST_TIMED_POINTS:
        raise ValueError(
            f"trajectory: {len(message.points)} points must be at most {MOST_TIMED_POINTS}"
        )
    rows = []
    for i, point in enumerate(message.points):
        at, speed = point.pose.position, point.longitudinal_velocity_mps
        row = at.x, at.y, float(speed)
        names = "pose.position.x", "pose.position.y", "longitudinal_velocity_mps"
        for name, value in zip(names, row, strict=True):
            if not np.isfinite(value):
                raise ValueError(f"trajectory: points[{i}].{name} = {value} must be finite")
        if not 0.0 <= speed <= ros.MAX_TARGET_SPEED:
            raise ValueError(
                f"trajectory: points[{i}].longitudinal_velocity_mps = {speed:g} must lie in "
                f"[0, {ros.MAX_TARGET_SPEED:g}] m/s: the controller does not drive backwards"
            )
        rows.append(row)
    table = np.array(rows, dtype=float).reshape(-1, 3)
    return table[:, :2].copy(), {"v": table[:, 2].copy()}
