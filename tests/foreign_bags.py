"""Bags of other recorders: `ros2 bag record` with its presets, and files after a kill."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from mcap.writer import CompressionType, Writer
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message

from ampc_msgs_config import ros
from ampc_msgs_config.recording.message_types import define
from ampc_msgs_config.types import VehicleState

QOS_OF_HUMBLE = """- history: 3
  depth: 0
  reliability: 1
  durability: 2
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false"""


class Sent(NamedTuple):
    """A message of a foreign bag."""

    log_time_ns: int
    x: float
    topic: str = "/odom"
    publish_time_ns: int = 7
    number: int = 0

    @property
    def message(self) -> Odometry:
        """The message on the wire."""
        state = VehicleState(self.log_time_ns, self.x, y=0.0, yaw=0.0, v_x=1.0, v_y=0.0, yaw_rate=0)
        return ros.odometry_message(state)


def write_file(
    file: Path,
    messages: Iterable[Sent],
    *,
    encoding: str = "cdr",
    pack: Callable[[bytes], bytes] = bytes,
    **options: Any,
) -> None:
    """Write an MCAP file as rosbag2 does, with an attachment and a metadata record.

    Args:
        file: New file.
        messages: Messages in their order.
        encoding: Serialisation format that the file states.
        pack: Applied to the content of each message.
        options: Options of `mcap.writer.Writer`; by default uncompressed chunks without CRC.
    """
    with file.open("wb") as stream:
        defaults = {"compression": CompressionType.NONE, "enable_crcs": False}
        writer: Any = Writer(stream, **{**defaults, **options})
        writer.start(profile="ros2", library="libmcap 1.1.0")
        writer.add_metadata("rosbag2", {"ROS_DISTRO": "humble"})
        writer.add_attachment(1, 2, "car.yaml", "text/yaml", b"mass: 1500.0\n")
        add_messages(writer, messages, encoding, pack)
        writer.finish()


def add_messages(
    writer: Any, messages: Iterable[Sent], encoding: str, pack: Callable[[bytes], bytes]
) -> None:
    """Write messages, and before the first of a topic its channel as rosbag2 does."""
    type_name = "nav_msgs/msg/Odometry"
    definition = define(type_name)
    schema = writer.register_schema(type_name, "ros2msg", definition.text.encode())
    metadata = {
        "offered_qos_profiles": QOS_OF_HUMBLE,
        "topic_type_hash": definition.type_hash,
    }
    channels: dict[str, int] = {}
    for sent in messages:
        if sent.topic not in channels:
            channels[sent.topic] = writer.register_channel(sent.topic, encoding, schema, metadata)
        data = pack(serialize_message(sent.message))
        times = {"log_time": sent.log_time_ns, "publish_time": sent.publish_time_ns}
        writer.add_message(channels[sent.topic], data=data, sequence=sent.number, **times)
