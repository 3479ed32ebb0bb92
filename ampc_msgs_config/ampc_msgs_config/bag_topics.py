"""What a bag announces, without reading its messages where it has an index."""

from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

from mcap.reader import make_reader
from mcap.records import Channel, McapRecord, Schema
from mcap.stream_reader import StreamReader

from ampc_msgs_config.bag import check, files, is_closed


def topics(bag: Path) -> dict[str, str]:
    """Give the topics of a bag and their types, such as `nav_msgs/msg/Odometry`.

    Raises:
        ValueError: One line that names the file: there is no bag, or it cannot be understood.
    """
    found: dict[str, str] = {}
    for file in files(bag):
        check(file)
        found |= announced(file)
    return found


def announced(file: Path) -> dict[str, str]:
    """Give topics and types of one file, up to its end, wherever that is."""
    found: dict[str, str] = {}
    schemas: dict[int, str] = {}
    closed = is_closed(file)
    with file.open("rb") as stream:
        try:
            for record in index(stream) if closed else StreamReader(stream).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    found[record.topic] = schemas.get(record.schema_id, "")
        except Exception as error:  # what a damaged byte makes the libraries raise has no end
            if closed or stream.read(1):
                reason = " ".join(str(error).split()) or "it ends early"
                raise ValueError(f"{file}: damaged or foreign: {reason}") from error
    return found


def index(stream: BinaryIO) -> Iterable[McapRecord]:
    """Give what stands at the end of a whole file, or all of it where there is no index."""
    summary = make_reader(stream).get_summary()
    if summary is not None and summary.channels:
        return (*summary.schemas.values(), *summary.channels.values())
    stream.seek(0)
    return StreamReader(stream).records
