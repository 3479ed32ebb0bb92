"""Copy all undamaged records of an MCAP file that is cut or damaged into a complete file.

Schemas, channels with their metadata, attachments, metadata records, and messages with their times
and sequence numbers stay as they are in the file. If the file ends inside a chunk, the messages
before that point are kept, compressed or not.

Own code, because the readers of `mcap` and `rosbags` stop at the first damaged record.
"""

import io
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO, Any, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.summary import Summary
from mcap.writer import CompressionType, Writer

MAGIC = b"\x89MCAP0\r\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
HEAD = struct.Struct("<BQ")
"""Start of a record: its opcode and the length of its content [bytes]."""
MESSAGE = struct.Struct("<HIQQ")
"""Start of a message: channel, sequence number, log time and publish time [ns]."""
MAX_RECORD_LENGTH = 2**32
"""Longest content of a record [bytes]; a longer one is taken for damage."""
DAMAGE = (
    *(McapError, struct.error, zstandard.ZstdError),
    *(ValueError, OverflowError, RuntimeError, EOFError),
)
"""Errors that the libraries raise on damaged bytes."""


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
    tail_bytes: int = 0
    """Length of the last record if it is cut [bytes]."""
    from_tail: int = 0
    """Number of messages kept from a chunk that is cut."""
    damaged: int = 0
    """Number of damaged records and chunks before the end; they are left out."""
    damaged_bytes: int = 0
    """Length of the damaged records and chunks [bytes]."""

    @property
    def is_undamaged(self) -> bool:
        """Whether nothing was lost, and nothing is missing but perhaps `metadata.yaml`."""
        return self.was_closed and self.reached_end and not self.damaged


class Record(NamedTuple):
    """One record of an MCAP file, not interpreted yet."""

    opcode: int
    content: bytes
    size: int
    """Length in the file, with opcode and length field [bytes]."""
    is_whole: bool
    """Whether the file contains all of it."""


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
    if source.read(len(MAGIC)) != MAGIC:
        raise ValueError("the file does not begin as MCAP files do")
    compression = CompressionType.ZSTD if compress else CompressionType.NONE
    copier = Copier(result, Writer(target, compression=compression), read_index(source))
    for record in records(source):
        if record.opcode == Opcode.DATA_END and record.is_whole:
            result.reached_end = True
            break
        copier.copy_record(record)
    copier.start("ros2", "")
    copier.writer.finish()
    result.index = read_index(target)
    return result


def is_closed(stream: IO[bytes]) -> bool:
    """Return whether an MCAP file ends with the magic number; leave the stream at its start."""
    size = stream.seek(0, 2)
    stream.seek(max(0, size - len(MAGIC)))
    has_magic = stream.read() == MAGIC
    stream.seek(0)
    return size > len(MAGIC) and has_magic


def records(stream: IO[bytes]) -> Iterator[Record]:
    """Return the records from the current position on; the last one may be cut or no record."""
    while head := stream.read(HEAD.size):
        opcode, length = HEAD.unpack(head.ljust(HEAD.size, b"\0"))
        is_record = len(head) == HEAD.size and opcode and length <= MAX_RECORD_LENGTH
        content = stream.read(length if is_record else -1)
        is_whole = bool(is_record) and len(content) == length
        yield Record(opcode, content, len(head) + len(content), is_whole)


def read_index(source: IO[bytes]) -> Summary:
    """Return the summary at the end of a file, an empty one if it is missing or damaged."""
    position = source.tell()
    try:
        source.seek(0)
        return make_reader(source).get_summary() or Summary()
    except (*DAMAGE, OSError):
        return Summary()
    finally:
        source.seek(position)


def decompress_chunk(chunk: Chunk) -> bytes:
    """Return the content of a chunk; of one that is cut, all that can be decompressed."""
    if chunk.compression == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
    if chunk.compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data))
    if chunk.compression:
        raise ValueError(f"unknown compression {chunk.compression!r}")
    return chunk.data


def uncompressed(data: bytes) -> bytes:
    """Return a message of `ros2 bag record --compression-mode message` decompressed.

    Other messages are returned as they are: CDR never begins with the magic number of Zstandard.
    """
    if data.startswith(ZSTD_MAGIC):
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    return data


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

    def copy_record(self, record: Record) -> None:
        """Copy a record of the top level, or count it as lost."""
        if not record.is_whole:
            self.result.tail_bytes = record.size
        try:
            if record.opcode == Opcode.CHUNK:
                self.copy_chunk(record)
            elif record.is_whole:
                self.copy_content(record)
        except DAMAGE:
            if record.is_whole:
                self.result.damaged += 1
                self.result.damaged_bytes += record.size

    def copy_chunk(self, record: Record) -> None:
        """Copy the records inside a chunk; of a chunk that is cut, those before the cut."""
        chunk = Chunk.read(ReadDataStream(io.BytesIO(record.content)))
        content = decompress_chunk(chunk)
        crc = chunk.uncompressed_crc
        if record.is_whole and crc and zlib.crc32(content) != crc:
            raise ValueError("damaged chunk")
        count_before = self.count
        for inner in records(io.BytesIO(content)):
            if inner.is_whole:
                self.copy_content(inner)
            elif record.is_whole:
                raise ValueError("damaged chunk")
            if not record.is_whole:
                self.result.from_tail = self.count - count_before

    def copy_content(self, record: Record) -> None:
        """Copy a whole record that contains no others."""
        stream = ReadDataStream(io.BytesIO(record.content))
        if record.opcode == Opcode.HEADER:
            header = Header.read(stream)
            self.start(header.profile, header.library)
            return
        self.start("ros2", "")
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
        channel = self.index.channels[channel_id]
        if channel.schema_id in self.index.schemas:
            self.copy_schema(self.index.schemas[channel.schema_id])
        self.copy_channel(channel)

    def copy_schema(self, schema: Schema) -> None:
        """Copy a schema, once."""
        if schema.id not in self.schemas:
            new_id = self.writer.register_schema(schema.name, schema.encoding, schema.data)
            self.schemas[schema.id] = new_id

    def copy_channel(self, channel: Channel) -> None:
        """Copy a channel, once."""
        if channel.id not in self.channels:
            schema_id = self.schemas.get(channel.schema_id, 0)
            encoding, metadata = channel.message_encoding, channel.metadata
            new_id = self.writer.register_channel(channel.topic, encoding, schema_id, metadata)
            self.channels[channel.id] = new_id, channel.topic

    def start(self, profile: str, library: str) -> None:
        """Write the header, once."""
        if not self.has_started:
            self.writer.start(profile, library)
        self.has_started = True
