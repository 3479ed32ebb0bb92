"""Numbers of messages read as a table equal those of messages decoded one by one."""

import itertools
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zstandard
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Header

from ampc_msgs_config import ros, topics
from ampc_msgs_config.nodes.serialized_path import NotTabular
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.recording.message_types import type_name_of
from launch_scripts.bags import collector
from launch_scripts.bags.bag import Bag, BagMessage
from launch_scripts.bags.cdr_tables import layout_of, read_table

STEERING = SteeringParameters(max_angle=0.5, ratio=15.0, offset=0.01)
UNUSUAL = (math.nan, math.inf, -math.inf, 1e13, -1e300, -0.0, 5e-324)


def odometry(rng: np.random.Generator) -> Odometry:
    """Return odometry, some of it unusual."""
    message = Odometry()
    message.header.frame_id = str(rng.choice(["map", "odom", "m", ""], p=[0.8, 0.1, 0.05, 0.05]))
    message.child_frame_id = str(rng.choice(["base_link", ""], p=[0.9, 0.1]))
    position, q = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y, position.z = rng.normal(0.0, 1e3, 3)
    roll = rng.choice([0.0, rng.uniform(-1.0, 1.0)], p=[0.8, 0.2])
    half, yaw = roll / 2, rng.uniform(-math.pi, math.pi) / 2
    length = rng.choice([1.0, rng.uniform(0.0, 2.0)], p=[0.9, 0.1])
    q.x = length * math.sin(half) * math.cos(yaw)
    q.y = length * math.sin(half) * math.sin(yaw)
    q.z, q.w = length * math.cos(half) * math.sin(yaw), length * math.cos(half) * math.cos(yaw)
    message.pose.covariance = rng.normal(size=36)
    message.twist.twist.linear.x, message.twist.twist.linear.y = rng.normal(0.0, 10.0, 2)
    message.twist.twist.angular.z = unusual(rng)
    return message


def joint(rng: np.random.Generator) -> JointState:
    """Return a steering angle, some of it out of range or not one number."""
    message = JointState(name=[str(rng.choice(["steering", "wheel_left"]))])
    message.header.frame_id = str(rng.choice(["base_link", "b"], p=[0.9, 0.1]))
    count = int(rng.choice([1, 0, 2], p=[0.9, 0.05, 0.05]))
    message.position = rng.uniform(-30.0, 30.0, count).tolist()
    message.velocity = rng.normal(size=int(rng.choice([1, 0]))).tolist()
    return message


def tick(rng: np.random.Generator) -> JointState:
    """Return the quantities of a tick, some of other names or numbers."""
    names = list(topics.TICK_QUANTITIES)
    if rng.random() < 0.1:
        names[3] = names[3][::-1]
    count = len(names) - int(rng.random() < 0.1)
    values = [unusual(rng) for _ in range(count)]
    return JointState(name=names, position=values)


def unusual(rng: np.random.Generator) -> float:
    """Return a number that is seldom an unusual one."""
    return float(rng.choice(UNUSUAL)) if rng.random() < 0.05 else float(rng.normal(0.0, 10.0))


def wind(rng: np.random.Generator) -> Vector3Stamped:
    """Return a wind."""
    message = Vector3Stamped()
    message.vector.x, message.vector.y = unusual(rng), unusual(rng)
    return message


def speed(rng: np.random.Generator) -> TwistStamped:
    """Return a target speed, some out of range."""
    message = TwistStamped()
    message.twist.linear.x = unusual(rng) * 10.0
    return message


MESSAGES: dict[str, Callable[[np.random.Generator], Any]] = {
    topics.ODOM: odometry,
    topics.STEERING_COMMAND: joint,
    topics.STEERING_STATE: joint,
    topics.TICK: tick,
    topics.WIND: wind,
    topics.TARGET_SPEED: speed,
    topics.QUANTITIES[0]: lambda rng: Float64(data=unusual(rng)),
}


def serialised(name: str, message: Any, stamp: int, rng: np.random.Generator) -> bytes:
    """Return a message as stored in a bag: sometimes compressed, cut, or with other padding."""
    if hasattr(message, "header"):
        message.header.stamp = ros.time_message(stamp)
    data = bytes(serialize_message(message))
    kind = rng.random()
    if kind < 0.03:
        return zstandard.compress(data)
    if kind < 0.06:
        return data[: int(rng.integers(len(data)))]
    if kind < 0.10:
        return data + bytes(8)
    return data


