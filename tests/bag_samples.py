"""Messages for every topic of the contract, and bags of them."""

import math
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import Log, Parameter, ParameterEvent, ParameterValue
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, Float64, String, UInt64
from visualization_msgs.msg import Marker, MarkerArray

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.recorder_node import CONTRACT, LATCHED_TOPICS, plain_qos
from ampc_msgs_config.recording import bag_writer as recording
from ampc_msgs_config.recording.bag_writer import Recording
from ampc_msgs_config.recording.message_types import message_class, type_name_of
from ampc_msgs_config.recording.transforms import TF_MESSAGE
from ampc_msgs_config.types import NANOSECONDS, Diagnosis, Plan, VehicleState
from launch_scripts.bags.bag import open_bag
from tests.gate_inputs import plan_message

TICK_NS = NANOSECONDS // 10


class Entry(NamedTuple):
    """One decoded message of a bag."""

    topic: str
    log_time_ns: int
    message: Any
    publish_time_ns: int


def read(bag: Path, topics: Collection[str] = ()) -> Iterator[Entry]:
    """Read the messages of a bag whose types are installed, of some topics or of all."""
    with open_bag(bag) as opened:
        usable = topics or [
            topic for topic, type_name in opened.topics.items() if is_installed(type_name)
        ]
        for each in opened.messages(usable):
            yield Entry(each.topic, each.log_time_ns, opened.decode(each), each.publish_time_ns)


def is_complete(bag: Path) -> bool:
    """Return whether all files of a bag were closed."""
    with open_bag(bag) as opened:
        return opened.is_complete


def is_installed(type_name: str) -> bool:
    """Return whether a message type is installed."""
    try:
        return bool(message_class(type_name))
    except ValueError:
        return False


def sample(name: str, stamp_ns: int) -> Any:
    """Return a message for a topic of the contract, with content in every kind of field."""
    if name == ros.ODOM:
        state = VehicleState(stamp_ns, x=1.5, y=-0.1, yaw=0.3, v_x=9.0, v_y=0.01, yaw_rate=-0.2)
        return ros.odometry_message(state)
    if name in (ros.REFERENCE_PATH, ros.PREDICTED_PATH):
        return ros.path_message(np.outer(np.arange(300), (0.1, -0.2)), stamp_ns)
    if name in (ros.TARGET_SPEED, ros.DRIVE_COMMAND, ros.GATE_SPEED):
        return ros.speed_message(ros.Stamped(stamp_ns, 8.333))
    if name in (ros.STEERING_COMMAND, ros.GATE_STEERING):
        command = ros.steering_message(Plan(stamp_ns, 0.1 + 1e-17, -0.5, Diagnosis()))
        command.effort = [0.0]
        return command
    if name == ros.STEERING_STATE:
        joint = ros.joint_message(stamp_ns, 0.05, float("inf"))
        joint.effort = [-0.0]
        return joint
    if name == ros.WIND:
        return ros.wind_message(stamp_ns, (-0.0, 5e-324))
    if name == ros.CLOCK:
        return Clock(clock=ros.time_message(stamp_ns))
    if name == ros.DIAGNOSTICS:
        values = [KeyValue(key="Größe", value="µ = 0.9"), KeyValue()]
        status = DiagnosticStatus(level=b"\x01", name="controller", values=values)
        diagnostics = DiagnosticArray(status=[status, DiagnosticStatus()])
        diagnostics.header.stamp = ros.time_message(stamp_ns)
        return diagnostics
    if name == ros.TICK:
        tick = ros.joint_message(stamp_ns, float("-inf"), 0.0)
        tick.name, tick.effort = ["rung"], [0.0]
        return tick
    if name == ros.MEMORY:
        return ros.memory_message(b"\x00\xff{}", stamp_ns // TICK_NS)
    if name == ros.STEERING_PLAN:
        return plan_message([0.1, -0.2, 5e-324])
    if name == ros.GATE_STATE:
        return String(data="stopping")
    if name == ros.GATE_HEARTBEAT:
        return UInt64(data=2**64 - 1)
    if name == ros.STOP_REQUEST:
        return Bool(data=True)
    if name in ros.CONFIGURATIONS:
        return String(data=f"version: 0.1.0\nnumber: {stamp_ns}\n")
    if name == ros.MARKERS:
        return MarkerArray(markers=[Marker(ns="Straße", text="µ", type=Marker.ARROW)])
    if name == ros.PARAMETER_EVENTS:
        value = ParameterValue(integer_array_value=[-1], double_array_value=[8.3])
        changed = [Parameter(name="speed", value=value)]
        return ParameterEvent(stamp=ros.time_message(stamp_ns), changed_parameters=changed)
    if name == ros.ROSOUT:
        return Log(stamp=ros.time_message(stamp_ns), level=20, msg="recording")
    return Float64(data=stamp_ns / TICK_NS)


def write_bag(folder: Path, ticks: int) -> tuple[list[Entry], list[bytes]]:
    """Write samples of all topics, one chunk for each tick; return them and their bytes."""
    entries, data = [], []
    with patch.object(recording, "FLUSH_PERIOD", math.inf), Recording(folder) as bag:
        for name, message_type in CONTRACT.items():
            qos = ros.LATCHED if name in LATCHED_TOPICS else ros.RELIABLE
            bag.add_topic(full(name), type_name_of(message_type), [plain_qos(qos)])
        for stamp_ns in range(TICK_NS, (ticks + 1) * TICK_NS, TICK_NS):
            for name in CONTRACT:
                entries.append(Entry(full(name), stamp_ns, sample(name, stamp_ns), stamp_ns))
                data.append(serialize_message(entries[-1].message))
                bag.write(full(name), data[-1], stamp_ns, stamp_ns)
            bag.flush()
    return entries, data


def full(name: str) -> str:
    """Return the full name of a topic in the root namespace."""
    return "/" + name.lstrip("/")


def contents(entries: Iterable[Entry]) -> list[tuple[str, int, Any]]:
    """Return topic, log time and message of each entry."""
    return [(entry.topic, entry.log_time_ns, entry.message) for entry in entries]


def read_with_rosbags(bag: Path) -> list[tuple[str, int, Any]]:
    """Read a bag with the library rosbags and the definitions in the bag, as `contents` does."""
    found = []
    with AnyReader([bag]) as reader:
        links = [link for link in reader.connections if link.msgtype != TF_MESSAGE]
        for link, time_ns, data in reader.messages(links):
            message = reader.deserialize(data, link.msgtype)
            again = bytes(reader.typestore.serialize_cdr(message, link.msgtype))
            ros_message = deserialize_message(again, message_class(link.msgtype))
            found.append((link.topic, time_ns, ros_message))
    return found
