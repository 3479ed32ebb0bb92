"""Find the records of MCAP data that are cut or damaged, and continue after each damage.

A record is taken as it stands if another one can begin behind it. Behind a damage, every byte is
tried as the start of a record or of compressed data. Such a start is accepted by its content:
lengths that fit exactly, known channels, CDR. A chunk without compression is a short record that
is followed by the records inside it, so a damaged chunk head costs nothing but its checksum.
"""

import io
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import IO, Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from launch_scripts.bags.inflate import LZ4_MAGIC, ZSTD_MAGIC, Inflation, inflate

FRAMES = ZSTD_MAGIC, LZ4_MAGIC
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Start of a record: its opcode and the length of its content [bytes]."""
MESSAGE = struct.Struct("<HIQQ")
"""Start of a message: channel, sequence number, log time and publish time [ns]."""
CHUNK_HEAD = struct.Struct("<QQQII")
"""Start of a chunk: times [ns], uncompressed size, checksum, length of the compression's name."""
MAX_RECORD_LENGTH = 2**30
"""Longest content of a record [bytes]; a longer one is taken for damage."""
LENGTHS: dict[int, tuple[int, int]] = {
    Opcode.HEADER: (8, 2**20),
    Opcode.FOOTER: (20, 20),
    Opcode.SCHEMA: (14, 2**26),
    Opcode.CHANNEL: (16, 2**26),
    Opcode.MESSAGE: (MESSAGE.size, MAX_RECORD_LENGTH),
    Opcode.CHUNK: (CHUNK_HEAD.size + 8, MAX_RECORD_LENGTH),
    Opcode.MESSAGE_INDEX: (6, 2**30),
    Opcode.CHUNK_INDEX: (64, 2**26),
    Opcode.ATTACHMENT: (36, MAX_RECORD_LENGTH),
    Opcode.ATTACHMENT_INDEX: (48, 2**20),
    Opcode.STATISTICS: (46, 2**20),
    Opcode.METADATA: (8, 2**26),
    Opcode.METADATA_INDEX: (20, 2**20),
    Opcode.SUMMARY_OFFSET: (17, 17),
    Opcode.DATA_END: (4, 4),
}
"""Shortest and longest content of each kind of record [bytes]."""
PARSERS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
}
STARTS = re.compile(
    rb"[\x01-\x0f](?=.{4}\0{4})|%b|%b" % (re.escape(ZSTD_MAGIC), re.escape(LZ4_MAGIC)), re.DOTALL
)
"""Bytes with which a record or compressed data may begin."""
NEVER_EMPTY = ("offset", "chunk_length", "name", "topic")
"""Fields that are neither 0 nor empty; zeros inside a message look like other records."""
READ_WINDOW = 2**20
"""Bytes that are searched at a time."""
CDR = re.compile(rb"\0[\1\3\5\7\x09\x0b]\0[\0-\3]|" + re.escape(ZSTD_MAGIC), re.DOTALL)
"""Start of a message: encapsulation of CDR, little endian, or Zstandard."""
PARSE_ERRORS = (McapError, struct.error, ValueError, OverflowError, MemoryError)


class ChunkHead(NamedTuple):
    """Start of a chunk."""

    crc: int
    """Checksum of its uncompressed content; 0: none."""
    compression: str
    size: int
    """Length of this start [bytes]."""


class Record(NamedTuple):
    """One record of an MCAP file, not interpreted yet, or a damaged range."""

    opcode: int
    """0: damaged range."""
    content: bytes
    """Content of the record; of a chunk its compressed data, of one without compression nothing,
    because the records inside it follow."""
    position: int
    """Position in the file [bytes]."""
    size: int
    """Length in the file, with opcode and length field [bytes]."""
    is_whole: bool
    """Whether the file contains all of it."""
    is_right: bool = True
    """False: a damage follows, or a chunk without compression contradicts its checksum."""
    chunk: ChunkHead | None = None
    """Of a chunk: its start; None if that is damaged."""