def collected(sent: list[BagMessage], types: dict[str, str]) -> dict[str, Any]:
    """Return the content of all columns."""
    bag: Any = SimpleNamespace(topics=types)
    bag.decode = lambda message: Bag.decode(bag, message)
    found = collector.Collector(bag, "/", "/odom", STEERING)
    for message in sent:
        found.take(message)
    found.finish()
    return {
        name: (
            *(list(part) for part in (column.log_times, column.stamps)),
            np.asarray(column.numbers).tobytes(),
            column.rejected,
        )
        for name, column in found.columns.items()
    }


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", MESSAGES)
def test_tables_give_what_single_messages_give(
    name: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng([seed, len(name)])
    monkeypatch.setattr(collector, "BATCH", 40)
    sent, types = [], {"/" + name: type_name_of(type(MESSAGES[name](rng)))}
    for number in range(300):
        data = serialised(name, MESSAGES[name](rng), 1_000_000_000 * number + 7, rng)
        sent.append(BagMessage("/" + name, number, number, data))
    decoded, decode = list[BagMessage](), Bag.decode

    def counted(bag: Bag, message: BagMessage) -> Any:
        decoded.append(message)
        return decode(bag, message)

    monkeypatch.setattr(Bag, "decode", counted)
    by_table = collected(sent, types)
    few = len(decoded)

    def no_layout(*_: object) -> None:
        raise NotTabular

    monkeypatch.setattr(collector, "layout_of", no_layout)
    one_by_one = collected(sent, types)
    assert by_table == one_by_one
    assert one_by_one[name][0], "some messages are accepted"
    assert one_by_one[name][3] > 0, "some are rejected"
    if len(one_by_one[name][0]) > len(sent) / 2:  # seldom, all ticks differ from the first one
        assert few < 0.75 * (len(decoded) - few)  # most are read as a table


def test_bytes_between_the_values_may_have_any_value() -> None:
    message = JointState(name=["a"], position=[0.5])
    message.header.frame_id = "b"
    data = bytes(serialize_message(message))
    layout = layout_of("sensor_msgs/msg/JointState", data)
    free = {*range(len(data))} - {*layout.fixed.tolist()}
    free -= {*range(4, 12), *itertools.chain(*(range(n, n + 8) for n in layout.numbers))}
    changed = bytes(0xA5 if at in free else byte for at, byte in enumerate(data))
    assert changed != data
    assert deserialize_message(changed, JointState) == message
    assert read_table([changed, data], layout, data).belongs.all()


def test_a_wrong_byte_of_a_text_or_length_leaves_the_table() -> None:
    data = bytes(serialize_message(JointState(name=["abc"], position=[0.5], velocity=[1.0])))
    layout = layout_of("sensor_msgs/msg/JointState", data)
    for at in layout.fixed.tolist():
        changed = bytearray(data)
        changed[at] ^= 1
        assert not read_table([bytes(changed)], layout, data).belongs.any()


@pytest.mark.parametrize(
    ("type_name", "data"),
    [
        ("std_msgs/msg/Bool", b"\0\1\0\0\1"),
        ("std_msgs/msg/Float64", b"\0\0\0\0" + bytes(8)),
        ("std_msgs/msg/Float64", b"\0\1\0\0" + bytes(7)),
        ("sensor_msgs/msg/JointState", b"\0\1\0\0" + bytes(40)),
        ("sensor_msgs/msg/JointState", b"\0\1\0\0" + bytes(8) + b"\xff" * 40),
        ("nav_msgs/msg/Odometry", b"\0\1\0\0" + bytes(400)),
        ("std_msgs/msg/Float64", b""),
    ],
)
def test_other_bytes_have_no_layout(type_name: str, data: bytes) -> None:
    with pytest.raises(NotTabular):
        layout_of(type_name, data)


def test_a_path_is_read_as_a_table_or_pose_by_pose() -> None:
    points = np.random.default_rng(1).normal(size=(9, 2))
    message = ros.path_message(points, 5)
    bag: Any = SimpleNamespace(topics={"/path": "nav_msgs/msg/Path"})
    bag.decode = lambda given: Bag.decode(bag, given)
    for frame in ("map", "", "other"):
        message.poses[4].header = Header(frame_id=frame)
        sent = BagMessage("/path", 1, 1, bytes(serialize_message(message)))
        if frame == "other":
            with pytest.raises(ValueError, match=r"poses\[4\].header.frame_id = 'other'"):
                collector.decode_path(bag, sent)
            continue
        stamp_ns, found = collector.decode_path(bag, sent)
        assert stamp_ns == 5
        assert np.array_equal(found, points)
