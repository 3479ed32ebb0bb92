"""Serialised paths: read as a table or pose by pose, with the same result and the same bounds."""

import math

import numpy as np
import pytest
from nav_msgs.msg import Path
from rclpy.serialization import serialize_message

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.serialized_path import NotTabular, positions, preamble
from ampc_msgs_config.types import Array
from ampc_ros.nodes.received_path import points_of

STAMP_NS = 5_000_000_007


def message(points: Array, frame: str, pose_frame: str) -> Path:
    """Return a path whose poses have a frame of their own."""
    path = ros.path_message(np.vstack((points, [(0.0, 0.0), (1.0, 1.0)])), STAMP_NS, frame)
    path.poses = path.poses[: len(points)]
    for pose in path.poses:
        pose.header = type(pose.header)(frame_id=pose_frame)
    return path


@pytest.mark.parametrize(
    "frame", ["m", "ma", "map", "odom", "abcde", "abcdef", "abcdefg", "k\u00e4rt"]
)
@pytest.mark.parametrize("count", [0, 1, 2, 3, 17])
def test_a_table_gives_the_positions_of_the_message(frame: str, count: int) -> None:
    points = np.random.default_rng(count).normal(size=(count, 2))
    for pose_frame in ("", frame):
        data = serialize_message(message(points, frame, pose_frame))
        start = preamble(data)
        assert (start.stamp_ns, start.frame_id, start.poses) == (STAMP_NS, frame, count)
        assert np.array_equal(positions(data, start), points)


def test_poses_with_several_frames_are_read_one_by_one() -> None:
    points = np.random.default_rng(1).normal(size=(9, 2))
    for index, frame in ((0, "map"), (4, "map"), (8, "map"), (4, "m")):
        path = message(points, "map", "" if frame == "map" else "map")
        path.poses[index].header.frame_id = frame
        data = serialize_message(path)
        with pytest.raises(NotTabular):
            positions(data, preamble(data))
        if frame == "map":
            assert np.array_equal(points_of(data), points)
        else:
            with pytest.raises(ValueError, match=r"poses\[4\]\.header\.frame_id = 'm' must be"):
                points_of(data)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_position_that_is_not_finite_is_named(value: float) -> None:
    points = np.zeros((9, 2))
    points[7, 1] = value
    with pytest.raises(
        ValueError, match=rf"poses\[7\]\.pose\.position\.y = {value} must be finite"
    ):
        points_of(serialize_message(message(points, "map", "")))


def test_a_message_that_is_cut_is_rejected() -> None:
    data = serialize_message(message(np.ones((9, 2)), "map", ""))
    for size in (0, 3, 4, 17, 30, 200, len(data) - 60):
        with pytest.raises(ValueError, match="cannot be decoded as Path"):
            points_of(data[:size])


@pytest.mark.parametrize("encapsulation", [b"\0\0\0\0", b"\0\3\0\0"], ids=["big endian", "list"])
def test_another_encapsulation_is_no_table(encapsulation: bytes) -> None:
    data = serialize_message(message(np.ones((9, 2)), "map", ""))
    assert preamble(data).poses == 9
    with pytest.raises(NotTabular):
        preamble(encapsulation + data[4:])
