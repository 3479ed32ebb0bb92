"""The records of an MCAP file, one by one, as far as they go."""

import struct
from collections.abc import Iterator
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.records import Chunk

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Of a record: its kind, and the length of what follows [bytes]."""
MESSAGE = struct.Struct("<HIQQ")
"""Of a message: channel, sequence number, log time and publish time [ns]."""
LARGEST = 2**32
"""No record is longer: a length beyond it is damage [bytes]."""
DAMAGE = (
    McapError,
    struct.error,
    ValueError,
    OverflowError,
    zstandard.ZstdError,
    RuntimeError,
    EOFError,
)
"""What the libraries raise on bytes that are not what they should be."""


class Record(NamedTuple):
    """One record, not yet understood."""

    kind: int
    content: bytes
    size: int
    """Of the record in the file [bytes]."""
    is_whole: bool
    """Whether the file goes on to its end."""


def records(stream: IO[bytes]) -> Iterator[Record]:
    """Give the records from here on; the last one may be cut, or be no record at all."""
    while head := stream.read(HEAD.size):
        kind, length = HEAD.unpack(head.ljust(HEAD.size, b"\0"))
        is_record = len(head) == HEAD.size and kind and length <= LARGEST
        content = stream.read(length if is_record else -1)
        is_whole = bool(is_record) and len(content) == length
        yield Record(kind, content, len(head) + len(content), is_whole)


def decompressed(chunk: Chunk) -> bytes:
    """Give the content of a chunk, of one that is cut, what of it can be decompressed."""
    if chunk.compression == "zstd":
        return zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
    if chunk.compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data))
    if chunk.compression:
        raise ValueError(f"its chunks are compressed with {chunk.compression!r}")
    return chunk.data
