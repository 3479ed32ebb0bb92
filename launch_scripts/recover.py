"""Makes a complete bag of one that ends early or is damaged: ``recover BAG [--output NEW]``.

The recorder or `ros2 bag record` was killed, the disk was full, a byte was lost: what is whole goes
into a new folder, with index and `metadata.yaml`, and the bag itself stays as it is. Exit code 0:
recovered, or nothing was missing; 2: nothing can be read.
"""

import argparse
import shutil
import sys
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
from launch_scripts.bags.bag import check, files, is_closed, plain
from launch_scripts.bags.salvage import Salvage, salvage

SILENCE = NANOSECONDS
"""Of topics whose last message lies longer than this before the end, that is told [ns]."""
KEPT = ("custom_data", "ros_distro")


def main(arguments: Sequence[str] | None = None) -> int:
    """Recovers one bag and gives the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("bag", type=Path, help="folder of the bag, or one of its files")
    parser.add_argument("--output", type=Path, help="new folder (BAG_recovered)")
    chosen = parser.parse_args(arguments)
    output = chosen.output or default_output(chosen.bag)
    try:
        print("\n".join(recover(chosen.bag, output)))
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: {output}: cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    return 0


def default_output(bag: Path) -> Path:
    """Gives the folder beside a bag, or beside the bag of a file, for what is recovered of it."""
    bag = bag.resolve()
    name = bag.name.partition(".mcap")[0] if bag.is_file() else bag.name
    beside = bag.parent if (bag.parent / FILE_NAME).exists() else bag
    return beside.with_name(f"{name}_recovered")


def recover(bag: Path, output: Path) -> list[str]:
    """Writes what is whole in a bag into a new folder, unless nothing is missing in the bag.

    Returns:
        What was kept and what was lost, in lines for people.

    Raises:
        ValueError: Nothing can be read, or the new folder exists already.
        OSError: The new folder cannot be written; it is gone again.
    """
    said, usable = sort_out(files(bag))
    if output.exists():
        raise ValueError(f"{output}: exists already, and nothing is overwritten")
    output.mkdir(parents=True)
    try:
        found = [copy(file, output, number) for number, file in enumerate(usable)]
        topics = merged(found)
        old = read_metadata(bag)
        if not said and is_complete(usable, found, old):
            shutil.rmtree(output)
            return [f"{bag}: complete already: {contents(found, topics)}"]
        extents = {file_name(output, number): each.extent for number, each in enumerate(found)}
        kept = {key: old[key] for key in KEPT if key in old}
        write_metadata(output, extents, topics.values(), kept)
    except OSError:
        shutil.rmtree(output, ignore_errors=True)
        raise
    said += [line for file, each in zip(usable, found, strict=True) for line in losses(file, each)]
    return [*said, *silences(topics), f"{output}: recovered: {contents(found, topics)}"]


def sort_out(candidates: Iterable[Path]) -> tuple[list[str], list[Path]]:
    """Gives complaints about files that are no MCAP at all, and the other files.

    Raises:
        ValueError: There is no other.
    """
    said, usable = [], []
    for file in candidates:
        try:
            check(file)
            usable.append(file)
        except ValueError as error:
            said.append(str(error))
    if not usable:
        raise ValueError(said[0])
    return said, usable


def file_name(output: Path, number: int) -> str:
    """Gives the name of a file of the new bag."""
    return f"{output.name}_{number}.mcap"


def copy(file: Path, output: Path, number: int) -> Salvage:
    """Copies what is whole in one file."""
    with plain(file) as source, (output / file_name(output, number)).open("xb") as target:
        return salvage(source, target)


def merged(found: Iterable[Salvage]) -> dict[str, Topic]:
    """Gives the topics of all files of a bag."""
    topics: dict[str, Topic] = {}
    for each in found:
        for topic in each.topics.values():
            empty = Topic(
                topic.name, topic.type_name, topic.offers, topic.type_hash, topic.encoding
            )
            topics.setdefault(topic.name, empty).extent.include(topic.extent)
    return topics


def is_complete(usable: Sequence[Path], found: Sequence[Salvage], old: dict[str, Any]) -> bool:
    """Tells whether a bag lacks nothing: end marks, index, and a `metadata.yaml` that fits."""
    return (
        all(each.is_undamaged for each in found)
        and all(is_closed(file) for file in usable)
        and old.get("message_count") == sum(each.extent.count for each in found)
        and old.get("relative_file_paths") == [file.name for file in usable]
    )


def contents(found: Sequence[Salvage], topics: dict[str, Topic]) -> str:
    """Says what is in a bag."""
    whole = Extent()
    for each in found:
        whole.include(each.extent)
    parts = [
        f"{whole.count} messages on {len(topics)} topics",
        f"{(whole.end_ns - whole.start_ns) / NANOSECONDS:.3f} s",
    ]
    for count, word in (
        (sum(each.attachments for each in found), "attachments"),
        (sum(each.metadata_records for each in found), "metadata records"),
    ):
        parts += [f"{count} {word}"] if count else []
    return ", ".join(parts)


def losses(file: Path, found: Salvage) -> list[str]:
    """Says what one file lacks."""
    said = []
    if found.tail_bytes:
        kept = f", of which {found.from_tail} messages are kept" if found.from_tail else ""
        said.append(f"{file}: the last {found.tail_bytes} bytes are a cut record{kept}")
    elif not found.reached_end:
        said.append(f"{file}: was not closed; no record is cut")
    elif not is_closed(file):
        said.append(f"{file}: only the index was missing")
    if found.damaged:
        said.append(
            f"{file}: {found.damaged} damaged chunks or records, "
            f"{found.damaged_bytes} bytes, are left out"
        )
    return said


def silences(topics: dict[str, Topic]) -> list[str]:
    """Says which topics had fallen silent before the end."""
    end_ns = max((topic.extent.end_ns for topic in topics.values()), default=0)
    return [
        f"{topic.name}: last message {(end_ns - topic.extent.end_ns) / NANOSECONDS:.3f} s "
        "before the end"
        for topic in topics.values()
        if topic.extent.count > 1 and end_ns - topic.extent.end_ns > SILENCE
    ]


if __name__ == "__main__":
    sys.exit(main())
