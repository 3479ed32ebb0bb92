"""Copies what is whole in an MCAP file that ends early, or is damaged, into a complete one.

Nothing is invented: schemas, channels with their metadata, attachments, metadata records, and
messages with their times and sequence numbers are those of the file. Of the last chunk, where the
file ends inside it, the messages before its end are taken, compressed or not.
"""

import io
import struct
import zlib
from dataclasses import dataclass, field
from typing import IO, Any

import yaml
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.summary import Summary
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from ampc_msgs_config.recording.bag_metadata import Extent, Topic
from launch_scripts.bags.mcap_records import DAMAGE, MAGIC, MESSAGE, Record, decompressed, records


@dataclass
class Salvage:
    """What was found in a file."""

    extent: Extent = field(default_factory=Extent)
    topics: dict[str, Topic] = field(default_factory=dict)
    attachments: int = 0
    metadata_records: int = 0
    reached_end: bool = False
    """Whether all that the writer recorded is there, up to its end mark."""
    tail_bytes: int = 0
    """Length of the last record, which is cut; of a chunk, what was whole in it is kept."""
    from_tail: int = 0
    """Number of messages kept out of a cut chunk."""
    damaged: int = 0
    """Number of damaged records and chunks before the end, of which nothing is certain."""
    damaged_bytes: int = 0
    """Their length."""

    @property
    def is_undamaged(self) -> bool:
        """Whether nothing was lost."""
        return self.reached_end and not self.damaged


def salvage(source: IO[bytes], target: IO[bytes], *, compress: bool = True) -> Salvage:
    """Copy what is whole.

    Args:
        source: An MCAP file, at its beginning.
        target: Becomes a complete MCAP file.
        compress: Whether the chunks of the target are compressed.

    Raises:
        ValueError: The source does not begin as MCAP files do.
    """
    if source.read(len(MAGIC)) != MAGIC:
        raise ValueError("the file does not begin as MCAP files do")
    index = read_index(source)
    copy = Copy(target, CompressionType.ZSTD if compress else CompressionType.NONE, index)
    for record in records(source):
        if record.kind == Opcode.DATA_END and record.is_whole:
            copy.found.reached_end = True
            break
        copy.take(record)
    copy.finish()
    return copy.found


def read_index(source: IO[bytes]) -> Summary:
    """Give the index at the end of a file, an empty one where it is missing or damaged."""
    start = source.tell()
    try:
        source.seek(0)
        return make_reader(source).get_summary() or Summary()
    except (*DAMAGE, OSError):
        return Summary()
    finally:
        source.seek(start)


