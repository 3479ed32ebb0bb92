"""Decompress zstd and lz4 within stated limits, as far as the data are undamaged."""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, Any

import lz4.frame
import zstandard

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
LZ4_MAGIC = b"\x04\x22\x4d\x18"
MAX_CONTENT = 256 * 2**20
"""Largest decompressed content of a chunk or a message [bytes]."""
MAX_RATIO = 1000
"""Largest ratio of decompressed to compressed size of a file that is compressed as a whole."""
PIECE = 1024
"""Compressed bytes that are decompressed in one step: 4 bytes can stand for 128 kB [bytes]."""
ERRORS = (zstandard.ZstdError, RuntimeError, ValueError, EOFError)
"""Errors that the libraries raise on damaged data."""


@dataclass
class Inflation:
    """State of a decompression."""

    frames: int = 0
    """Number of complete frames."""
    fault: str = ""
    """Why it ended before the end of the data; empty: all frames are complete."""

    def end(self, reason: str) -> None:
        """State why the current frame is not complete."""
        self.fault = f"{reason} in compressed frame {self.frames + 1}"


def decompressor(compression: str) -> Any:
    """Return a decompressor of one frame.

    Raises:
        ValueError: The compression is unknown.
    """
    if compression == "zstd":
        return zstandard.ZstdDecompressor().decompressobj()
    if compression == "lz4":
        return lz4.frame.LZ4FrameDecompressor()
    raise ValueError(f"unknown compression {compression!r}")


def inflate(source: IO[bytes], compression: str, limit: int, state: Inflation) -> Iterator[bytes]:
    """Decompress one or several frames, up to the end, the first damage or the limit.

    Args:
        source: Compressed data from its position on; seekable.
        compression: "zstd" or "lz4".
        limit: Most bytes of decompressed data.
        state: Receives how it ended.
    """
    frame, begin, size = decompressor(compression), source.tell(), 0
    while piece := source.read(PIECE):
        end = source.tell()
        try:
            content = frame.decompress(piece)
        except ERRORS:
            state.end("damage")
            yield from before_damage(source, compression, begin, end - len(piece))
            return
        size += len(content)
        if size > limit:
            yield content[: limit - size]
            state.end(f"more than the limit of {limit} bytes")
            return
        yield content
        if frame.eof:
            state.frames += 1
            begin = source.seek(end - len(frame.unused_data or b""))
            frame = decompressor(compression)
    if source.tell() > begin:
        state.end("cut off")


def before_damage(source: IO[bytes], compression: str, begin: int, last: int) -> Iterator[bytes]:
    """Decompress the piece at `last` byte by byte, in the frame at `begin`, up to its damage."""
    frame = decompressor(compression)
    source.seek(begin)
    while rest := last - source.tell():
        frame.decompress(source.read(min(PIECE, rest)))
    try:
        while byte := source.read(1):
            yield frame.decompress(byte)
    except ERRORS:
        return


def inflated(data: bytes, compression: str, limit: int = MAX_CONTENT) -> tuple[bytes, str]:
    """Return data decompressed up to the first damage, and the fault (empty: all is complete)."""
    state = Inflation()
    return b"".join(inflate(io.BytesIO(data), compression, limit, state)), state.fault
