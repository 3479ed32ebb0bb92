"""Open bags: our own, those of `ros2 bag record`, and what a killed recorder left of one."""

import heapq
import re
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import zstandard
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Channel, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from ampc_msgs_config import ros
from ampc_msgs_config.recording.message_types import TYPES, message_class
from launch_scripts.bags.salvage import MAGIC, ZSTD_MAGIC, is_closed, salvage, uncompressed

SQLITE_MAGIC = b"SQLite format 3\0"
SQLITE = "the bag is stored in SQLite; `ros2 bag convert` converts it to MCAP"
PROFILES = ("ros2", "")


class BagMessage(NamedTuple):
    """One serialised message of a bag."""

    topic: str
    """Full name, such as `/odom`."""
    log_time_ns: int
    """Time used by a player: simulated time if the clock was simulated [ns]."""
    publish_time_ns: int
    """Wall time of publishing [ns]."""
    data: bytes
    """The message as CDR."""


class BagFile(NamedTuple):
    """One file of an open bag."""

    path: Path
    stream: IO[bytes]
    """Complete MCAP file: the file itself, or a temporary copy, decompressed and salvaged."""
    types: dict[str, str]
    """Message type of each topic."""
    encodings: dict[str, str]
    """Serialisation format of each topic."""
    has_index: bool
    """Whether the summary lists all chunks, channels and schemas."""
    was_closed: bool
    """Whether the writer closed the file."""

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Return the messages of the given topics in the order of their log times."""
        self.stream.seek(0)
        # SeekingReader checks no CRC where it finds no index of chunks
        reader_class = SeekingReader if self.has_index else NonSeekingReader
        with damage_in_one_line(self.path):
            reader = reader_class(self.stream, validate_crcs=True)
            for _, channel, message in reader.iter_messages(topics):
                data = uncompressed(message.data)
                yield BagMessage(channel.topic, message.log_time, message.publish_time, data)


class Bag(NamedTuple):
    """An open bag. `open_bag` creates it; all other information is read from this object."""

    path: Path
    files: list[BagFile]
    is_complete: bool
    """Whether the writer closed every file."""

    @property
    def topics(self) -> dict[str, str]:
        """Topics of the bag with their types, such as `nav_msgs/msg/Odometry`."""
        return {topic: type_ for file in self.files for topic, type_ in file.types.items()}

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Return the messages of the given topics (full names) in the order of their log times.

        Messages with the same log time keep the order in which they were recorded.

        Raises:
            ValueError: A topic has a type that violates the contract, or is not serialised as CDR,
                or a file is damaged; in one line.
        """
        for fault in filter(None, map(self.wrong_type, topics)):
            raise ValueError(f"{self.path}: {fault}")
        for file in self.files:
            for topic in file.encodings.keys() & topics:
                if (encoding := file.encodings[topic]) != "cdr":
                    raise ValueError(f"{file.path}: {topic} is serialised as {encoding!r}, not CDR")
        parts = [file.messages(topics) for file in self.files]
        return heapq.merge(*parts, key=lambda message: message.log_time_ns)

    def decode(self, message: BagMessage) -> Any:
        """Return a message of this bag as a ROS message.

        Raises:
            ValueError: The type is not installed, or the bytes do not match the type.
        """
        return ros.decode(message.data, message_class(self.topics[message.topic]))

    def wrong_type(self, topic: str) -> str:
        """Return one line if the type of a topic violates the contract, otherwise ''."""
        names = (name for name in TYPES if topic.endswith("/" + name.lstrip("/")))
        required = TYPES[name] if (name := next(names, "")) else ""
        type_name = self.topics.get(topic, required)
        is_right = not required or type_name == required
        return "" if is_right else f"{topic} holds {type_name}, not {required}"


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag.

    A compressed file is decompressed once. A file that was not closed is salvaged once: all that
    is undamaged in it can be read.

    Args:
        path: Folder of the bag, or one of its files.

    Raises:
        ValueError: One line that names the file: there is no bag, or it cannot be understood.
    """
    files = bag_files(path)
    opened = []
    with ExitStack() as stack:
        for file in files:
            # A killed recorder leaves the last file of a split bag empty.
            if len(files) == 1 or file.stat().st_size:
                check_format(file)
                opened.append(open_file(file, stack))
        if not opened:
            raise ValueError(f"{path}: no bag: all files are empty")
        is_complete = len(opened) == len(files) and all(file.was_closed for file in opened)
        yield Bag(path, opened, is_complete)


def bag_files(bag: Path) -> list[Path]:
    """Return the MCAP files of a bag, compressed or not, in the order of their numbers.

    Raises:
        ValueError: There is none.
    """
    if bag.is_file():
        return [bag]
    if not bag.is_dir():
        raise ValueError(f"{bag}: there is no such file or folder")
    # While rosbag2 compresses a file, both forms exist.
    files = {file.name.removesuffix(".zstd"): file for file in bag.glob("*.mcap.zstd")}
    files |= {file.name: file for file in bag.glob("*.mcap")}
    if not files and any(bag.glob("*.db3*")):
        raise ValueError(f"{bag}: {SQLITE}")
    if not files:
        raise ValueError(f"{bag}: no bag: the folder holds no .mcap file")
    return [files[name] for name in sorted(files, key=natural_order)]


def natural_order(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts `bag_10` after `bag_2`."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name)]


def check_format(file: Path) -> None:
    """Check that a file begins as an MCAP file, compressed or not.

    Raises:
        ValueError: The file is empty, in another format or not readable.
    """
    try:
        with file.open("rb") as stream:
            start = stream.read(len(SQLITE_MAGIC))
    except OSError as error:
        raise ValueError(f"{file}: cannot be read: {error.strerror}") from error
    if not start:
        raise ValueError(f"{file}: no bag: the file is empty")
    if start == SQLITE_MAGIC:
        raise ValueError(f"{file}: {SQLITE}")
    if not start.startswith((MAGIC, ZSTD_MAGIC)):
        raise ValueError(f"{file}: no bag: the file does not begin as MCAP files do")


def open_file(file: Path, stack: ExitStack) -> BagFile:
    """Open one file; `stack` closes it."""
    with damage_in_one_line(file):
        stream = stack.enter_context(open_decompressed(file))
        was_closed = is_closed(stream)
        if not was_closed:
            stream = stack.enter_context(open_salvaged(stream))
        reader = SeekingReader(stream)
        profile, summary = reader.get_header().profile, reader.get_summary()
        if profile not in PROFILES:
            raise ValueError(f"its profile is {profile!r}, not 'ros2'")
        has_index = summary is not None and is_full_index(summary)
        index = summary if summary and has_index else read_channels(stream)
        type_names = {0: "", **{key: schema.name for key, schema in index.schemas.items()}}
        channels = index.channels.values()
        types = {channel.topic: type_names[channel.schema_id] for channel in channels}
        encodings = {channel.topic: channel.message_encoding for channel in channels}
        return BagFile(file, stream, types, encodings, has_index, was_closed)


@contextmanager
def open_decompressed(file: Path) -> Iterator[IO[bytes]]:
    """Open a file; one that is compressed as a whole is decompressed as far as it is complete."""
    with file.open("rb") as stream:
        is_compressed = stream.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
        stream.seek(0)
        if not is_compressed:
            yield stream
            return
        with tempfile.TemporaryFile() as content:
            with zstandard.ZstdDecompressor().stream_reader(stream) as source:
                shutil.copyfileobj(source, content)
            content.seek(0)
            yield content


@contextmanager
def open_salvaged(stream: IO[bytes]) -> Iterator[IO[bytes]]:
    """Open a complete copy of all that is undamaged in a file."""
    with tempfile.TemporaryFile() as copy:
        salvage(stream, copy, compress=False)
        copy.seek(0)
        yield copy


def is_full_index(summary: Summary) -> bool:
    """Return whether a summary is enough to find and interpret every message.

    MCAP allows a writer to leave out any part of the summary.
    """
    counts, channels = summary.statistics, summary.channels.values()
    return (
        counts is not None
        and counts.channel_count == len(channels)
        and counts.chunk_count == len(summary.chunk_indexes)
        and (counts.chunk_count > 0 or not counts.message_count)
        and {channel.schema_id for channel in channels} <= {0, *summary.schemas}
    )


def read_channels(stream: IO[bytes]) -> Summary:
    """Return the schemas and channels of a file without an index; this reads the whole file."""
    summary = Summary()
    stream.seek(0)
    for record in StreamReader(stream).records:
        if isinstance(record, Schema):
            summary.schemas[record.id] = record
        elif isinstance(record, Channel):
            summary.channels[record.id] = record
    return summary


@contextmanager
def damage_in_one_line(file: Path) -> Iterator[None]:
    """Raise a ValueError of one line for any error that a damaged file causes in the libraries."""
    try:
        yield
    except Exception as error:
        reason = " ".join(str(error).split()) or "it ends early"
        raise ValueError(f"{file}: damaged or foreign: {reason}") from error
