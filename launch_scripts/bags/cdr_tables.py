"""Numbers of many serialised messages of one type, without a Python object for each message.

Messages of one type and length, with the same texts and the same sizes of their lists, have their
numbers at the same addresses: they form a table, which NumPy reads at once.

Source: OMG, DDS-XTYPES 1.3, section 7.4 (plain CDR, version 1).
"""

import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.nodes.serialized_path import LITTLE_ENDIAN, NotTabular
from ampc_msgs_config.types import NANOSECONDS, Array

NUMBER = 8
"""Length of a number [bytes]."""
MOST_BYTES = 100_000
"""Length beyond which messages are not read as a table [bytes]."""


class Layout(NamedTuple):
    """Places in all messages of a table."""

    has_stamp: bool
    """Whether the messages begin with a header."""
    numbers: tuple[int, ...]
    """Addresses of the numbers."""
    fixed: NDArray[np.int64]
    """Addresses of the bytes that are equal in all messages; those between them have any value."""


class TableContent(NamedTuple):
    """Content of messages; where a message does not belong to the table, it is meaningless."""

    stamps: NDArray[np.int64]
    """(n,) [ns]; 0 without a header."""
    values: Array
    """(n, k)."""
    belongs: NDArray[np.bool_]
    """(n,)."""


class Cursor:
    """Place in a serialised message."""

    def __init__(self, data: bytes) -> None:
        """Begin behind the encapsulation header, which does not count for the alignment."""
        self.data, self.at = data, len(LITTLE_ENDIAN)
        self.fixed = list(range(self.at))

    def skip(self, size: int, count: int = 1) -> range:
        """Pass some values of a size [bytes], and return their addresses."""
        start = len(LITTLE_ENDIAN)
        first = start + -(-(self.at - start) // size) * size if count else self.at
        self.at = first + size * count
        if self.at > len(self.data):
            raise NotTabular
        return range(first, self.at, size)

    def length(self) -> int:
        """Pass the length of a text or list, and return it."""
        (first,) = self.skip(4)
        self.fixed += range(first, self.at)
        (length,) = struct.unpack_from("<I", self.data, first)
        return int(length)

    def text(self) -> None:
        """Pass a text."""
        self.fixed += self.skip(1, self.length())

    def header(self) -> None:
        """Pass a std_msgs/Header."""
        self.skip(4, 2)
        self.text()

    def layout(self, numbers: Sequence[int], *, has_stamp: bool = True) -> Layout:
        """Return the layout of the message, with the addresses of its numbers.

        Raises:
            NotTabular: There is no number.
        """
        if not numbers:
            raise NotTabular
        return Layout(has_stamp, tuple(numbers), np.array(self.fixed))


def _header_and(*numbers: int, count: int, texts: int = 0) -> Callable[[Cursor], Layout]:
    """Return a function that finds some of `count` numbers behind a header and texts."""

    def find(cursor: Cursor) -> Layout:
        cursor.header()
        for _ in range(texts):
            cursor.text()
        places = cursor.skip(NUMBER, count)
        return cursor.layout([places[number] for number in numbers])

    return find


def _joint_state(cursor: Cursor) -> Layout:
    """Find the positions; the lengths of the other lists are fixed, too."""
    cursor.header()
    for _ in range(cursor.length()):
        cursor.text()
    positions, _, _ = (cursor.skip(NUMBER, cursor.length()) for _ in range(3))
    return cursor.layout(positions)


LAYOUTS: dict[str, Callable[[Cursor], Layout]] = {
    # position x y z, orientation x y z w, 36 covariances; linear and angular x y z, 36 covariances
    "nav_msgs/msg/Odometry": _header_and(0, 1, 3, 4, 5, 6, 43, 44, 48, count=85, texts=1),
    "geometry_msgs/msg/TwistStamped": _header_and(0, count=6),
    "geometry_msgs/msg/Vector3Stamped": _header_and(0, 1, count=3),
    "sensor_msgs/msg/JointState": _joint_state,
    "std_msgs/msg/Float64": lambda cursor: cursor.layout(cursor.skip(NUMBER), has_stamp=False),
}
"""Functions that find the numbers which a drive needs, by type."""


def layout_of(type_name: str, data: bytes) -> Layout:
    """Return the layout of the messages that look like one message.

    Raises:
        NotTabular: The type is unknown, or the bytes are not plain CDR, or too many or too few.
    """
    if data[: len(LITTLE_ENDIAN)] != LITTLE_ENDIAN or len(data) > MOST_BYTES:
        raise NotTabular
    if type_name not in LAYOUTS:
        raise NotTabular
    return LAYOUTS[type_name](Cursor(data))


def read_table(messages: Sequence[bytes], layout: Layout, like: bytes) -> TableContent:
    """Return the content of messages of one length.

    Args:
        messages: n messages as long as `like`.
        layout: Layout of `like`.
        like: A message of the table.
    """
    table = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), len(like))
    same = np.frombuffer(like, np.uint8)[layout.fixed]
    belongs = (table[:, layout.fixed] == same).all(axis=1)
    values = [_column(table, place, "<f8") for place in layout.numbers]
    stamps = np.zeros(len(messages), dtype=np.int64)
    if layout.has_stamp:
        seconds = _column(table, 4, "<i4").astype(np.int64)
        stamps = seconds * NANOSECONDS + _column(table, 8, "<u4")
    return TableContent(stamps, np.column_stack(values), belongs)


def _column(table: NDArray[np.uint8], place: int, kind: str) -> NDArray[Any]:
    """Return the values at an address of all rows (n,)."""
    size = np.dtype(kind).itemsize
    return np.ascontiguousarray(table[:, place : place + size]).view(kind)[:, 0]
