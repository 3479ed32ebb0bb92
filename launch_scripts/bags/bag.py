"""Open bags: our own, those of `ros2 bag record`, and what a killed recorder left of one."""

import heapq
import re
import struct
import tempfile
import zlib
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary

from ampc_msgs_config import ros
from ampc_msgs_config.recording.message_types import TOPIC_TYPES, message_class
from launch_scripts.bags.inflate import MAX_RATIO, ZSTD_MAGIC, Inflation, inflate, inflated
from launch_scripts.bags.resync import HEAD, MAGIC, Scanner, compression_of
from launch_scripts.bags.salvage import (
    Salvage,
    inner_records,
    is_closed,
    looks_like_mcap,
    read_index,
    salvage,
    uncompressed,
)

SQLITE_MAGIC = b"SQLite format 3\0"
SQLITE_ENDING = ".db3"
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Start of a message: channel, number, log time and time of publishing [ns]."""
ENDINGS = (".mcap", SQLITE_ENDING)
"""Endings of the files of a bag, of which one that is compressed has a further one."""


class BagMessage(NamedTuple):
    """One serialised message of a bag."""

    topic: str
    """Full name, such as `/odom`."""
    log_time_ns: int
    """Time used by a player: simulated time if the clock was simulated [ns]."""
    publish_time_ns: int
    """Wall time of publishing [ns]."""
    data: bytes
    """The message as CDR, or CDR compressed by `ros2 bag record --compression-mode message`."""


class BagFile(NamedTuple):
    """One file of an open bag."""

    path: Path
    stream: IO[bytes]
    """Complete MCAP file: the file itself, or a temporary copy, decompressed and salvaged."""
    summary: Summary
    """Summary with all chunks, channels and schemas."""
    is_complete: bool
    """Whether the writer closed the file, and nothing in it was left out."""
    faults: list[str]
    """What is damaged or doubtful, one line each."""

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Return the messages of the given topics in the order of their log times.

        Note:
            The reader of `mcap` makes several objects and a place in a heap for each message.
        """
        names = {
            number: channel.topic
            for number, channel in self.summary.channels.items()
            if channel.topic in topics
        }
        chunks = sorted(
            (each.message_start_time, each.chunk_start_offset)
            for each in self.summary.chunk_indexes
            if not each.message_index_offsets or names.keys() & each.message_index_offsets
        )
        waiting: list[tuple[int, int, int, BagMessage]] = []
        for k, (_, offset) in enumerate(chunks):
            with damage_in_one_line(self.path):
                waiting += self.chunk_messages(offset, names)
            waiting.sort()
            following = chunks[k + 1 : k + 2]
            end = bisect_left(waiting, following[0][:1]) if following else len(waiting)
            yield from (message for _, _, _, message in waiting[:end])
            del waiting[:end]

    def chunk_messages(
        self, offset: int, names: Mapping[int, str]
    ) -> Iterator[tuple[int, int, int, BagMessage]]:
        """Return log time, place and message of the messages of a chunk.

        Args:
            offset: Of the chunk in the file.
            names: Wanted topics by their numbers.
        """
        self.stream.seek(offset + HEAD.size)
        chunk = Chunk.read(ReadDataStream(self.stream))
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        content, at = stream.read(size), 0
        while at < size:
            opcode, length = HEAD.unpack_from(content, at)
            begin, at = at + HEAD.size, at + HEAD.size + length
            if at > size:
                raise EndOfFile
            if opcode == Opcode.MESSAGE:
                number, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(content, begin)
                if number in names:
                    data = content[begin + MESSAGE_HEAD.size : at]
                    yield log_ns, offset, begin, BagMessage(names[number], log_ns, publish_ns, data)


