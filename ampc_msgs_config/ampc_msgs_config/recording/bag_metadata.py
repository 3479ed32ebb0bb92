"""`metadata.yaml` of a bag, version 9, as rosbag2 of ROS 2 Jazzy writes it."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from textwrap import indent
from types import MappingProxyType
from typing import Any

import yaml

VERSION = 9
ROS_DISTRO = "jazzy"
ROOT_KEY = "rosbag2_bagfile_information"
FILE_NAME = "metadata.yaml"
TOPICS_KEY = "topics_with_message_count:"
FAST_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


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

    def as_mapping(self) -> dict[str, Any]:
        """Return the extent as rosbag2 states it."""
        return {
            "starting_time": {"nanoseconds_since_epoch": self.start_ns},
            "duration": {"nanoseconds": self.end_ns - self.start_ns},
            "message_count": self.count,
        }


def total_of(extents: Iterable[Extent]) -> Extent:
    """Return the extent of all files of a bag together."""
    filled = [each for each in extents if each.count]
    start_ns = min((each.start_ns for each in filled), default=0)
    end_ns = max((each.end_ns for each in filled), default=0)
    return Extent(sum(each.count for each in filled), start_ns, end_ns)


@dataclass
class Topic:
    """One topic of a bag."""

    name: str
    type_name: str
    offers: list[dict[str, Any]]
    """Quality of service of each publisher, as version 9 states it."""
    type_hash: str
    encoding: str = "cdr"
    count: int = 0
    """Number of messages."""

    @cached_property
    def text_before_count(self) -> str:
        """The entry of the topic up to its number of messages.

        A recorder writes all entries several times a second, of which only the numbers change.
        """
        entry = {
            "topic_metadata": {
                "name": self.name,
                "type": self.type_name,
                "serialization_format": self.encoding,
                "offered_qos_profiles": self.offers,
                "type_description_hash": self.type_hash,
            },
            "message_count": 0,
        }
        return indent(to_block_yaml([entry]), "  ").removesuffix("0\n")


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
    information = {
        "version": VERSION,
        "storage_identifier": "mcap",
        "relative_file_paths": list(files),
        **total_of(files.values()).as_mapping(),
        "topics_with_message_count": [],
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": name, **extent.as_mapping()} for name, extent in files.items()],
        "custom_data": None,
        "ros_distro": os.environ.get("ROS_DISTRO", ROS_DISTRO),
    }
    draft = folder / f"{FILE_NAME}.tmp"
    try:
        text = to_block_yaml({ROOT_KEY: {**information, **kept}})
        entries = "".join(f"{topic.text_before_count}{topic.count}\n" for topic in topics)
        if entries:
            text = text.replace(f"  {TOPICS_KEY} []\n", f"  {TOPICS_KEY}\n{entries}", 1)
        draft.write_text(text, encoding="utf-8")
        draft.replace(folder / FILE_NAME)
    except OSError:
        draft.unlink(missing_ok=True)
        raise


def to_block_yaml(content: Any) -> str:
    """Return the YAML text of plain lists and mappings."""
    return str(yaml.dump(content, Dumper=FAST_DUMPER, sort_keys=False))
