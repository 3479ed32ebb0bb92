"""`metadata.yaml` of a bag, version 9, as rosbag2 of ROS 2 Jazzy writes it."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

VERSION = 9
ROS_DISTRO = "jazzy"
ROOT = "rosbag2_bagfile_information"
FILE_NAME = "metadata.yaml"
Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


@dataclass
class Extent:
    """Number of messages and their time span."""

    count: int = 0
    start_ns: int = 0
    """Earliest log time [ns]; 0 without messages."""
    end_ns: int = 0
    """Latest log time [ns]."""

    def add(self, log_time_ns: int) -> None:
        """Count one message."""
        self.start_ns = min(self.start_ns, log_time_ns) if self.count else log_time_ns
        self.end_ns = max(self.end_ns, log_time_ns)
        self.count += 1

    def include(self, other: "Extent") -> None:
        """Count the messages of another extent too."""
        if other.count:
            self.start_ns = min(self.start_ns, other.start_ns) if self.count else other.start_ns
            self.end_ns = max(self.end_ns, other.end_ns)
            self.count += other.count


@dataclass
class Topic:
    """One topic of a bag."""

    name: str
    type_name: str
    offers: list[dict[str, Any]]
    """Quality of service of each publisher, as version 9 states it."""
    type_hash: str
    encoding: str = "cdr"
    extent: Extent = field(default_factory=Extent)

    def without_messages(self) -> "Topic":
        """Return a copy with an empty extent."""
        return replace(self, extent=Extent())


def write_metadata(
    folder: Path,
    files: Mapping[str, Extent],
    topics: Iterable[Topic],
    kept: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write `metadata.yaml`, or replace it atomically.

    Args:
        folder: Folder of the bag.
        files: Extent of each file, by its name in the folder.
        topics: All topics of the bag.
        kept: Entries of another `metadata.yaml` that replace the defaults.

    Raises:
        OSError: It cannot be written; the old one stays.
    """
    draft = folder / f"{FILE_NAME}.tmp"
    try:
        draft.write_text(to_yaml(metadata_mapping(files, topics, kept)), encoding="utf-8")
        draft.replace(folder / FILE_NAME)
    except OSError:
        draft.unlink(missing_ok=True)
        raise


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return the content of `metadata.yaml`, empty if it is missing or damaged."""
    try:
        content = yaml.safe_load((folder / FILE_NAME).read_text(encoding="utf-8"))
        return dict(content[ROOT])
    except (OSError, ValueError, TypeError, KeyError, yaml.YAMLError):
        return {}


def to_yaml(content: Any) -> str:
    """Return the YAML text of plain lists and mappings."""
    return str(yaml.dump(content, Dumper=Dumper, sort_keys=False))


def metadata_mapping(
    files: Mapping[str, Extent], topics: Iterable[Topic], kept: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the content of `metadata.yaml`."""
    total = Extent()
    for extent in files.values():
        total.include(extent)
    topic_entries = [
        {
            "topic_metadata": {
                "name": topic.name,
                "type": topic.type_name,
                "serialization_format": topic.encoding,
                "offered_qos_profiles": topic.offers,
                "type_description_hash": topic.type_hash,
            },
            "message_count": topic.extent.count,
        }
        for topic in topics
    ]
    information = {
        "version": VERSION,
        "storage_identifier": "mcap",
        "relative_file_paths": list(files),
        **extent_mapping(total),
        "topics_with_message_count": topic_entries,
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": name, **extent_mapping(extent)} for name, extent in files.items()],
        "custom_data": None,
        "ros_distro": os.environ.get("ROS_DISTRO", ROS_DISTRO),
    }
    return {ROOT: {**information, **kept}}


def extent_mapping(extent: Extent) -> dict[str, Any]:
    """Return an extent as rosbag2 states it."""
    return {
        "starting_time": {"nanoseconds_since_epoch": extent.start_ns},
        "duration": {"nanoseconds": extent.end_ns - extent.start_ns},
        "message_count": extent.count,
    }