class Bag(NamedTuple):
    """An open bag. `open_bag` creates it; all other information is read from this object."""

    path: Path
    files: list[BagFile]
    topics: dict[str, str]
    """Topics of the bag with their types, such as `nav_msgs/msg/Odometry`."""
    is_complete: bool
    """Whether every file is complete."""
    left_out: list[str]
    """Files that cannot be read, one line each."""

    @property
    def faults(self) -> list[str]:
        """What is left out, damaged or doubtful, one line each."""
        return self.left_out + [fault for file in self.files for fault in file.faults]

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
            for each in file.summary.channels.values():
                if each.topic in topics and (encoding := each.message_encoding) != "cdr":
                    fault = f"{each.topic} is serialised as {encoding!r}, not CDR"
                    raise ValueError(f"{file.path}: {fault}")
        parts = [file.messages(topics) for file in self.files]
        return heapq.merge(*parts, key=lambda message: message.log_time_ns)

    def decode(self, message: BagMessage) -> Any:
        """Return a message of this bag as a ROS message.

        Raises:
            ValueError: The type is not installed, or the bytes do not match the type.
        """
        return ros.decode(uncompressed(message.data), message_class(self.topics[message.topic]))

    def wrong_type(self, topic: str) -> str:
        """Return one line if the type of a topic violates the contract, otherwise ''."""
        type_name = self.topics.get(topic)
        for name, required in TOPIC_TYPES.items():
            if topic.endswith("/" + name.lstrip("/")) and type_name not in (None, required):
                return f"{topic} holds {type_name}, not {required}"
        return ""


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag.

    A compressed file is decompressed once. A file that was not closed or lacks an index is
    salvaged once: all that is undamaged in it can be read.

    Args:
        path: Folder of the bag, or one of its files.

    Raises:
        ValueError: One line that names the file: there is no bag, or it cannot be understood.
    """
    files = bag_files(path)
    with ExitStack() as stack:
        opened, left_out = list[BagFile](), list[str]()
        for file in files:
            try:
                opened.append(open_file(file, stack))
            except ValueError as error:  # a killed recorder leaves the last one empty
                left_out.append(str(error))
        if not opened:
            raise ValueError(left_out[0])
        topics = {
            channel.topic: file.summary.schemas[channel.schema_id].name if channel.schema_id else ""
            for file in opened
            for channel in file.summary.channels.values()
        }
        is_complete = not left_out and all(file.is_complete for file in opened)
        yield Bag(path, opened, topics, is_complete, left_out)


def bag_files(bag: Path) -> list[Path]:
    """Return the MCAP or SQLite files of a bag, compressed or not, in the order of their numbers.

    Raises:
        ValueError: There is none.
    """
    if bag.is_file():
        return [bag]
    if not bag.is_dir():
        raise ValueError(f"{bag}: there is no such file or folder")
    for ending in ENDINGS:
        # While rosbag2 compresses a file, both forms exist.
        files = {file.name.removesuffix(".zstd"): file for file in bag.glob(f"*{ending}.zstd")}
        files |= {file.name: file for file in bag.glob(f"*{ending}")}
        if files:
            break
    else:
        raise ValueError(f"{bag}: no bag: the folder holds no .mcap or .db3 file")

    def natural_order(name: str) -> list[tuple[int, str]]:  # sorts `bag_10` after `bag_2`
        parts = re.split(r"(\d+)", name)
        return [(int(part), "") if part.isdigit() else (0, part) for part in parts]

    return [files[name] for name in sorted(files, key=natural_order)]


def check_format(file: Path) -> None:
    """Check that a file begins as an MCAP file, a compressed file or a database.

    Raises:
        ValueError: The file is empty, in another format or not readable.
    """
    try:
        with file.open("rb") as stream:
            start = stream.read(len(SQLITE_MAGIC))
            stream.seek(0)
            is_bag = start.startswith((ZSTD_MAGIC, SQLITE_MAGIC)) or looks_like_mcap(stream)
    except OSError as error:
        raise ValueError(f"{file}: cannot be read: {error.strerror}") from error
    if not start:
        raise ValueError(f"{file}: no bag: the file is empty")
    if not is_bag:
        raise ValueError(f"{file}: no bag: the file does not begin as MCAP files do")


def open_file(file: Path, stack: ExitStack) -> BagFile:
    """Open one file; `stack` closes it."""
    check_format(file)
    with damage_in_one_line(file):
        stream, fault = stack.enter_context(open_decompressed(file))
        faults = [f"{file}: {fault}"] if fault else []
        is_complete, index = is_closed(stream) and not fault, read_index(stream)
        if not (is_complete and index and is_full_index(index) and is_readable(stream, index)):
            copy = stack.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 (the stack closes it)
            result = salvage(stream, copy, compress=False)
            faults += damage_of(file, result)
            stream, index = copy, result.index
            is_complete = result.is_undamaged and not fault
        stream.seek(0)
        profile = SeekingReader(stream).get_header().profile
        if profile not in ("ros2", ""):
            raise ValueError(f"its profile is {profile!r}, not 'ros2'")
        return BagFile(file, stream, index, is_complete, faults)


@contextmanager
def open_decompressed(file: Path) -> Iterator[tuple[IO[bytes], str]]:
    """Open a file as MCAP: it is decompressed and converted as far as it is undamaged.

    Returns:
        The stream, and why it is not all of the file (empty: it is).

    Raises:
        ValueError: It is a database that cannot be opened.
    """
    with open_content(file) as (stream, fault):
        start = stream.read(len(SQLITE_MAGIC))
        stream.seek(0)
        if start != SQLITE_MAGIC:
            yield stream, fault
            return
        from launch_scripts.bags.sqlite_bag import to_mcap  # most bags need no database

        with tempfile.TemporaryFile() as converted:
            damage = to_mcap(stream, file, converted)
            yield converted, fault or damage


@contextmanager
def open_content(file: Path) -> Iterator[tuple[IO[bytes], str]]:
    """Open a file; one that is compressed as a whole is decompressed as far as it is undamaged."""
    with file.open("rb") as stream, tempfile.TemporaryFile() as content:
        is_compressed = stream.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
        limit = MAX_RATIO * max(stream.seek(0, 2), 2**18)
        stream.seek(0)
        if not is_compressed:
            yield stream, ""
            return
        state = Inflation()
        for piece in inflate(stream, "zstd", limit, state):
            content.write(piece)
        content.seek(0)
        yield content, state.fault


def damage_of(file: Path, result: Salvage) -> list[str]:
    """Return one line for damage in a file, and one for messages that are kept and doubtful."""
    lines = []
    if result.damaged:
        lines.append(
            f"{file}: {result.damaged} damaged chunks or records, {result.damaged_bytes} bytes"
        )
    if result.doubtful:
        lines.append(f"{file}: {result.doubtful} messages beside the damage are kept: may be wrong")
    return lines


def is_readable(stream: IO[bytes], index: Summary) -> bool:
    """Return whether the header and every chunk of an index are undamaged."""
    scanner = Scanner(stream, {})
    header = scanner.record_at(len(MAGIC), is_checked=True)
    if scanner.read(0, len(MAGIC)) != MAGIC or not header or header.opcode != Opcode.HEADER:
        return False
    for each in index.chunk_indexes:
        record = scanner.record_at(each.chunk_start_offset, is_checked=True)
        if not (record and record.chunk and record.is_whole and record.is_right):
            return False
        content, fault = record.content, ""
        if content:
            content, fault = inflated(content, compression_of(content, record.chunk.compression))
        else:
            begin = record.position + HEAD.size + record.chunk.size
            content = scanner.read(begin, record.position + record.size - begin)
        crc = record.chunk.crc
        is_right = (
            zlib.crc32(content) == crc
            if crc
            else all(inner.is_whole for inner in inner_records(content))
        )
        if fault or not is_right:
            return False
    return True


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


@contextmanager
def damage_in_one_line(file: Path) -> Iterator[None]:
    """Raise a ValueError of one line for any error that a damaged file causes in the libraries."""
    try:
        yield
    except Exception as error:
        raise ValueError(f"{file}: damaged or foreign: {reason_of(error)}") from error


def reason_of(error: Exception) -> str:
    """Return an error of the libraries as one line."""
    if isinstance(error, EOFError | EndOfFile):
        return "it ends early"
    return " ".join(str(error).split()) or type(error).__name__
