"""Bags with seeded damage, and an oracle that knows which messages are intact.

A message is intact if it can be read from undamaged bytes alone:

* without compression: all bytes of its record are there, in one piece;
* in a compressed chunk: it is complete in what the compressed bytes before the first damage of
  the chunk decompress to (a compressor stores blocks of up to 128 kB, and nothing of a block can
  be had before all of it is there);
* and a record of its channel and of its schema is intact, in the data or in the summary; in a
  file without checksums, which cannot show which copy is the right one, every copy.
"""

import io
import random
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

Origin = NDArray[Any]
"""Position in the undamaged file of each byte of a damaged one; -1: altered or inserted."""
KINDS = ("flip", "zeros", "cut", "removed", "duplicated", "inserted")
"""Kinds of damage: `flip` is 1 to 64 bits at one place, the others are ranges of bytes."""
PLACES = ("record head", "chunk head", "chunk data", "message", "index", "footer", "anywhere")
MESSAGE = struct.Struct("<HIQQ")
OPENING = struct.Struct("<BQ")


class Part(NamedTuple):
    """A record of the undamaged file, or one inside a chunk."""

    opcode: int
    content: bytes
    start: int
    """Position of the record in the file; in a compressed chunk, in its content [bytes]."""
    end: int
    chunk: int
    """Position of the compressed data in the file; -1: not in a compressed chunk."""


class Key(NamedTuple):
    """All that a recovered message must agree in."""

    topic: str
    schema: str
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    data: bytes


class Sample(NamedTuple):
    """An undamaged file."""

    content: bytes
    has_checksums: bool
    parts: list[Part]
    compressed: dict[int, tuple[int, str]]
    """End of the compressed data and their compression, by their start [bytes]."""
    places: dict[str, list[tuple[int, int]]]
    """Ranges of the file by the name of their place."""


def make_sample(rng: random.Random) -> Sample:
    """Write a file with random options: compression, chunks, checksums, parts of the summary."""
    stream = io.BytesIO()
    is_chunked, has_checksums = rng.random() < 0.85, rng.random() < 0.8
    writer: Any = Writer(
        stream,
        chunk_size=rng.choice([500, 4000, 30_000, 400_000]),
        compression=rng.choice(list(CompressionType)),
        index_types=rng.choice([IndexType.ALL, IndexType.ALL, IndexType.NONE]),
        use_chunking=is_chunked,
        enable_crcs=has_checksums,
        repeat_channels=rng.random() < 0.9,
        repeat_schemas=rng.random() < 0.9,
        use_statistics=rng.random() < 0.9,
    )
    writer.start(profile="ros2", library="proof")
    for number in range(rng.choice([30, 300])):
        add_message(writer, rng, number)
    writer.finish()
    content = stream.getvalue()
    parts = list(parts_of(content))
    compressed = {}
    for part in parts:
        if part.opcode == Opcode.CHUNK:
            (name_length,) = struct.unpack_from("<I", part.content, 28)
            name = part.content[32 : 32 + name_length].decode()
            if name:
                compressed[part.start + 9 + 40 + name_length] = (part.end, name)
    return Sample(content, has_checksums, parts, compressed, places_of(content, parts))


def add_message(writer: Any, rng: random.Random, number: int) -> None:
    """Write a message on one of four topics, among them records of 128 bytes."""
    topic, message = rng.choice(
        [
            ("/odom", Odometry()),
            ("/tick", JointState(name=["a", "b"], position=[rng.random(), float(number)])),
            ("/flag", Bool(data=bool(number % 2))),
            ("/text", String(data="x" * (128 - 9 - 22 - 4 - 4 - 1))),
        ]
    )
    if topic == "/odom":
        message.header.stamp.sec, message.pose.pose.position.x = number, rng.random()
        message.header.frame_id, message.child_frame_id = "map", "base_link"
    channels = writer.__dict__.setdefault("channels_of_proof", {})
    if topic not in channels:
        name = f"pkg/msg/{type(message).__name__}"
        schema = writer.register_schema(name, "ros2msg", b"float64 x\n" * 20)
        channels[topic] = writer.register_channel(topic, "cdr", schema, {"key": "value"})
    time_ns = 10**18 + number * 10**7
    writer.add_message(channels[topic], time_ns, serialize_message(message), time_ns + 5, number)


def parts_of(content: bytes) -> Iterator[Part]:
    """Return all records of an undamaged file, those inside chunks behind their chunk."""
    position = 8
    while position < len(content) - 8:
        opcode, length = OPENING.unpack_from(content, position)
        end = position + 9 + length
        yield Part(opcode, content[position + 9 : end], position, end, -1)
        if opcode == Opcode.CHUNK:
            (name_length,) = struct.unpack_from("<I", content, position + 9 + 28)
            name = content[position + 41 : position + 41 + name_length]
            data = position + 9 + 40 + name_length
            inside, chunk = content[data:end], data if name else -1
            if name:
                inside = decompress(inside, name.decode())
            place = 0
            while place < len(inside):
                opcode, length = OPENING.unpack_from(inside, place)
                after = place + 9 + length
                offset = 0 if name else data
                yield Part(opcode, inside[place + 9 : after], offset + place, offset + after, chunk)
                place = after
        position = end


