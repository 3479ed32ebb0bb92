"""The messages of a complete MCAP file in the order of their log times.

`mcap` reads them too, and does so here where a file has no index of chunks; but it makes an object
of every message, wanted or not, and passes each through a heap, which takes twice as long.
"""

import zlib
from collections.abc import Collection, Iterator
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Chunk, ChunkIndex, Schema
from mcap.summary import Summary

from launch_scripts.bags.mcap_records import HEAD, MESSAGE, decompressed


class Found(NamedTuple):
    """A message, in the order in which messages are given: by log time, then as recorded."""

    log_time_ns: int
    chunk: int
    """Place of its chunk in the file."""
    place: int
    """Its place in the chunk."""
    publish_time_ns: int
    channel: int
    data: bytes


class Raw(NamedTuple):
    """A message as it is in the file, and what the file says about it."""

    schema: Schema | None
    channel: Channel
    log_time_ns: int
    publish_time_ns: int
    data: bytes


def ordered(stream: IO[bytes], topics: Collection[str]) -> Iterator[Raw]:
    """Give each message of wanted topics.

    Args:
        stream: A complete MCAP file.
        topics: Full names of the topics wanted; empty means all.

    Raises:
        ValueError: A chunk is damaged.
    """
    summary = make_reader(stream).get_summary()
    if summary is None or not summary.chunk_indexes or not summary.channels:
        stream.seek(0)
        reader = NonSeekingReader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(topics or None):
            yield Raw(schema, channel, message.log_time, message.publish_time, message.data)
        return
    wanted = {
        number: (summary.schemas.get(channel.schema_id), channel)
        for number, channel in summary.channels.items()
        if not topics or channel.topic in topics
    }
    for found in merged(stream, summary, wanted):
        yield Raw(*wanted[found.channel], found.log_time_ns, found.publish_time_ns, found.data)


def merged(stream: IO[bytes], summary: Summary, wanted: Collection[int]) -> Iterator[Found]:
    """Give the messages of wanted channels, of chunks that may overlap in time."""
    waiting: list[Found] = []
    for index in sorted(summary.chunk_indexes, key=position):
        channels = index.message_index_offsets
        if channels and channels.keys().isdisjoint(wanted):
            continue
        waiting.sort()
        ready = sum(found.log_time_ns < index.message_start_time for found in waiting)
        yield from waiting[:ready]
        waiting = waiting[ready:]
        waiting += in_chunk(stream, index, wanted)
    yield from sorted(waiting)


def position(index: ChunkIndex) -> tuple[int, int]:
    """Give the place of a chunk in the order of time."""
    return index.message_start_time, index.chunk_start_offset


def in_chunk(stream: IO[bytes], index: ChunkIndex, wanted: Collection[int]) -> Iterator[Found]:
    """Give the messages of wanted channels in one chunk."""
    stream.seek(index.chunk_start_offset + HEAD.size)
    chunk = Chunk.read(ReadDataStream(stream))
    content = decompressed(chunk)
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError(f"checksum of the chunk at byte {index.chunk_start_offset}")
    place = 0
    while place < len(content):
        kind, length = HEAD.unpack_from(content, place)
        place += HEAD.size
        if kind == Opcode.MESSAGE:
            channel, _, log_time_ns, publish_time_ns = MESSAGE.unpack_from(content, place)
            if channel in wanted:
                data = content[place + MESSAGE.size : place + length]
                yield Found(
                    log_time_ns, index.chunk_start_offset, place, publish_time_ns, channel, data
                )
        place += length
