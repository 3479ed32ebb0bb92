"""Write bags as rosbag2 lays them out: a folder with `<name>_0.mcap` and `metadata.yaml`.

Every viewer and `ros2 bag` read them. Chunks are closed and handed to the operating system at
least every half second while messages come, so a process that is killed loses less than one.
"""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from mcap.writer import Writer
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

from ampc_msgs_config.message_types import define
from ampc_msgs_config.types import NANOSECONDS

FLUSH_PERIOD = 0.5
"""Longest wall time that a written message stays in this process [s]."""
METADATA_VERSION = 9
ROS_DISTRO = "jazzy"
Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


@dataclass
class Topic:
    """One topic of a bag under construction."""

    name: str
    type_name: str
    offers: list[dict[str, Any]]
    channel: int
    count: int = 0


class Recording:
    """A bag that is being written; a context manager.

    Note:
        `write` closes a chunk every half second; whoever may fall silent calls `flush` besides.
    """

    def __init__(self, folder: Path) -> None:
        """Open a new bag.

        Args:
            folder: Folder of the bag; it may exist, but must not hold a bag.

        Raises:
            ValueError: The folder holds a bag already, which is left untouched.
        """
        self.folder = folder.resolve()
        self.file = self.folder / f"{self.folder.name}_0.mcap"
        self.topics: dict[str, Topic] = {}
        self.schemas: dict[str, int] = {}
        self.count = self.start_ns = self.end_ns = 0
        self.flushed = time.monotonic()
        self.stream = create(self.file)
        self.writer: Any = Writer(self.stream)
        self.writer.start(profile="ros2", library="ampc_msgs_config")
        self.flush()

    def __enter__(self) -> "Recording":
        """Give the open bag."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bag."""
        self.close()

    def add_topic(self, name: str, type_name: str, offers: Sequence[QoSProfile]) -> None:
        """Announce a topic.

        Args:
            name: Full name, such as `/odom`.
            type_name: Type, such as `nav_msgs/msg/Odometry`.
            offers: Quality of service of each of its publishers.
        """
        definition = define(type_name)
        if type_name not in self.schemas:
            text = definition.text.encode()
            self.schemas[type_name] = self.writer.register_schema(type_name, "ros2msg", text)
        profiles = [qos_mapping(offer) for offer in offers]
        metadata = {
            "offered_qos_profiles": to_yaml(profiles).strip(),
            "topic_type_hash": definition.type_hash,
        }
        channel = self.writer.register_channel(name, "cdr", self.schemas[type_name], metadata)
        self.topics[name] = Topic(name, type_name, profiles, channel)

    def write(self, name: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Add a serialised message to an announced topic; times are [ns]."""
        self.start_ns = min(self.start_ns, log_time_ns) if self.count else log_time_ns
        self.end_ns = max(self.end_ns, log_time_ns)
        topic = self.topics[name]
        self.writer.add_message(topic.channel, log_time_ns, data, publish_time_ns, topic.count)
        topic.count += 1
        self.count += 1
        if time.monotonic() - self.flushed > FLUSH_PERIOD:
            self.flush()

    def flush(self) -> None:
        """Close the chunk, and hand all that was written to the operating system."""
        self.writer.flush()
        replace(self.folder / "metadata.yaml", to_yaml(metadata_mapping(self)))
        self.flushed = time.monotonic()

    def close(self) -> None:
        """Write the index and the final `metadata.yaml`."""
        self.flush()
        self.writer.finish()
        self.stream.close()


def create(file: Path) -> BinaryIO:
    """Open a new file in a folder that holds no bag.

    Raises:
        ValueError: There is a bag, or the folder cannot be written.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        if any(file.parent.glob("*.mcap")) or (file.parent / "metadata.yaml").exists():
            raise ValueError(f"{file.parent}: holds a bag already, and bags are never overwritten")
        return file.open("xb")
    except OSError as error:
        raise ValueError(f"{file.parent}: cannot record there: {error.strerror}") from error


def replace(file: Path, text: str) -> None:
    """Put a text into a file at once: a reader sees the old text or the new one."""
    draft = file.with_suffix(".tmp")
    draft.write_text(text, encoding="utf-8")
    draft.replace(file)


def to_yaml(content: Any) -> str:
    """Give the YAML text of plain lists and mappings."""
    return str(yaml.dump(content, Dumper=Dumper, sort_keys=False))


def qos_mapping(qos: QoSProfile) -> dict[str, Any]:
    """Give a quality of service in the words of rosbag2."""
    return {
        "history": qos.history.short_key,
        "depth": qos.depth,
        "reliability": qos.reliability.short_key,
        "durability": qos.durability.short_key,
        "deadline": duration_mapping(qos.deadline),
        "lifespan": duration_mapping(qos.lifespan),
        "liveliness": qos.liveliness.short_key,
        "liveliness_lease_duration": duration_mapping(qos.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": qos.avoid_ros_namespace_conventions,
    }


def duration_mapping(duration: Duration) -> dict[str, int]:
    """Give a duration in the words of rosbag2."""
    seconds, nanoseconds = divmod(duration.nanoseconds, NANOSECONDS)
    return {"sec": seconds, "nsec": nanoseconds}


def metadata_mapping(recording: Recording) -> dict[str, Any]:
    """Give the content of `metadata.yaml`, version 9."""
    topics = [topic_mapping(topic) for topic in recording.topics.values()]
    information = {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "relative_file_paths": [recording.file.name],
        **extent_mapping(recording),
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": recording.file.name, **extent_mapping(recording)}],
        "custom_data": None,
        "ros_distro": os.environ.get("ROS_DISTRO", ROS_DISTRO),
    }
    return {"rosbag2_bagfile_information": information}


def extent_mapping(recording: Recording) -> dict[str, Any]:
    """Give the extent of a recording in the words of rosbag2."""
    return {
        "starting_time": {"nanoseconds_since_epoch": recording.start_ns},
        "duration": {"nanoseconds": recording.end_ns - recording.start_ns},
        "message_count": recording.count,
    }


def topic_mapping(topic: Topic) -> dict[str, Any]:
    """Give a topic in the words of rosbag2."""
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": topic.offers,
            "type_description_hash": define(topic.type_name).type_hash,
        },
        "message_count": topic.count,
    }
