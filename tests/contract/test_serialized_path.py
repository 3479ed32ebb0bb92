"""Serialised paths: read as a table or pose by pose, with the same result and the same bounds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Path
from rclpy.serialization import serialize_message

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.serialized_path import (
    NotTabular,
    has_positions_of,
    positions,
    preamble,
)
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


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    values=st.lists(st.tuples(*[st.floats(width=64)] * 2), max_size=5),
    frames=st.sampled_from(
        [("map", ""), ("map", "map"), ("a", "b"), ("\u00e4", "\u00e4"), ("odom", "")]
    ),
    cut=st.integers(-9, 9),
)
def test_any_message_gives_the_positions_of_its_poses_or_an_error(
    values: list[tuple[float, float]], frames: tuple[str, str], cut: int
) -> None:
    points: Array = np.array(values, dtype=float).reshape(-1, 2)
    data = serialize_message(message(points, *frames))
    data = data[:cut] if cut < 0 else data + b"\xff" * cut
    try:
        found = points_of(data).tobytes()
    except ValueError:
        found = b""
    try:
        expected = np.array(ros.path_points(ros.decode(data, Path)), dtype=float).tobytes()
    except ValueError:
        expected = b""
    assert found == expected


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    index=st.integers(0, 4),
    name=st.sampled_from(["", "stamp", "orientation", "x", "y", "frame", "count", "path frame"]),
    frame=st.sampled_from(["", "map", "odometry"]),
)
def test_a_repeated_path_has_the_same_frames_and_positions(
    index: int, name: str, frame: str
) -> None:
    path = message(np.random.default_rng(2).normal(size=(5, 2)), "map", frame)
    data, pose = serialize_message(path), path.poses[index]
    path.header.stamp.sec += 1
    if name == "stamp":
        pose.header.stamp.nanosec = 7
    elif name == "orientation":
        pose.pose.orientation.z = 1.0
    elif name == "frame":
        pose.header.frame_id = "abc"
    elif name == "count":
        path.poses = path.poses[1:]
    elif name == "path frame":
        path.header.frame_id = "pam"
    elif name:
        setattr(pose.pose.position, name, 1e-300)
    repeated = name in ("", "stamp", "orientation")
    assert has_positions_of(serialize_message(path), data) is repeated
    assert has_positions_of(data, serialize_message(path)) is repeated


@pytest.mark.parametrize("encapsulation", [b"\0\0\0\0", b"\0\3\0\0"], ids=["big endian", "list"])
def test_another_encapsulation_is_no_table(encapsulation: bytes) -> None:
    data = serialize_message(message(np.ones((9, 2)), "map", ""))
    assert preamble(data).poses == 9
    with pytest.raises(NotTabular):
        preamble(encapsulation + data[4:])
