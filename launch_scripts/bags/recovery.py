"""Recover a bag: copy all that is undamaged into a new folder, with index and `metadata.yaml`."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from textwrap import indent
from typing import Any

from mcap.records import Channel
from mcap.summary import Summary
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from ampc_msgs_config.config import MAX_YAML_BYTES, parse, read
from ampc_msgs_config.recording.bag_metadata import (
    FILE_NAME,
    ROOT_KEY,
    Extent,
    Topic,
    total_of,
    write_metadata,
)
from ampc_msgs_config.types import NANOSECONDS
from launch_scripts.bags.bag import (
    SQLITE_ENDING,
    bag_files,
    check_format,
    damage_of,
    open_decompressed,
    reason_of,
)
from launch_scripts.bags.salvage import Salvage, salvage

LONG_SILENCE = NANOSECONDS
"""Topics whose last message is earlier than this before the end are listed [ns]."""
KEPT_KEYS = ("custom_data", "ros_distro")
"""Keys of the old `metadata.yaml` that the new one keeps."""


def default_output(bag: Path) -> Path:
    """Return the folder for the recovered bag, beside the bag or beside the bag of a file."""
    bag = bag.resolve()
    name = bag.name.partition(".mcap")[0] if bag.is_file() else bag.name
    beside = bag.parent if (bag.parent / FILE_NAME).exists() else bag
    return beside.with_name(f"{name}_recovered")


def recover(bag: Path, output: Path) -> list[str]:
    """Write all that is undamaged in a bag into a new folder, unless it is complete and in MCAP.

    Returns:
        Lines for the user: what was kept and what was lost.

    Raises:
        ValueError: Nothing can be read, or the new folder exists already.
        OSError: The new folder cannot be written; it has been removed.
    """
    lines, files = [], []
    for file in bag_files(bag):
        try:
            check_format(file)
            files.append(file)
        except ValueError as error:
            lines.append(str(error))
    if not files:
        raise ValueError(lines[0])
    if output.exists():
        raise ValueError(f"{output}: exists already, and nothing is overwritten")
    output.mkdir(parents=True)
    try:
        # The old files are only read.
        new: dict[str, Salvage] = {}
        for file in files:
            name = f"{output.name}_{len(new)}.mcap"
            try:
                with open_decompressed(file) as (source, fault), (output / name).open("x+b") as to:
                    lines += [f"{file}: {fault}"] if fault else []
                    new[name] = salvage(source, to)
                lines += losses(file, new[name])
            except OSError:
                raise
            except Exception as error:  # the libraries raise many kinds
                (output / name).unlink()
                lines.append(f"{file}: nothing can be read: {reason_of(error)}")
        if not new:
            raise ValueError("; ".join(lines))
        salvages = list(new.values())
        extents = {name: extent_of(each.index) for name, each in new.items()}
        topics, old = topics_of(salvages), read_metadata(bag)
        size = bag_size(salvages, list(extents.values()), topics)
        is_database = any(SQLITE_ENDING in file.name for file in files)
        if (
            not (lines or is_database)
            and all(each.is_undamaged for each in salvages)
            and old.get("message_count") == sum(extent.count for extent in extents.values())
            and old.get("relative_file_paths") == [file.name for file in files]
        ):
            shutil.rmtree(output)
            return [f"{bag}: complete already: {size}"]
        kept = {key: old[key] for key in KEPT_KEYS if key in old}
        write_metadata(output, extents, topics.values(), kept)
    except (OSError, ValueError):
        shutil.rmtree(output, ignore_errors=True)
        raise
    done = "converted from SQLite to MCAP" if is_database else "recovered"
    return [*lines, *silent_topics(salvages, topics), f"{output}: {done}: {size}"]


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return the content of `metadata.yaml`, empty if it is missing, damaged or beyond limits."""
    try:
        return dict(read(folder / FILE_NAME)[ROOT_KEY])
    except (ValueError, TypeError, KeyError):
        return {}


def extent_of(index: Summary) -> Extent:
    """Return number and times of the messages of a file."""
    counts = index.statistics
    assert counts is not None  # the salvaged file has a complete index
    return Extent(counts.message_count, counts.message_start_time, counts.message_end_time)


def topics_of(salvages: Sequence[Salvage]) -> dict[str, Topic]:
    """Return the topics of all files of a bag, by name."""
    topics: dict[str, Topic] = {}
    for index in (each.index for each in salvages):
        counts: Any = index.statistics
        for number, channel in index.channels.items():
            schema = index.schemas.get(channel.schema_id)
            topic = Topic(
                channel.topic,
                schema.name if schema else "",
                offered_qos(channel),
                channel.metadata.get("topic_type_hash", ""),
                channel.message_encoding,
            )
            topic = topics.setdefault(channel.topic, topic)
            topic.count += counts.channel_message_counts.get(number, 0)
    return topics


def offered_qos(channel: Channel) -> list[dict[str, Any]]:
    """Convert the QoS profiles of a channel, of any version of rosbag2, to version 9."""
    text = channel.metadata.get("offered_qos_profiles", "")[:MAX_YAML_BYTES]
    try:  # our parser bounds nesting, the one of rosbags does not
        profiles = parse("profiles:\n" + indent(text, " "), channel.topic)["profiles"]
        return [dict(qos) for qos in dump_qos_v9(parse_qos(profiles or []))]
    except (ReaderError, AttributeError, KeyError, TypeError, ValueError):
        return []


def bag_size(
    salvages: Sequence[Salvage], extents: Sequence[Extent], topics: dict[str, Topic]
) -> str:
    """Return the size of a bag in words."""
    extent = total_of(extents)
    counts = {
        "attachments": sum(len(each.index.attachment_indexes) for each in salvages),
        "metadata records": sum(len(each.index.metadata_indexes) for each in salvages),
    }
    parts = [
        f"{extent.count} messages on {len(topics)} topics",
        f"{(extent.end_ns - extent.start_ns) / NANOSECONDS:.3f} s",
        *(f"{count} {noun}" for noun, count in counts.items() if count),
    ]
    return ", ".join(parts)


def losses(file: Path, result: Salvage) -> list[str]:
    """Return one line for each loss in one file."""
    lines = []
    if result.tail_bytes:
        kept = f", of which {result.from_tail} messages are kept" if result.from_tail else ""
        lines.append(f"{file}: the last {result.tail_bytes} bytes are a cut record{kept}")
    elif not result.reached_end:
        lines.append(f"{file}: was not closed; no record is cut")
    elif not result.was_closed:
        lines.append(f"{file}: only the index was missing")
    elif result.index_damaged:
        lines.append(f"{file}: the index was damaged")
    return lines + damage_of(file, result)


def silent_topics(salvages: Sequence[Salvage], topics: dict[str, Topic]) -> list[str]:
    """Return one line for each topic whose messages ended long before the bag."""
    last_ns = {name: max(each.last_ns.get(name, 0) for each in salvages) for name in topics}
    end_ns = max(last_ns.values(), default=0)
    return [
        f"{name}: last message {(end_ns - last) / NANOSECONDS:.3f} s before the end"
        for name, last in last_ns.items()
        if topics[name].count > 1 and end_ns - last > LONG_SILENCE
    ]
