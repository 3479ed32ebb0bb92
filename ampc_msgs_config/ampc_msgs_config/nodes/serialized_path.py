"""Positions of a serialised nav_msgs/Path without a Python object for each pose.

In CDR, every pose begins at a multiple of 4 bytes and its numbers at a multiple of 8. Where all
poses have the same frame, the poses after the first one therefore form a table with rows of equal
length, which NumPy reads at once. Every other message is deserialised pose by pose, which takes
about 25 us a pose.

Source: OMG, DDS-XTYPES 1.3, section 7.4 (plain CDR, version 1).
"""

import struct
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.types import NANOSECONDS, Array

LITTLE_ENDIAN = b"\0\1\0\0"
"""Encapsulation header of plain CDR, little endian."""
HEADER = 4
"""Length of the encapsulation header, which does not count for the alignment [bytes]."""
NUMBERS = 56
"""Length of position and orientation [bytes]."""
MAX_POSES = 500_000
"""Largest number of poses of a path."""
MAX_PATH_BYTES = 64_000_000
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
    """The poses do not form a table."""


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
    try:
        (length,) = struct.unpack_from("<I", data, start.offset + 8)
    except struct.error as error:
        raise NotTabular from error
    text = data[start.offset + 12 : start.offset + 12 + length]
    first = HEADER + _aligned(start.offset - HEADER + 12 + length, 8)  # its numbers
    table, row = first + NUMBERS, _aligned(12 + length, 8) + NUMBERS
    fits = 0 <= len(data) - table - (start.poses - 1) * row < 8
    if text.rstrip(b"\0").decode(errors="replace") not in ("", start.frame_id) or not fits:
        raise NotTabular
    points[0] = np.frombuffer(data, "<f8", 2, first)
    if start.poses > 1:
        shape = (start.poses - 1, row)
        rows = np.frombuffer(data, np.uint8, shape[0] * row, table).reshape(shape)
        if (rows[:, 8 : 12 + length] != rows[0, 8 : 12 + length]).any():
            raise NotTabular
        if rows[0, 8 : 12 + length].tobytes() != data[start.offset + 8 :][: 4 + length]:
            raise NotTabular
        at = row - NUMBERS
        points[1:] = np.ascontiguousarray(rows[:, at : at + 16]).view("<f8")
    check_finite(points)
    return points


def check_finite(points: Array) -> None:
    """Raise a ValueError at the first position that is not finite."""
    bad = np.argwhere(~np.isfinite(points))
    if len(bad):
        i, axis = bad[0]
        where = f"reference_path: poses[{i}].pose.position.{'xy'[axis]}"
        raise ValueError(f"{where} = {points[i, axis]} must be finite")


def _aligned(offset: int, size: int) -> int:
    return -(-offset // size) * size
