"""Copy all undamaged records of an MCAP file that is cut or damaged into a complete file.

Schemas, channels with their metadata, attachments, metadata records, and messages with their times
and sequence numbers stay as they are in the file. If the file ends inside a chunk, the messages
before that point are kept, compressed or not. Of a compressed chunk that is damaged, the messages
before the damage are kept, and those behind it that still are messages; a checksum covers a whole
chunk, so such messages are counted as doubtful.

Own code, because the readers of `mcap` and `rosbags` stop at the first damaged record.
"""

import io
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO, Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.summary import Summary
from mcap.writer import CompressionType, Writer

from launch_scripts.bags.inflate import ZSTD_MAGIC, inflated
from launch_scripts.bags.resync import (
    CDR,
    HEAD,
    LENGTHS,
    MAGIC,
    MAX_RECORD_LENGTH,
    MESSAGE,
    Record,
    Scanner,
    compression_of,
    is_consistent,
)

DAMAGE = (
    *(McapError, struct.error, zstandard.ZstdError),
    *(ValueError, OverflowError, RuntimeError, EOFError),
)
"""Errors that the libraries raise on damaged bytes."""
INSIDE = (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL)
"""Records that a chunk may contain."""
DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
BAG_PROFILES = ("", "ros1", "ros2")
FOOTER_SIZE = HEAD.size + 20 + len(MAGIC)
"""Length of the end of a file, from the footer on [bytes]."""


@dataclass
class Salvage:
    """Result of salvaging one file."""

    index: Summary = field(default_factory=Summary)
    """Summary of the new file, with its channels and its numbers of records."""
    last_ns: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    """Latest log time of each topic [ns]."""
    was_closed: bool = False
    """Whether the file ends with the magic number."""
    reached_end: bool = False
    """Whether the data section is complete, up to its end record."""
    index_damaged: bool = False
    """Whether the summary cannot be read, or contradicts its checksum."""
    tail_bytes: int = 0
    """Length of the last record if it is cut [bytes]."""
    from_tail: int = 0
    """Number of messages kept from a chunk that is cut."""
    damaged: int = 0
    """Number of damaged places, records and chunks before the end."""
    damaged_bytes: int = 0
    """Length of the damaged places, records and chunks [bytes]."""
    doubtful: int = 0
    """Number of messages kept from damaged chunks, or in front of a damage: they may be wrong."""

    @property
    def is_undamaged(self) -> bool:
        """Whether nothing was lost, and nothing is missing but perhaps `metadata.yaml`."""
        return self.was_closed and self.reached_end and not (self.damaged or self.index_damaged)

    def damage(self, size: int) -> None:
        """Count a damaged place of so many bytes."""
        self.damaged += 1
        self.damaged_bytes += size


def salvage(source: IO[bytes], target: IO[bytes], *, compress: bool = True) -> Salvage:
    """Copy all undamaged records.

    Args:
        source: MCAP file.
        target: Receives a complete MCAP file, and is read again.
        compress: Whether the chunks of the target are compressed.

    Raises:
        ValueError: The source does not begin as an MCAP file.
    """
    result = Salvage(was_closed=is_closed(source))
    if not looks_like_mcap(source):
        raise ValueError("the file does not begin as MCAP files do")
    index = read_index(source)
    result.index_damaged = result.was_closed and index is None
    known = index or Summary()
    needed = {each.schema_id for each in known.channels.values()}
    if not known.channels or needed - {0, *known.schemas}:
        add_definitions(source, known)
    compression = CompressionType.ZSTD if compress else CompressionType.NONE
    copier = Copier(result, Writer(target, compression=compression), known)
    encodings = {number: each.message_encoding for number, each in known.channels.items()}
    for record in Scanner(source, encodings).records(0):
        copier.copy_record(record)
    copier.start("ros2", "")
    copier.writer.finish()
    result.index = read_index(target) or Summary()
    return result


def looks_like_mcap(stream: IO[bytes]) -> bool:
    """Return whether a file begins or ends as MCAP files do; leave the stream at its start.

    A file whose magic number is damaged is recognised by the header behind it, or by its end.
    """
    start = stream.read(len(MAGIC) + HEAD.size)
    opcode, length = HEAD.unpack(start[len(MAGIC) :].ljust(HEAD.size, b"\0"))
    shortest, longest = LENGTHS[Opcode.HEADER]
    has_header = opcode == Opcode.HEADER and shortest <= length <= longest
    return is_closed(stream) or has_header or start.startswith(MAGIC)


def is_closed(stream: IO[bytes]) -> bool:
    """Return whether an MCAP file ends with the magic number; leave the stream at its start."""
    size = stream.seek(0, 2)
    stream.seek(max(0, size - len(MAGIC)))
    has_magic = stream.read() == MAGIC
    stream.seek(0)
    return size > len(MAGIC) and has_magic


