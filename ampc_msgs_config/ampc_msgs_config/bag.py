"""Read bags: our own, those of `ros2 bag record`, and what a killed recorder left of one."""

from collections.abc import Callable, Collection, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, DataEnd, Header, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from rclpy.serialization import deserialize_message

from ampc_msgs_config.message_types import message_class

MAGIC = b"\x89MCAP0\r\n"
PROFILES = ("ros2", "")
Decoder = Callable[[bytes], Any]


class Entry(NamedTuple):
    """One message of a bag."""

    topic: str
    """Full name, such as `/odom`."""
    log_time_ns: int
    """Time that a player keeps: simulated time where the clock was simulated [ns]."""
    message: Any
    """The ROS message."""


def read(bag: Path, topics: Collection[str] = (), lazy: Collection[str] = ()) -> Iterator[Entry]:
    """Give the messages of a bag in the order in which they were recorded.

    Args:
        bag: Folder of the bag, or one MCAP file.
        topics: Full names of the topics wanted; empty means all.
        lazy: Full names of those whose messages are decoded when they are called, for a reader
            who needs few of them.

    Returns:
        Messages of types that are installed here; others are skipped. A file that ends early
        gives all of its complete chunks; `is_complete` tells.

    Raises:
        ValueError: One line that names the file: there is no bag, or it cannot be understood.
    """
    found = files(bag)
    for file in found:
        check(file)
    return (entry for file in found for entry in read_file(file, topics, lazy))


def is_complete(bag: Path) -> bool:
    """Tell whether each file of a bag was closed properly."""
    return all(is_closed(file) for file in files(bag))


def is_closed(file: Path) -> bool:
    """Tell whether a file ends as it began, with the magic number."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(max(0, size - len(MAGIC)))
        return size > len(MAGIC) and stream.read() == MAGIC


def files(bag: Path) -> list[Path]:
    """Give the MCAP files of a bag in their order.

    Raises:
        ValueError: There is none.
    """
    if bag.is_file():
        return [bag]
    if not bag.is_dir():
        raise ValueError(f"{bag}: there is no such file or folder")
    found = sorted(bag.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
    if not found:
        raise ValueError(f"{bag}: no bag: the folder holds no .mcap file")
    return found


def check(file: Path) -> None:
    """Refuse what does not begin as an MCAP file does.

    Raises:
        ValueError: The file is empty, foreign or not readable.
    """
    try:
        with file.open("rb") as stream:
            start = stream.read(len(MAGIC))
    except OSError as error:
        raise ValueError(f"{file}: cannot be read: {error.strerror}") from error
    if not start:
        raise ValueError(f"{file}: no bag: the file is empty")
    if start != MAGIC:
        raise ValueError(f"{file}: no bag: the file does not begin as MCAP files do")


def read_file(file: Path, topics: Collection[str], lazy: Collection[str] = ()) -> Iterator[Entry]:
    """Give the messages of one MCAP file up to its end, wherever that is."""
    with file.open("rb") as stream:
        try:
            records = StreamReader(stream, validate_crcs=True).records
            yield from decoded(records, topics, lazy)
        except Exception as error:  # what a damaged byte makes the libraries raise has no end
            if not stream.read(1) and not is_closed(file):
                return
            reason = " ".join(str(error).split()) or "it ends early"
            raise ValueError(f"{file}: damaged or foreign: {reason}") from error


def decoded(
    records: Iterable[McapRecord], topics: Collection[str], lazy: Collection[str] = ()
) -> Iterator[Entry]:
    """Decode the messages of wanted topics whose type is installed."""
    schemas: dict[int, Schema] = {}
    decoders: dict[int, tuple[str, Decoder]] = {}
    for record in records:
        if isinstance(record, Header) and record.profile not in PROFILES:
            raise ValueError(f"its profile is {record.profile!r}, not 'ros2'")
        if isinstance(record, DataEnd):
            return
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and (not topics or record.topic in topics):
            decode = decoder(record, schemas.get(record.schema_id))
            late = record.topic in lazy
            if decode:
                decoders[record.id] = record.topic, partial(partial, decode) if late else decode
        elif isinstance(record, Message) and record.channel_id in decoders:
            topic, decode = decoders[record.channel_id]
            yield Entry(topic, record.log_time, decode(record.data))


def decoder(channel: Channel, schema: Schema | None) -> Decoder | None:
    """Give the way from bytes to a message, or None where the type is not installed."""
    if schema is None or channel.message_encoding != "cdr":
        return None
    try:
        cls = message_class(schema.name)
    except ValueError:
        return None
    return lambda data: deserialize_message(data, cls)
