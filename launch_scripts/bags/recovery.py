"""Recover a bag: copy all that is undamaged into a new folder, with index and `metadata.yaml`."""

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ampc_msgs_config.recording.bag_metadata import (
    FILE_NAME,
    Extent,
    Topic,
    read_metadata,
    write_metadata,
)
from ampc_msgs_config.types import NANOSECONDS
from launch_scripts.bags.bag import bag_files, check_format, open_decompressed
from launch_scripts.bags.salvage import Salvage, salvage

SILENCE = NANOSECONDS
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
    """Write all that is undamaged in a bag into a new folder, unless the bag is complete.

    Returns:
        Lines for the user: what was kept and what was lost.

    Raises:
        ValueError: Nothing can be read, or the new folder exists already.
        OSError: The new folder cannot be written; it has been removed.
    """
    lines, files = select_mcap_files(bag_files(bag))
    if output.exists():
        raise ValueError(f"{output}: exists already, and nothing is overwritten")
    output.mkdir(parents=True)
    names = [f"{output.name}_{number}.mcap" for number in range(len(files))]
    try:
        # The old files are only read.
        salvages = []
        for file, name in zip(files, names, strict=True):
            with open_decompressed(file) as source, (output / name).open("xb") as target:
                salvages.append(salvage(source, target))
        topics = merge_topics(salvages)
        old = read_metadata(bag)
        if not lines and is_complete(files, salvages, old):
            shutil.rmtree(output)
            return [f"{bag}: complete already: {summary(salvages, topics)}"]
        extents = {name: each.extent for name, each in zip(names, salvages, strict=True)}
        kept = {key: old[key] for key in KEPT_KEYS if key in old}
        write_metadata(output, extents, topics.values(), kept)
    except OSError:
        shutil.rmtree(output, ignore_errors=True)
        raise
    for file, each in zip(files, salvages, strict=True):
        lines += losses(file, each)
    return [*lines, *silent_topics(topics), f"{output}: recovered: {summary(salvages, topics)}"]


def select_mcap_files(candidates: Iterable[Path]) -> tuple[list[str], list[Path]]:
    """Return one line for each file that is not MCAP, and the other files.

    Raises:
        ValueError: No file is MCAP.
    """
    lines, files = [], []
    for file in candidates:
        try:
            check_format(file)
            files.append(file)
        except ValueError as error:
            lines.append(str(error))
    if not files:
        raise ValueError(lines[0])
    return lines, files


def merge_topics(salvages: Iterable[Salvage]) -> dict[str, Topic]:
    """Return the topics of all files of a bag, by name."""
    topics: dict[str, Topic] = {}
    for each in salvages:
        for name, topic in each.topics.items():
            topics.setdefault(name, topic.without_messages()).extent.include(topic.extent)
    return topics


def is_complete(files: Sequence[Path], salvages: Sequence[Salvage], old: dict[str, Any]) -> bool:
    """Return whether end marks, index and `metadata.yaml` of a bag are complete."""
    return (
        all(each.is_undamaged for each in salvages)
        and old.get("message_count") == sum(each.extent.count for each in salvages)
        and old.get("relative_file_paths") == [file.name for file in files]
    )


def summary(salvages: Sequence[Salvage], topics: dict[str, Topic]) -> str:
    """Return the size of a bag in words."""
    extent = Extent()
    for each in salvages:
        extent.include(each.extent)
    counts = {
        "attachments": sum(each.attachments for each in salvages),
        "metadata records": sum(each.metadata_records for each in salvages),
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
    if result.damaged:
        lines.append(
            f"{file}: {result.damaged} damaged chunks or records, "
            f"{result.damaged_bytes} bytes, are left out"
        )
    return lines


def silent_topics(topics: dict[str, Topic]) -> list[str]:
    """Return one line for each topic whose messages ended long before the bag."""
    end_ns = max((topic.extent.end_ns for topic in topics.values()), default=0)
    return [
        f"{topic.name}: last message {(end_ns - topic.extent.end_ns) / NANOSECONDS:.3f} s "
        "before the end"
        for topic in topics.values()
        if topic.extent.count > 1 and end_ns - topic.extent.end_ns > SILENCE
    ]