class Scanner:
    """Finds the records of a file."""

    def __init__(self, stream: IO[bytes], channels: Mapping[int, str]) -> None:
        """Prepare a scan.

        Args:
            stream: MCAP data.
            channels: Encoding of each known channel by its number; may grow during the scan.
        """
        self.stream, self.channels = stream, channels
        self.size = stream.seek(0, 2)

    def read(self, position: int, size: int) -> bytes:
        """Read bytes at a position; fewer at the end of the file."""
        self.stream.seek(position)
        return self.stream.read(min(size, max(self.size - position, 0)))

    def records(self, position: int) -> Iterator[Record]:
        """Return all records from a position on, and the damaged ranges between them."""
        checked_until = 0
        while position < self.size:
            if self.read(position, len(MAGIC)) == MAGIC:
                position += len(MAGIC)
                continue
            record = self.record_at(position, is_checked=position < checked_until)
            if record is None:
                found = self.find(position + 1, self.size)
                end = self.size if found is None else found
                record = Record(0, b"", position, end - position, found is not None)
            yield record
            position += record.size
            if record.opcode == Opcode.CHUNK and record.chunk and not record.content:
                if record.is_right and record.is_whole and record.chunk.crc:
                    checked_until = position
                position = record.position + HEAD.size + record.chunk.size

    def record_at(self, position: int, *, is_checked: bool) -> Record | None:
        """Return the record at a position, or None if none can be trusted to stand there.

        Args:
            position: Position in the file [bytes].
            is_checked: Whether a checksum has shown that these bytes are undamaged.
        """
        if self.read(position, 4) in FRAMES and self.is_frame(position):
            return self.frame_at(position)
        head = self.head_at(position)
        if head is None:
            return None
        opcode, length = head
        start, end = position + HEAD.size, position + HEAD.size + length
        if opcode == Opcode.CHUNK:
            chunk = self.chunk_head(start, length)
            return chunk and self.chunk_at(position, end, chunk)
        if end > self.size:
            if self.find(position + 1, self.size) is not None:
                return None  # its length is damaged
            content = self.read(start, length)
            return Record(opcode, content, position, self.size - position, is_whole=False)
        if not is_checked and not self.ends_well(opcode, start, end):
            return None
        is_right = is_checked or self.can_continue(end)
        return Record(opcode, self.read(start, length), position, end - position, True, is_right)

    def ends_well(self, opcode: int, start: int, end: int) -> bool:
        """Return whether no other record begins inside a record whose length may be damaged.

        Note:
            Where messages have a length of 2^n, a wrong bit can make one as long as several.
        """
        if not self.can_continue(end):
            return self.find(start + 1, end) is None
        if opcode != Opcode.MESSAGE:
            return True
        return self.find(start + 1, end, is_inside=True) is None

    def can_continue(self, position: int) -> bool:
        """Return whether a record can begin at a position, or the file ends there."""
        if position == self.size or self.read(position, len(MAGIC)) == MAGIC:
            return True
        head = self.head_at(position)
        return head is not None and position + HEAD.size + head[1] <= self.size

    def head_at(self, position: int) -> tuple[int, int] | None:
        """Return opcode and length of a record that can begin at a position."""
        head = self.read(position, HEAD.size)
        if len(head) < HEAD.size:
            return None
        opcode, length = HEAD.unpack(head)
        shortest, longest = LENGTHS.get(opcode, (0, MAX_RECORD_LENGTH if opcode >= 0x80 else -1))
        return (opcode, length) if shortest <= length <= longest else None

    def chunk_head(self, start: int, length: int) -> ChunkHead | None:
        """Return the start of a chunk whose content begins at `start`, if its lengths agree."""
        content = self.read(start, CHUNK_HEAD.size + 40)
        if len(content) < CHUNK_HEAD.size:
            return None
        _, _, _, crc, name_length = CHUNK_HEAD.unpack_from(content)
        size = CHUNK_HEAD.size + name_length + 8
        if name_length > 32 or len(content) < size:
            return None
        (data_length,) = struct.unpack_from("<Q", content, size - 8)
        name = content[CHUNK_HEAD.size : size - 8].decode("ascii", "replace")
        return ChunkHead(crc, name, size) if size + data_length == length else None

    def chunk_at(self, position: int, end: int, chunk: ChunkHead) -> Record:
        """Return a chunk whose start is undamaged."""
        data = position + HEAD.size + chunk.size
        if not chunk.compression and self.read(data, 4) not in FRAMES:
            is_whole = end <= self.size
            end = min(end, self.size)
            is_right = not chunk.crc or not is_whole or self.crc(data, end) == chunk.crc
            return Record(Opcode.CHUNK, b"", position, end - position, is_whole, is_right, chunk)
        is_whole = end <= self.size
        is_shifted = self.read(data, 4) not in FRAMES  # by bytes inserted in its start
        if is_shifted or not (is_whole and self.can_continue(end)):
            found = self.find(data + 1, min(end, self.size))
            if found is not None:
                is_whole, end = True, found  # bytes inside it were removed, or its length is wrong
        content = self.read(data, end - data)
        return Record(
            Opcode.CHUNK, content, position, min(end, self.size) - position, is_whole, True, chunk
        )

    def frame_at(self, position: int) -> Record:
        """Return compressed records whose chunk has lost its start."""
        found = self.find(position + 1, self.size)
        end = self.size if found is None else found
        content = self.read(position, min(end - position, MAX_RECORD_LENGTH))
        return Record(Opcode.CHUNK, content, position, end - position, found is not None)

    def is_frame(self, position: int) -> bool:
        """Return whether compressed data at a position begin with a record."""
        compression = compression_of(self.read(position, 4))
        self.stream.seek(position)
        pieces = inflate(self.stream, compression, READ_WINDOW, Inflation())
        content = next(filter(None, pieces), b"")
        return Scanner(io.BytesIO(content), self.channels).head_at(0) is not None

    def crc(self, start: int, end: int) -> int:
        """Return the checksum of a range."""
        value = 0
        for place in range(start, end, READ_WINDOW):
            value = zlib.crc32(self.read(place, min(READ_WINDOW, end - place)), value)
        return value

    def find(self, start: int, end: int, *, is_inside: bool = False) -> int | None:
        """Return the first position of a range at which undamaged data begin, if there is one.

        Args:
            start: Begin of the range [bytes].
            end: End of the range [bytes].
            is_inside: Only messages that end inside the range, too.
        """
        for begin in range(start, end, READ_WINDOW):
            window = self.read(begin, READ_WINDOW + HEAD.size)
            for match in STARTS.finditer(window):
                position = begin + match.start()
                if match.start() >= READ_WINDOW or position >= end:
                    break
                if is_inside and not self.is_message_inside(position, end):
                    continue
                if self.begins_at(position):
                    return position
        return None

    def is_message_inside(self, position: int, end: int) -> bool:
        """Return whether the head of a message is at a position, which ends before `end`."""
        head = self.head_at(position)
        return bool(head and head[0] == Opcode.MESSAGE and position + HEAD.size + head[1] <= end)

    def begins_at(self, position: int) -> bool:
        """Return whether the content at a position shows that undamaged data begin there."""
        if self.read(position, 4) in FRAMES:
            return self.is_frame(position)
        head = self.head_at(position)
        if head is None:
            return False
        opcode, length = head
        start, end = position + HEAD.size, position + HEAD.size + length
        if opcode == Opcode.CHUNK:
            return self.chunk_head(start, length) is not None
        if end > self.size:
            return False
        if opcode == Opcode.MESSAGE:
            content = self.read(start, MESSAGE.size + 4)
            channel_id, *_ = MESSAGE.unpack_from(content)
            if self.channels.get(channel_id) == "cdr" and CDR.match(content, MESSAGE.size):
                return True
            return channel_id in self.channels and self.can_continue(end)
        if opcode == Opcode.HEADER and position != len(MAGIC):
            return False  # two empty texts are too little to recognise one
        return is_consistent(opcode, self.read(start, length))


def is_consistent(opcode: int, content: bytes) -> bool:
    """Return whether all lengths inside a record agree with its length, and it is not empty."""
    if opcode == Opcode.MESSAGE_INDEX:
        (size,) = struct.unpack_from("<I", content, 2)
        return bool(0 < size == len(content) - 6 and size % 16 == 0)
    if opcode not in PARSERS:  # length fixed, and checked before
        return opcode in LENGTHS
    stream = ReadDataStream(io.BytesIO(content))
    try:
        parsed = PARSERS[opcode].read(stream)
    except PARSE_ERRORS:
        return False
    is_filled = all(getattr(parsed, name, True) for name in NEVER_EMPTY)
    return is_filled and bool(stream.count == len(content))


def compression_of(data: bytes, name: str = "") -> str:
    """Return the compression of data by their first bytes, otherwise the name that a chunk has."""
    if data.startswith(ZSTD_MAGIC):
        return "zstd"
    return "lz4" if data.startswith(LZ4_MAGIC) else name