def decompress(data: bytes, compression: str) -> bytes:
    """Return what the beginning of a frame decompresses to."""
    if compression == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data))


def places_of(content: bytes, parts: list[Part]) -> dict[str, list[tuple[int, int]]]:
    """Return the ranges of a file by the name of their place."""
    places: dict[str, list[tuple[int, int]]] = {"anywhere": [(8, len(content))]}

    def add(name: str, start: int, end: int) -> None:
        places.setdefault(name, []).append((start, end))

    for part in parts:
        if part.chunk >= 0:
            continue
        add("record head", part.start, part.start + 9)
        if part.opcode == Opcode.CHUNK:
            (name_length,) = struct.unpack_from("<I", part.content, 28)
            add("chunk head", part.start, part.start + 49 + name_length)
            add("chunk data", part.start + 49 + name_length, part.end)
        elif part.opcode == Opcode.MESSAGE:
            add("message", part.start, part.end)
        elif part.opcode == Opcode.FOOTER:
            add("footer", part.start, len(content))
        else:
            add("index", part.start, part.end)
    return places


def damage(sample: Sample, kind: str, place: str, rng: random.Random) -> tuple[bytes, Origin]:
    """Damage a file at a random position of a place.

    Returns:
        The damaged file, and the origin of each of its bytes.
    """
    content = np.frombuffer(sample.content, dtype=np.uint8).copy()
    origin: Origin = np.arange(len(content))
    start, end = rng.choice(sample.places.get(place, sample.places["anywhere"]))
    at = rng.randrange(start, end)
    size = min(rng.choice([1, 2, 7, 40, 300, 3000]), len(content) - at)
    if kind == "flip":
        for _ in range(rng.choice([1, 1, 1, 2, 8, 64])):
            bit = rng.randrange(8 * min(32, len(content) - at))
            content[at + bit // 8] ^= 1 << bit % 8
    elif kind == "zeros":
        content[at : at + size] = 0
    elif kind == "cut":
        content, origin = content[:at], origin[:at]
    elif kind == "removed":
        content, origin = (np.delete(each, slice(at, at + size)) for each in (content, origin))
    elif kind == "duplicated":
        content, origin = (np.insert(e, at + size, e[at : at + size]) for e in (content, origin))
    else:
        noise = np.frombuffer(rng.randbytes(size), dtype=np.uint8)
        content, origin = np.insert(content, at, noise), np.insert(origin, at, np.full(size, -1))
    before = np.frombuffer(sample.content, dtype=np.uint8)
    origin[(origin >= 0) & (content != before[origin])] = -1
    return content.tobytes(), origin


def intact_messages(sample: Sample, origin: Origin) -> list[Key]:
    """Return the messages of a damaged file that can be read from undamaged bytes alone."""
    depth = {data: decompressible(sample, data, origin) for data in sample.compressed}

    def is_intact(part: Part) -> bool:
        if part.chunk >= 0:
            return part.end <= depth[part.chunk]
        return longest_run(origin, part.start, part.end) == part.end - part.start

    schemas, channels = dict[int, str](), dict[int, tuple[int, str]]()
    for part in sample.parts:
        if part.opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and is_intact(part):
            number, schema = struct.unpack_from("<HH", part.content)
            if part.opcode == Opcode.SCHEMA:
                schemas[number] = text_at(part.content, 2)
            else:
                channels[number] = schema, text_at(part.content, 4)
    for part in sample.parts if not sample.has_checksums else []:
        if part.opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and not is_intact(part):
            (number,) = struct.unpack_from("<H", part.content)
            (schemas if part.opcode == Opcode.SCHEMA else channels).pop(number, None)
    keys = []
    for part in sample.parts:
        if part.opcode == Opcode.MESSAGE and is_intact(part):
            channel, number, log_time_ns, publish_time_ns = MESSAGE.unpack_from(part.content)
            schema, topic = channels.get(channel, (0, ""))
            name, data = schemas.get(schema), part.content[MESSAGE.size :]
            if topic and name:
                keys.append(Key(topic, name, number, log_time_ns, publish_time_ns, data))
    return keys


def all_messages(sample: Sample) -> list[Key]:
    """Return all messages of an undamaged file."""
    return intact_messages(sample, np.arange(len(sample.content)))


def text_at(content: bytes, position: int) -> str:
    """Return the text at a position, which begins with its length."""
    (length,) = struct.unpack_from("<I", content, position)
    return content[position + 4 : position + 4 + length].decode()


def decompressible(sample: Sample, data: int, origin: Origin) -> int:
    """Return how many bytes the compressed data at a position yield before their first damage."""
    end, compression = sample.compressed[data]
    run = longest_run(origin, data, end)
    return len(decompress(sample.content[data : data + run], compression)) if run else 0


def longest_run(origin: Origin, start: int, end: int) -> int:
    """Return how many bytes from `start` on are there in one piece, in the best copy of them."""
    best = 0
    for place in np.flatnonzero(origin == start).tolist():
        found = origin[place : place + end - start]
        same = found == np.arange(start, start + len(found))
        best = max(best, len(same) if same.all() else int(same.argmin()))
    return best