class Copy:
    """A complete MCAP file that grows record by record."""

    def __init__(self, target: IO[bytes], compression: CompressionType, index: Summary) -> None:
        """Begin with nothing.

        Args:
            target: The new file.
            compression: Of its chunks.
            index: Of the old file, for what a damaged chunk said about messages behind it.
        """
        self.found, self.index = Salvage(), index
        self.writer: Any = Writer(target, compression=compression)
        self.started = False
        self.schemas: dict[int, tuple[int, str]] = {}
        self.channels: dict[int, tuple[int, Topic]] = {}

    def take(self, record: Record) -> None:
        """Copy a record at the top of the file, or count it as lost."""
        if not record.is_whole:
            self.found.tail_bytes = record.size
        try:
            if record.kind == Opcode.CHUNK:
                self.take_chunk(record)
            elif record.is_whole:
                self.take_inner(record)
        except DAMAGE:
            self.found.damaged += record.is_whole
            self.found.damaged_bytes += record.size * record.is_whole

    def take_chunk(self, record: Record) -> None:
        """Copy the content of a chunk; of one that is cut, what is whole."""
        chunk = Chunk.read(ReadDataStream(io.BytesIO(record.content)))
        content = decompressed(chunk)
        crc = chunk.uncompressed_crc
        if record.is_whole and crc and zlib.crc32(content) != crc:
            raise ValueError("damaged")
        before = self.found.extent.count
        for inner in records(io.BytesIO(content)):
            if inner.is_whole:
                self.take_inner(inner)
            elif record.is_whole:
                raise ValueError("damaged")
            self.found.from_tail = (self.found.extent.count - before) * (not record.is_whole)

    def take_inner(self, record: Record) -> None:
        """Copy a whole record that holds no others."""
        if record.kind != Opcode.HEADER:
            self.start("ros2", "")
        if record.kind == Opcode.MESSAGE:
            self.take_message(record.content)
            return
        stream = ReadDataStream(io.BytesIO(record.content))
        if record.kind == Opcode.HEADER:
            header = Header.read(stream)
            self.start(header.profile, header.library)
        elif record.kind == Opcode.SCHEMA:
            self.take_schema(Schema.read(stream))
        elif record.kind == Opcode.CHANNEL:
            self.take_channel(Channel.read(stream))
        elif record.kind == Opcode.METADATA:
            metadata = Metadata.read(stream)
            self.writer.add_metadata(metadata.name, metadata.metadata)
            self.found.metadata_records += 1
        elif record.kind == Opcode.ATTACHMENT:
            self.take_attachment(record.content)

    def take_message(self, content: bytes) -> None:
        """Copy a message."""
        channel_id, number, log_time_ns, publish_time_ns = MESSAGE.unpack_from(content)
        if channel_id not in self.channels:
            self.take_from_index(channel_id)
        channel, topic = self.channels[channel_id]
        data = content[MESSAGE.size :]
        self.writer.add_message(channel, log_time_ns, data, publish_time_ns, number)
        self.found.extent.add(log_time_ns)
        topic.extent.add(log_time_ns)

    def take_from_index(self, channel_id: int) -> None:
        """Copy a channel that a damaged chunk has announced, from the index.

        Raises:
            ValueError: The index does not know it either.
        """
        if channel_id not in self.index.channels:
            raise ValueError("a message of an unknown channel")
        channel = self.index.channels[channel_id]
        if channel.schema_id in self.index.schemas:
            self.take_schema(self.index.schemas[channel.schema_id])
        self.take_channel(channel)

    def take_schema(self, schema: Schema) -> None:
        """Copy a schema, once."""
        if schema.id not in self.schemas:
            new = self.writer.register_schema(schema.name, schema.encoding, schema.data)
            self.schemas[schema.id] = new, schema.name

    def take_channel(self, channel: Channel) -> None:
        """Copy a channel, once."""
        if channel.id in self.channels:
            return
        schema, type_name = self.schemas.get(channel.schema_id, (0, ""))
        encoding, metadata = channel.message_encoding, channel.metadata
        new = self.writer.register_channel(channel.topic, encoding, schema, metadata)
        offers = offered_qos(metadata.get("offered_qos_profiles", ""))
        type_hash = metadata.get("topic_type_hash", "")
        topic = Topic(channel.topic, type_name, offers, type_hash, encoding)
        self.channels[channel.id] = new, self.found.topics.setdefault(channel.topic, topic)

    def take_attachment(self, content: bytes) -> None:
        """Copy an attachment."""
        (crc,) = struct.unpack("<I", content[-4:])
        if crc and zlib.crc32(content[:-4]) != crc:
            raise ValueError("damaged")
        item = Attachment.read(ReadDataStream(io.BytesIO(content)))
        times = item.create_time, item.log_time
        self.writer.add_attachment(*times, item.name, item.media_type, item.data)
        self.found.attachments += 1

    def start(self, profile: str, library: str) -> None:
        """Write the head, once; where that of the source is lost, one of ROS 2."""
        if not self.started:
            self.writer.start(profile, library)
        self.started = True

    def finish(self) -> None:
        """Write the index."""
        self.start("ros2", "")
        self.writer.finish()


def offered_qos(text: str) -> list[dict[str, Any]]:
    """Give qualities of service, of any version of rosbag2, in the words of version 9."""
    try:
        return [dict(qos) for qos in dump_qos_v9(parse_qos(text))]
    except (ReaderError, KeyError, TypeError, yaml.YAMLError):
        return []