def read_index(source: IO[bytes]) -> Summary | None:
    """Return the summary at the end of a file, empty if there is none; None: it is damaged."""
    position = source.tell()
    try:
        if not is_closed(source):
            return None
        footer = source.seek(-FOOTER_SIZE, 2)
        opcode, _, start, _, crc = struct.unpack_from("<BQQQI", source.read(FOOTER_SIZE))
        if opcode != Opcode.FOOTER or start > footer:
            return None
        if crc:  # covers the summary, and the footer up to the checksum
            source.seek(start)
            content = source.read(min(footer + HEAD.size + 16 - start, MAX_RECORD_LENGTH))
            if zlib.crc32(content) != crc:
                return None
        source.seek(0)
        return SeekingReader(source, record_size_limit=MAX_RECORD_LENGTH).get_summary() or Summary()
    except (*DAMAGE, OSError, MemoryError):
        return None
    finally:
        source.seek(position)


def add_definitions(source: IO[bytes], known: Summary) -> None:
    """Add all channels and schemas of a file; the first of each number holds."""
    copier = Copier(Salvage(), None, known)
    for record in Scanner(source, {}).records(0):
        parts = [record]
        if record.opcode == Opcode.CHUNK and record.content:
            parts = list(inner_records(copier.content_of(record)[0]))
        for part in parts:
            stream = ReadDataStream(io.BytesIO(part.content))
            if part.opcode not in DEFINITIONS or not is_consistent(part.opcode, part.content):
                continue
            if part.opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                known.schemas.setdefault(schema.id, schema)
            else:
                channel = Channel.read(stream)
                known.channels.setdefault(channel.id, channel)


def inner_records(content: bytes) -> Iterator[Record]:
    """Return the records inside a compressed chunk; the last one may be cut or no record."""
    position = 0
    while position < len(content):
        head = content[position : position + HEAD.size]
        opcode, length = HEAD.unpack(head.ljust(HEAD.size, b"\0"))
        end = position + HEAD.size + length
        is_whole = bool(opcode) and end <= len(content)
        yield Record(opcode, content[position + HEAD.size : end], position, 0, is_whole)
        position = end if is_whole else len(content)


def uncompressed(data: bytes) -> bytes:
    """Return a message of `ros2 bag record --compression-mode message` decompressed.

    Other messages are returned as they are: CDR never begins with the magic number of Zstandard.

    Raises:
        ValueError: It is damaged, or larger than the limit of a message.
    """
    if not data.startswith(ZSTD_MAGIC):
        return data
    content, fault = inflated(data, "zstd")
    if fault:
        raise ValueError(fault)
    return content


