"""Bags as `ros2 bag record` writes them, made from the messages of a recorded drive."""

import shutil
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import zstandard
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from ampc_msgs_config import topics
from ampc_msgs_config.recording.bag_metadata import Extent, Topic, write_metadata
from ampc_msgs_config.recording.message_types import define, jazzy
from launch_scripts.bags.bag import open_bag
from tests.foreign_bags import QOS_OF_HUMBLE

LATCHED = {topics.REFERENCE_PATH, topics.STOP_REQUEST, topics.MEMORY, *topics.CONFIGURATIONS}
PRESETS: dict[str, dict[str, Any]] = {
    "none": {"compression": CompressionType.NONE, "enable_crcs": False},
    "fastwrite": {
        "use_chunking": False,
        "enable_crcs": False,
        "compression": CompressionType.NONE,
        "index_types": IndexType.NONE,
    },
    "zstd_fast": {"compression": CompressionType.ZSTD, "enable_crcs": False},
    "zstd_small": {"compression": CompressionType.ZSTD, "chunk_size": 4 * 2**20},
}
"""`--storage-preset-profile` of rosbag2_storage_mcap, as options of `mcap.writer.Writer`."""


class Recorded(NamedTuple):
    """A serialised message with its topic."""

    topic: str
    type_name: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int


def recorded_messages(bag: Path) -> list[Recorded]:
    """Return all messages of a bag in the order of recording, 1 ms apart from 1.7e18 ns on."""
    with open_bag(bag) as opened:
        times = (1_700_000_000_000_000_000 + k * 1_000_000 for k in range(10**9))
        return [
            Recorded(each.topic, opened.topics[each.topic], each.data, time_ns, time_ns - 90_000)
            for each, time_ns in zip(opened.messages(opened.topics), times, strict=False)
        ]


def joined_at(messages: Sequence[Recorded], first: int) -> list[Recorded]:
    """Return what a recorder gets that starts before message `first`.

    The last message of each transient-local topic is delivered at its start: it has the log time
    of that moment, and the publish time of its publishing.
    """
    start_ns = messages[first].log_time_ns
    latched = {
        each.topic: each._replace(log_time_ns=start_ns)
        for each in messages[:first]
        if each.topic.lstrip("/") in LATCHED
    }
    return [*latched.values(), *messages[first:]]


def without(messages: Sequence[Recorded], first: int, last: int) -> list[Recorded]:
    """Return the messages without those from `first` to before `last`: a queue was full."""
    return [*messages[:first], *messages[last:]]


def write_mcap(
    folder: Path,
    messages: Sequence[Recorded],
    *,
    preset: str = "none",
    files: int = 1,
    pack: Callable[[bytes], bytes] = bytes,
    ending: str = "",
) -> Path:
    """Write a bag of MCAP files with `metadata.yaml`.

    Args:
        folder: New folder.
        messages: Messages in the order of recording.
        preset: One of PRESETS.
        files: Number of files, as with `--max-bag-duration`.
        pack: Applied to each message, as with `--compression-mode message`.
        ending: ".zstd" compresses each file, as with `--compression-mode file`.
    """
    folder.mkdir()
    size, extents = -(-len(messages) // files), {}
    for number in range(files):
        part = messages[number * size : (number + 1) * size]
        file = folder / f"{folder.name}_{number}.mcap"
        with file.open("wb") as stream:
            writer: Any = Writer(stream, **PRESETS[preset])
            writer.start("ros2", "libmcap 1.3.0")
            channels: dict[str, int] = {}
            for each in part:
                if each.topic not in channels:
                    channels[each.topic] = add_channel(writer, each)
                times = each.log_time_ns, each.publish_time_ns
                writer.add_message(channels[each.topic], times[0], pack(each.data), times[1])
            writer.finish()
        if ending:
            file.with_name(file.name + ending).write_bytes(zstandard.compress(file.read_bytes()))
            file.unlink()
        extents[file.name + ending] = extent = Extent()
        for each in part:
            extent.add(each.log_time_ns)
    names = {each.topic: each.type_name for each in messages}
    counts = dict.fromkeys(names, 0)
    for each in messages:
        counts[each.topic] += 1
    listed = [Topic(name, type_, [], "", count=counts[name]) for name, type_ in names.items()]
    write_metadata(folder, extents, listed)
    return folder


def add_channel(writer: Any, message: Recorded) -> int:
    """Add the channel of a message as rosbag2 does."""
    definition = define(message.type_name)
    schema = writer.register_schema(message.type_name, "ros2msg", definition.text.encode())
    metadata = {
        "offered_qos_profiles": QOS_OF_HUMBLE,
        "topic_type_hash": definition.type_hash,
    }
    return int(writer.register_channel(message.topic, "cdr", schema, metadata))


def write_sqlite(
    folder: Path, messages: Sequence[Recorded], mode: CompressionMode = CompressionMode.NONE
) -> Path:
    """Write a bag in SQLite with the library rosbags."""
    writer = Rosbag2Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    links: dict[str, Any] = {}
    with writer:
        for each in messages:
            if each.topic not in links:
                define(each.type_name)
                names = each.topic, each.type_name
                links[each.topic] = writer.add_connection(*names, typestore=jazzy())
            writer.write(links[each.topic], each.log_time_ns, each.data)
    return folder


def killed_sqlite(folder: Path, messages: Sequence[Recorded], journal: str) -> Path:
    """Write what a killed recorder leaves of a bag in SQLite: no metadata, half in its journal.

    Args:
        folder: New folder.
        messages: Messages in the order of recording.
        journal: "WAL" (preset `resilient`) or "MEMORY".
    """
    half = len(messages) // 2
    write_sqlite(folder, messages[:half])
    (folder / "metadata.yaml").unlink()
    (file,) = folder.glob("*.db3")
    living = folder.with_name("living.db3")
    shutil.move(file, living)
    database = sqlite3.connect(living)
    database.execute(f"PRAGMA journal_mode = {journal}")
    numbers = dict(database.execute("SELECT name, id FROM topics"))
    rows = [
        (numbers[each.topic], each.log_time_ns, each.data)
        for each in messages[half:]
        if each.topic in numbers
    ]
    database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    database.commit()
    for ending in ("", "-wal", "-journal"):
        if (left := living.with_name(living.name + ending)).exists():
            shutil.copyfile(left, file.with_name(file.name + ending))
    database.close()
    return folder


def cut(file: Path, share: float) -> None:
    """Cut a file as a kill leaves it: no index, the last record incomplete."""
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
