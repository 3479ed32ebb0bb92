"""Positions of a serialised nav_msgs/Path without a Python object for each pose.

In CDR, every pose begins at a multiple of 4 bytes and its numbers at a multiple of 8. Where all
poses have the same frame, the poses after the first one therefore form a table with rows of equal
length, which NumPy reads at once. Every other message is deserialised pose by pose, which takes
about 25 us a pose.

Source: OMG, DDS-XTYPES 1.3, section 7.4 (plain CDR, version 1).
"""

import struct
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.types import NANOSECONDS, Array

LITTLE_ENDIAN = b"\0\1\0\0"
"""Encapsulation header of plain CDR, little endian."""
HEADER = 4
"""Length of the encapsulation header, which does not count for the alignment [bytes]."""
NUMBERS = 56
"""Length of position and orientation [bytes]."""
MAX_POSES = 1_000_000
"""Largest number of poses of a path."""
MAX_PATH_BYTES = 128_000_000
"""Largest size of a serialised path [bytes]."""


class PathPreamble(NamedTuple):
    """What stands before the poses of a serialised path."""

    stamp_ns: int
    frame_id: str
    poses: int
    """Number of poses."""
    offset: int
    """Position of the first pose [bytes]."""


class NotTabular(Exception):
    """The content does not form a table."""


def preamble(data: bytes) -> PathPreamble:
    """Return what stands before the poses.

    Raises:
        NotTabular: The bytes are not plain CDR, little endian.
        ValueError: The message is too large or has too many poses; with value and bound.
    """
    if len(data) > MAX_PATH_BYTES:
        raise ValueError(
            f"reference_path: message of {len(data)} bytes must have at most {MAX_PATH_BYTES}"
        )
    try:
        if data[:HEADER] != LITTLE_ENDIAN:
            raise NotTabular
        seconds, nanoseconds, length = struct.unpack_from("<iII", data, HEADER)
        text = data[HEADER + 12 : HEADER + 12 + length]
        frame_id = text.rstrip(b"\0").decode()
        offset = HEADER + _aligned(12 + length, 4)
        (count,) = struct.unpack_from("<I", data, offset)
    except (struct.error, UnicodeDecodeError) as error:
        raise NotTabular from error
    if count > MAX_POSES:
        raise ValueError(f"reference_path: {count} poses must be at most {MAX_POSES}")
    return PathPreamble(seconds * NANOSECONDS + nanoseconds, frame_id, count, offset + 4)


def positions(data: bytes, start: PathPreamble) -> Array:
    """Return the positions of the poses (n, 2) [m].

    Args:
        data: Serialised message.
        start: Result of `preamble`.

    Raises:
        NotTabular: The poses have several frames, or one that is not that of the path.
        ValueError: A position is not finite.
    """
    points = np.empty((start.poses, 2))
    if not start.poses:
        return points
    table = _layout(data, start)
    text = table.frame[4:].rstrip(b"\0").decode(errors="replace")
    if text not in ("", start.frame_id):
        raise NotTabular
    points[0] = np.frombuffer(data, "<f8", 2, table.first)
    if start.poses > 1:
        rows = _rows(data, start, table, np.uint8)
        at, end = table.row - NUMBERS, 8 + len(table.frame)
        if (rows[:, 8:end] != rows[0, 8:end]).any() or rows[0, 8:end].tobytes() != table.frame:
            raise NotTabular
        points[1:] = np.ascontiguousarray(rows[:, at : at + 16]).view("<f8")
    check_finite(points)
    return points


def has_positions_of(data: bytes, other: bytes) -> bool:
    """Return whether a path has frames and positions of another one, at the same addresses.

    Stamps, orientations and heights may differ. False also where one of them is not a table.
    """
    if len(data) != len(other):
        return False
    try:
        start = preamble(data)
        if preamble(other)[1:] != start[1:] or not start.poses:
            return False
        table = _layout(data, start)
        if _layout(other, start) != table:
            return False
    except (NotTabular, ValueError):
        return False
    if data[table.first : table.first + 16] != other[table.first : table.first + 16]:
        return False
    a, b = _rows(data, start, table, np.uint64), _rows(other, start, table, np.uint64)
    columns = range(1, (table.row - NUMBERS) // 8 + 2)  # without the stamp
    return all(np.array_equal(a[:, column], b[:, column]) for column in columns)


class _Layout(NamedTuple):
    """Layout of poses in rows of equal length."""

    frame: bytes
    """Frame of the first pose, serialised."""
    first: int
    """Address of the numbers of the first pose."""
    row: int
    """Length of the rows of all following poses [bytes]."""


def _layout(data: bytes, start: PathPreamble) -> _Layout:
    """Return the layout of at least one pose.

    Raises:
        NotTabular: The length of the message is not that of a table.
    """
    try:
        (length,) = struct.unpack_from("<I", data, start.offset + 8)
    except struct.error as error:
        raise NotTabular from error
    first = HEADER + _aligned(start.offset - HEADER + 12 + length, 8)
    row = _aligned(12 + length, 8) + NUMBERS
    if not 0 <= len(data) - first - NUMBERS - (start.poses - 1) * row < 8:
        raise NotTabular
    return _Layout(data[start.offset + 8 : start.offset + 12 + length], first, row)


def _rows(data: bytes, start: PathPreamble, table: _Layout, kind: Any) -> Any:
    """Return the poses after the first one as a table of a type that divides 8 bytes."""
    shape = start.poses - 1, table.row // np.dtype(kind).itemsize
    return np.frombuffer(data, kind, shape[0] * shape[1], table.first + NUMBERS).reshape(shape)


def check_finite(points: Array) -> None:
    """Raise a ValueError at the first position that is not finite."""
    bad = np.argwhere(~np.isfinite(points))
    if len(bad):
        i, axis = bad[0]
        where = f"reference_path: poses[{i}].pose.position.{'xy'[axis]}"
        raise ValueError(f"{where} = {points[i, axis]} must be finite")


def _aligned(offset: int, size: int) -> int:
    return -(-offset // size) * size