class Copier:
    """Writes a complete MCAP file record by record."""

    def __init__(self, result: Salvage, writer: Any, index: Summary) -> None:
        """Prepare an empty file.

        Args:
            result: Receives what is kept and what is lost.
            writer: Writer of the new file.
            index: Summary of the old file: it names the channels that a damaged chunk introduced.
        """
        self.result, self.writer, self.index = result, writer, index
        self.has_started = False
        self.schemas = {0: 0}
        """New number of each schema by its old one."""
        self.channels: dict[int, tuple[int, str]] = {}
        """New number and topic of each channel by its old number."""
        self.count = 0
        self.doubtful_until = 0
        """End of a chunk without compression that contradicts its checksum [bytes]."""
        self.times = {
            each.chunk_start_offset: (each.message_start_time, each.message_end_time)
            for each in index.chunk_indexes
        }
        """First and last log time of each chunk by its position [ns]."""

    def copy_record(self, record: Record) -> None:
        """Copy a record of the top level, or count it as lost."""
        result = self.result
        if record.is_whole and record.opcode not in INSIDE and result.tail_bytes:
            result.tail_bytes = result.from_tail = (
                0  # only the stated length reached beyond the end
            )
            result.damage(0)
        if record.opcode == Opcode.CHUNK and record.content:
            self.copy_compressed(record)
        elif record.opcode == Opcode.CHUNK:
            self.begin_chunk(record)
        elif record.is_whole and record.opcode:
            result.reached_end |= record.opcode == Opcode.DATA_END
            is_doubtful = record.position < self.doubtful_until or not record.is_right
            result.doubtful += self.copy_or_count(record) and is_doubtful
        elif record.is_whole:
            result.damage(record.size)
        else:
            result.tail_bytes = result.tail_bytes or record.size

    def begin_chunk(self, record: Record) -> None:
        """Note whether the records that follow lie in a chunk that is cut or damaged."""
        if not record.is_whole:
            self.result.tail_bytes = record.size
        elif not record.is_right:
            self.result.damage(0)
            self.doubtful_until = record.position + record.size

    def copy_or_count(self, record: Record) -> bool:
        """Copy a whole record, or count it as damaged; return whether it is a copied message."""
        before = self.count
        try:
            self.copy_content(record)
        except DAMAGE:
            self.result.damage(record.size)
        copied = self.count - before
        self.result.from_tail += copied if self.result.tail_bytes else 0
        return bool(copied)

    def copy_compressed(self, record: Record) -> None:
        """Copy the records inside a compressed chunk, up to a cut or a damage."""
        if not record.is_whole:
            self.result.tail_bytes = record.size
        content, fault = self.content_of(record)
        crc = record.chunk.crc if record.chunk else 0
        is_right = bool(record.chunk and not fault and crc in (0, zlib.crc32(content)))
        copied, is_complete = 0, True
        for inner in inner_records(content):
            if not inner.is_whole or not (is_right or self.is_plausible(inner, record.position)):
                is_complete = False
                break
            copied += self.copy_or_count(inner)
        if record.is_whole and not (is_right and is_complete):
            self.result.damage(record.size)
            self.result.doubtful += copied

    def content_of(self, record: Record) -> tuple[bytes, str]:
        """Return the content of a compressed chunk up to a cut or a damage, and the fault."""
        name = record.chunk.compression if record.chunk else ""
        try:
            return inflated(record.content, compression_of(record.content, name))
        except ValueError as error:
            return b"", str(error)

    def is_plausible(self, record: Record, chunk: int) -> bool:
        """Return whether a record decompressed from damaged data can be one.

        Args:
            record: Record inside a chunk.
            chunk: Position of the chunk in the file [bytes].
        """
        if record.opcode != Opcode.MESSAGE:
            return record.opcode in INSIDE and is_consistent(record.opcode, record.content)
        if len(record.content) < MESSAGE.size:
            return False
        channel_id, _, log_time_ns, _ = MESSAGE.unpack_from(record.content)
        first_ns, last_ns = self.times.get(chunk, (0, 2**64))
        channel = self.index.channels.get(channel_id)
        is_cdr = channel is None or channel.message_encoding == "cdr"
        is_message = not is_cdr or len(record.content) == MESSAGE.size
        is_message = is_message or bool(CDR.match(record.content, MESSAGE.size))
        return is_message and first_ns <= log_time_ns <= last_ns

    def copy_content(self, record: Record) -> None:
        """Copy a whole record that contains no others."""
        stream = ReadDataStream(io.BytesIO(record.content))
        if record.opcode == Opcode.HEADER:
            header = Header.read(stream)
            self.start(header.profile, header.library)
            return
        self.start("ros2", "")
        if record.opcode in DEFINITIONS and not is_consistent(record.opcode, record.content):
            raise ValueError("damaged definition")
        if record.opcode == Opcode.MESSAGE:
            self.copy_message(record.content)
        elif record.opcode == Opcode.SCHEMA:
            self.copy_schema(Schema.read(stream))
        elif record.opcode == Opcode.CHANNEL:
            self.copy_channel(Channel.read(stream))
        elif record.opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            self.writer.add_metadata(metadata.name, metadata.metadata)
        elif record.opcode == Opcode.ATTACHMENT:
            (crc,) = struct.unpack("<I", record.content[-4:])
            if crc and zlib.crc32(record.content[:-4]) != crc:
                raise ValueError("damaged attachment")
            item = Attachment.read(stream)
            times = item.create_time, item.log_time
            self.writer.add_attachment(*times, item.name, item.media_type, item.data)

    def copy_message(self, content: bytes) -> None:
        """Copy a message, decompressed, so that the new bag needs no `compression_mode`."""
        channel_id, number, log_time_ns, publish_time_ns = MESSAGE.unpack_from(content)
        if channel_id not in self.channels:
            self.copy_channel_from_index(channel_id)
        channel, topic = self.channels[channel_id]
        data = uncompressed(content[MESSAGE.size :])
        self.writer.add_message(channel, log_time_ns, data, publish_time_ns, number)
        self.count += 1
        self.result.last_ns[topic] = max(self.result.last_ns[topic], log_time_ns)

    def copy_channel_from_index(self, channel_id: int) -> None:
        """Copy a channel from the summary, because the chunk that introduced it is damaged.

        Raises:
            ValueError: The summary does not list it.
        """
        if channel_id not in self.index.channels:
            raise ValueError("a message of an unknown channel")
        self.copy_channel(self.index.channels[channel_id])

    def copy_schema(self, schema: Schema) -> None:
        """Copy a schema, once."""
        if schema.id not in self.schemas:
            schema = self.index.schemas.get(schema.id, schema)
            new_id = self.writer.register_schema(schema.name, schema.encoding, schema.data)
            self.schemas[schema.id] = new_id

    def copy_channel(self, channel: Channel) -> None:
        """Copy a channel, once."""
        if channel.id not in self.channels:
            channel = self.index.channels.get(channel.id, channel)  # protected by a checksum
            if channel.schema_id in self.index.schemas:
                self.copy_schema(self.index.schemas[channel.schema_id])
            schema_id = self.schemas.get(channel.schema_id, 0)
            encoding, metadata = channel.message_encoding, channel.metadata
            new_id = self.writer.register_channel(channel.topic, encoding, schema_id, metadata)
            self.channels[channel.id] = new_id, channel.topic

    def start(self, profile: str, library: str) -> None:
        """Write the header, once."""
        if not self.has_started:
            self.writer.start(profile if profile in BAG_PROFILES else "ros2", library)
        self.has_started = True
