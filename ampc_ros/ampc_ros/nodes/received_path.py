"""From a serialised path to one that the controller can use; runs in the background process."""

import math
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.nodes.serialized_path import (
    MAX_POSES,
    NotTabular,
    has_positions_of,
    positions,
    preamble,
)
from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import Array


class Shift(NamedTuple):
    """Planar transform from the frame of a path into the fixed frame."""

    x: float = 0.0
    """Origin of the path's frame in the fixed frame [m]."""
    y: float = 0.0
    """Origin of the path's frame in the fixed frame [m]."""
    yaw: float = 0.0
    """Direction of its x axis in the fixed frame [rad]."""

    def apply(self, points: Array) -> Array:
        """Return points (n, 2) in the fixed frame [m]."""
        if self == Shift():
            return points
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        turned: Array = points @ np.array([[cos, sin], [-sin, cos]])
        return np.asarray(turned + np.array([self.x, self.y]))


class PathRequest(NamedTuple):
    """Everything that determines a path, apart from the message."""

    shift: Shift
    chassis: ChassisParameters
    max_angle: float
    """Largest steering angle [rad]."""
    path_noise: float | None
    """Known noise of the points, standard deviation [m]; None: it is estimated."""


class BuiltPath(NamedTuple):
    """A path with its points; both None where they are those of the request before."""

    points: Array | None
    """(n, 2) [m]."""
    path: Path | None
    """None also for a message without poses."""


LARGEST_COMPARED = 16_000_000
"""Size of a message up to which comparing it does not delay a command [bytes]."""


class RepeatedPath:
    """Recognises a path that is sent again with the same positions, before it is built again."""

    def __init__(self) -> None:
        """Start without a path."""
        self._data = b""
        self._request: PathRequest | None = None
        self._tag: Any = None
        self._is_built = False

    def submit(self, tag: Any, data: bytes, request: PathRequest) -> None:
        """Remember the newest path, which is being built; the tag identifies it."""
        self._tag, self._data, self._request, self._is_built = tag, data, request, False

    def complete(self, tag: Any) -> None:
        """Remember that the path with this tag is built."""
        self._is_built = tag is self._tag

    def matches(self, data: bytes, request: PathRequest) -> bool:
        """Return whether a message is the newest path again, which is built."""
        if not self._is_built or request != self._request or len(data) > LARGEST_COMPARED:
            return False
        return has_positions_of(data, self._data)


_newest: tuple[PathRequest, Array, Path] | None = None


def header_of(data: bytes) -> tuple[int, str]:
    """Return stamp [ns] and frame of a serialised path.

    Raises:
        ValueError: Too large, or no path.
    """
    try:
        start = preamble(data)
    except NotTabular:
        message = _decoded(data)
        return _stamp_ns(message), message.header.frame_id
    return start.stamp_ns, start.frame_id


def prepare() -> None:
    """Import and run everything once that a first path needs."""
    from ampc_msgs_config.paths.path_fitting import make_path
    from ampc_ros.supervision import checks

    make_path([(checks.MAX_GAP * i, 0.1 * i * i) for i in range(20)])


def build_path(data: Any, request: PathRequest) -> BuiltPath:
    """Build a path from a serialised message.

    Args:
        data: Serialised nav_msgs/Path.
        request: Transform and car.

    Raises:
        ValueError: The path cannot be driven.
    """
    global _newest
    from ampc_ros.supervision.checks import check_path

    points = request.shift.apply(points_of(bytes(data)))
    if not len(points):
        return BuiltPath(points, None)
    if _newest and _newest[0] == request and np.array_equal(_newest[1], points):
        return BuiltPath(None, None)
    path = check_path(points, request.chassis, request.max_angle, path_noise=request.path_noise)
    _newest = request, points, path
    return BuiltPath(points, path)


def points_of(data: bytes) -> Array:
    """Return the positions of a serialised path (n, 2) [m].

    Raises:
        ValueError: Too large, no path, or a wrong field.
    """
    try:
        return positions(data, preamble(data))
    except NotTabular:
        from ampc_msgs_config import ros

        message = _decoded(data)
        if len(message.poses) > MAX_POSES:
            count = len(message.poses)
            raise ValueError(f"reference_path: {count} poses must be at most {MAX_POSES}") from None
        return np.array(ros.path_points(message), dtype=float).reshape(-1, 2)


def _decoded(data: bytes) -> Any:
    from nav_msgs.msg import Path as PathMessage

    from ampc_msgs_config import ros

    return ros.decode(data, PathMessage)


def _stamp_ns(message: Any) -> int:
    from ampc_msgs_config import ros

    return ros.nanoseconds(message.header.stamp)
