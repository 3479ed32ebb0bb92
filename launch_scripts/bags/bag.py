"""Read bags: our own, those of `ros2 bag record`, and what a killed recorder left of one."""

import heapq
import tempfile
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import IO, Any, NamedTuple

import zstandard
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from rclpy.serialization import deserialize_message

from ampc_msgs_config.recording.message_types import TYPES, message_class
from launch_scripts.bags.chunks import ordered
from launch_scripts.bags.mcap_records import MAGIC
from launch_scripts.bags.salvage import salvage

SQLITE = b"SQLite format 3\0"
ZSTD = b"\x28\xb5\x2f\xfd"
PROFILES = ("ros2", "")
BLOCK = 1 << 20
Decoder = Callable[[bytes], Any]


class Entry(NamedTuple):
    """One message of a bag."""

    topic: str
    """Full name, such as `/odom`."""
    log_time_ns: int
    """Time that a player keeps: simulated time where the clock was simulated [ns]."""
    message: Any
    """The ROS message."""
    publish_time_ns: int
    """Wall time of publishing [ns]."""


def read(bag: Path, topics: Collection[str] = (), lazy: Collection[str] = ()) -> Iterator[Entry]:
    """Give the messages of a bag in the order of their log times.

    Args:
        bag: Folder of the bag, or one of its files.
        topics: Full names of the topics wanted; empty means all.
        lazy: Full names of those whose messages are decoded when they are called, for a reader
            who needs few of them.

    Returns:
        Messages of types that are installed here; others are skipped. Those of one log time keep
        the order in which they were recorded. A file that ends early gives all that is whole in
        it; `is_complete` tells.

    Raises:
        ValueError: One line that names the file: there is no bag, it cannot be understood, or a
            wanted topic of the contract has another type there.
    """
    found = files(bag)
    for file in found:
        check(file)
    parts = [read_file(file, topics, lazy) for file in found]
    return heapq.merge(*parts, key=lambda entry: entry.log_time_ns)


def is_complete(bag: Path) -> bool:
    """Tell whether each file of a bag was closed properly."""
    return all(is_closed(file) for file in files(bag))


def is_closed(file: Path) -> bool:
    """Tell whether a file ends as it began, with the magic number."""
    with plain(file) as stream:
        return ends_well(stream)


def ends_well(stream: IO[bytes]) -> bool:
    """Tell whether an MCAP file ends as it began, with the magic number."""
    size = stream.seek(0, 2)
    stream.seek(max(0, size - len(MAGIC)))
    return size > len(MAGIC) and stream.read() == MAGIC


def files(bag: Path) -> list[Path]:
    """Give the MCAP files of a bag, compressed or not, in their order.

    Raises:
        ValueError: There is none.
    """
    if bag.is_file():
        return [bag]
    if not bag.is_dir():
        raise ValueError(f"{bag}: there is no such file or folder")
    plain_files = {file.name: file for file in bag.glob("*.mcap")}
    packed = (file for file in bag.glob("*.mcap.zstd") if file.stem not in plain_files)
    found = sorted((*plain_files.values(), *packed), key=lambda file: (len(file.stem), file.name))
    if not found and any(bag.glob("*.db3*")):
        raise ValueError(f"{bag}: a bag in SQLite files: `ros2 bag convert` makes MCAP of it")
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
            start = stream.read(len(SQLITE))
    except OSError as error:
        raise ValueError(f"{file}: cannot be read: {error.strerror}") from error
    if not start:
        raise ValueError(f"{file}: no bag: the file is empty")
    if start == SQLITE:
        raise ValueError(f"{file}: a bag in SQLite: `ros2 bag convert` makes MCAP of it")
    if not start.startswith((MAGIC, ZSTD)):
        raise ValueError(f"{file}: no bag: the file does not begin as MCAP files do")


def plain(file: Path) -> IO[bytes]:
    """Open a file; one that is compressed as a whole is unpacked, as far as it goes."""
    stream = file.open("rb")
    if stream.read(len(ZSTD)) != ZSTD:
        stream.seek(0)
        return stream
    stream.seek(0)
    unpacked: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed by the caller
    with stream:
        unpack = zstandard.ZstdDecompressor().decompressobj()
        while block := stream.read(BLOCK):
            unpacked.write(unpack.decompress(block))
    unpacked.seek(0)
    return unpacked


def whole(stream: IO[bytes]) -> IO[bytes]:
    """Give a complete MCAP file at its beginning: this one, or what is whole in it."""
    is_whole = ends_well(stream)
    stream.seek(0)
    if is_whole:
        return stream
    target: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed by the caller
    with stream:
        salvage(stream, target, compress=False)
    target.seek(0)
    return target


def read_file(file: Path, topics: Collection[str], lazy: Collection[str] = ()) -> Iterator[Entry]:
    """Give the messages of one MCAP file up to its end, wherever that is."""
    try:
        with whole(plain(file)) as stream:
            yield from decoded(stream, topics, lazy)
    except WrongType as error:
        raise ValueError(f"{file}: {error}") from error
    except Exception as error:  # what a damaged byte makes the libraries raise has no end
        reason = " ".join(str(error).split()) or "it ends early"
        raise ValueError(f"{file}: damaged or foreign: {reason}") from error


def decoded(
    stream: IO[bytes], topics: Collection[str], lazy: Collection[str] = ()
) -> Iterator[Entry]:
    """Decode the messages of wanted topics whose type is installed."""
    profile = make_reader(stream).get_header().profile
    if profile not in PROFILES:
        raise ValueError(f"its profile is {profile!r}, not 'ros2'")
    stream.seek(0)
    decoders: dict[int, Decoder | None] = {}
    for schema, channel, log_time_ns, publish_time_ns, data in ordered(stream, topics):
        if channel.id not in decoders:
            decoders[channel.id] = decoder(channel, schema, wanted=bool(topics))
        decode = decoders[channel.id]
        if decode:
            message = partial(decode, data) if channel.topic in lazy else decode(data)
            yield Entry(channel.topic, log_time_ns, message, publish_time_ns)


class WrongType(ValueError):
    """A topic of the contract has another type than the contract says."""


def decoder(channel: Channel, schema: Schema | None, *, wanted: bool) -> Decoder | None:
    """Give the way from bytes to a message, or None where the type is not installed.

    Raises:
        WrongType: The topic is wanted and of the contract, but not of the contract's type.
    """
    type_name = schema.name if schema else "no type"
    right = contract_type(channel.topic)
    if wanted and right not in (None, type_name):
        raise WrongType(f"topic {channel.topic} is of type {type_name}, {right} is needed")
    if channel.message_encoding != "cdr":
        return None
    try:
        cls = message_class(type_name)
    except ValueError:
        return None
    return lambda data: deserialize_message(data, cls)


def contract_type(topic: str) -> str | None:
    """Give the type of a topic of the contract, in whatever namespace, or None."""
    fitting = (type_ for name, type_ in TYPES.items() if topic.endswith("/" + name.lstrip("/")))
    return next(fitting, None)
