"""Write bags as rosbag2 does: a folder with `<name>_0.mcap` and `metadata.yaml`.

Every viewer and `ros2 bag` read them. While messages arrive, chunks are closed and passed to the
operating system at least every half second, so a process that is killed loses less than a second.
"""

import io
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mcap.writer import Writer
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9

from ampc_msgs_config.recording.bag_metadata import (
    FILE_NAME,
    Extent,
    Topic,
    to_block_yaml,
    write_metadata,
)
from ampc_msgs_config.recording.message_types import define

FLUSH_PERIOD = 0.5
"""Longest wall time that a written message stays in this process [s]."""


class CountingFile(io.FileIO):
    """A file that is only appended to, and counts what was written."""

    written = 0
    """Number of written bytes."""

    def write(self, data: Any) -> int:
        """Append bytes; return their number."""
        count = super().write(data)
        self.written += count
        return count


class Recording:
    """A bag that is being written; a context manager.

    Note:
        `write` closes a chunk every half second. A caller without new messages calls `flush`.
        If the disk is full, each method raises a ValueError of one line; what was written before
        stays readable. `flush` raises one if the file was removed, replaced or truncated.
    """

    def __init__(self, folder: Path) -> None:
        """Open a new bag.

        Args:
            folder: Folder of the bag; it may exist, but must not contain a bag.

        Raises:
            ValueError: The folder contains a bag, which is left unchanged.
        """
        self.folder = folder.resolve()
        self.file = self.folder / f"{self.folder.name}_0.mcap"
        claim(self.file)
        self.draft = self.file.with_suffix(".tmp")
        self.begin()
        self.flush()

    def begin_anew(self) -> None:
        """Discard the content; the file in the folder stays until `flush` replaces it."""
        with self.on_disk():
            self.stream.close()
        self.begin()

    def begin(self) -> None:
        """Open a draft beside the file in the folder, which `flush` replaces."""
        self.topics: dict[str, Topic] = {}
        self.channels: dict[str, int] = {}
        self.schemas: dict[str, int] = {}
        self.extent = Extent()
        self.flushed = time.monotonic()
        self.draft.unlink(missing_ok=True)
        self.raw = CountingFile(self.draft, "ab")
        self.stream = io.BufferedWriter(self.raw)
        with self.on_disk():
            self.writer: Any = Writer(self.stream)
            self.writer.start(profile="ros2", library="ampc_msgs_config")

    def __enter__(self) -> "Recording":
        """Return the open bag."""
        return self

    def __exit__(self, kind: object, error: object, _: object) -> None:
        """Close the bag, unless a failed write has closed it already."""
        if not self.stream.closed:
            self.close()

    def add_topic(self, name: str, type_name: str, offers: Sequence[Qos] = ()) -> None:
        """Add a topic.

        Args:
            name: Full name, such as `/odom`.
            type_name: Type, such as `nav_msgs/msg/Odometry`.
            offers: Quality of service of each of its publishers.
        """
        definition = define(type_name)
        if type_name not in self.schemas:
            text = definition.text.encode()
            self.schemas[type_name] = self.writer.register_schema(type_name, "ros2msg", text)
        profiles = [dict(qos) for qos in dump_qos_v9(list(offers))]
        metadata = {
            "offered_qos_profiles": to_block_yaml(profiles).strip(),
            "topic_type_hash": definition.type_hash,
        }
        schema = self.schemas[type_name]
        self.channels[name] = self.writer.register_channel(name, "cdr", schema, metadata)
        self.topics[name] = Topic(name, type_name, profiles, definition.type_hash)

    def write(self, name: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Add a serialised message to a topic that was added before; times are [ns]."""
        topic, channel = self.topics[name], self.channels[name]
        with self.on_disk():
            self.writer.add_message(channel, log_time_ns, data, publish_time_ns, topic.count)
        topic.count += 1
        self.extent.add(log_time_ns)
        if time.monotonic() - self.flushed > FLUSH_PERIOD:
            self.flush()

    def flush(self) -> None:
        """Close the chunk, and pass all that was written to the operating system."""
        self.check()
        with self.on_disk():
            self.writer.flush()
            if self.draft.exists():
                self.draft.replace(self.file)
            write_metadata(self.folder, {self.file.name: self.extent}, self.topics.values())
        self.flushed = time.monotonic()

    def check(self) -> None:
        """Check that the file is still there and has all that was written to it.

        Raises:
            ValueError: It was removed, replaced, truncated or changed by another process.
        """
        path, fault = self.draft if self.draft.exists() else self.file, ""
        own = os.fstat(self.raw.fileno())
        try:
            if not os.path.samestat(own, path.stat()):
                fault = "it was replaced by another file"
        except OSError as error:
            fault = f"it was removed: {error.strerror}"
        if not fault and own.st_size != self.raw.written:
            fault = f"it was changed: {own.st_size} bytes of {self.raw.written} written ones"
        if fault:
            self.raw.close()  # what the buffer holds belongs to no file
            raise ValueError(f"{path}: recording ends: {fault}")

    def close(self) -> None:
        """Write the index and the final `metadata.yaml`."""
        self.flush()
        with self.on_disk():
            self.writer.finish()
            self.stream.close()

    @contextmanager
    def on_disk(self) -> Iterator[None]:
        """Raise a ValueError of one line if writing fails, and leave the file as it is."""
        try:
            yield
        except OSError as error:
            self.raw.close()  # flushing its buffer would fail again
            raise ValueError(
                f"{self.folder}: recording ends: {error.strerror}; "
                "what was written before stays, and recover makes it a complete bag"
            ) from error


def claim(file: Path) -> None:
    """Create an empty file in a folder that contains no bag.

    Raises:
        ValueError: The folder contains a bag or cannot be written.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        if any(file.parent.glob("*.mcap")) or (file.parent / FILE_NAME).exists():
            raise ValueError(f"{file.parent}: holds a bag already, and bags are never overwritten")
        file.open("xb").close()
    except OSError as error:
        raise ValueError(f"{file.parent}: cannot record there: {error.strerror}") from error
