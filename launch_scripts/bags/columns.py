"""Collects the numbers of a bag's messages, topic by topic, while they come by."""

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS, Array
from launch_scripts.bags.bag import Entry

MAX_PREDICTIONS = 1000
"""Predicted paths that are kept of a bag at least, where it has more; they are thinned evenly."""
Stamps = NDArray[np.int64]


class Column:
    """Rows of one topic: stamps and log times as integers, values as floats."""

    def __init__(self) -> None:
        """Start empty."""
        self.stamps, self.logged, self.numbers = array("q"), array("q"), array("d")
        self.refused, self.reason = 0, ""

    def __len__(self) -> int:
        """Give the number of rows."""
        return len(self.stamps)

    def add(self, stamp_ns: int, logged_ns: int, *values: float) -> None:
        """Append a row."""
        self.stamps.append(stamp_ns)
        self.logged.append(logged_ns)
        self.numbers.extend(values)

    def refuse(self, error: Exception) -> None:
        """Count a message that cannot be used."""
        self.refused, self.reason = self.refused + 1, self.reason or str(error)

    def rows(self, stamps: Stamps, start_ns: int) -> Array:
        """Give time since `start_ns` [s] and values (n, 1 + k), in the order of time."""
        time = (stamps - start_ns) / NANOSECONDS
        values = np.array(self.numbers).reshape(len(time), -1 if len(time) else 1)
        return np.column_stack((time, values))[np.argsort(stamps, kind="stable")]


class Thinned:
    """An even choice of the messages that come by, which are decoded when they are called."""

    def __init__(self) -> None:
        """Start with every message."""
        self.kept: list[Callable[[], Any]] = []
        self.step, self.count = 1, 0

    def add(self, message: Callable[[], Any]) -> None:
        """Keep one in `step`, and half of those when they become too many."""
        if self.count % self.step == 0:
            self.kept.append(message)
        self.count += 1
        if len(self.kept) > 2 * MAX_PREDICTIONS:
            self.kept, self.step = self.kept[::2], 2 * self.step


class Collector:
    """Takes the messages of one bag in turn."""

    def __init__(self, prefix: str) -> None:
        """Start empty; `prefix` is the namespace with its slash, before the topics' names."""
        self.prefix = prefix
        self.columns: dict[str, Column] = {}
        self.names: list[str] = []
        self.paths: list[tuple[int, Array]] = []
        self.predicted = Thinned()
        self.texts: dict[str, str] = {}

    def take(self, entry: Entry) -> None:
        """Sort a message in; one that cannot be used is counted."""
        name = entry.topic[len(self.prefix) :]
        if name == ros.PREDICTED_PATH:
            self.predicted.add(entry.message)
        elif name in ros.CONFIGURATIONS:
            self.texts[name.partition("/")[0]] = entry.message.data
        else:
            column = self.columns.setdefault(name, Column())
            try:
                self.unpack(name, entry.message, entry.log_time_ns, column)
            except ValueError as error:
                column.refuse(error)

    def unpack(self, name: str, message: Any, logged_ns: int, column: Column) -> None:
        """Add the numbers of a message to its column.

        Raises:
            ValueError: It holds what its topic must not hold.
        """
        if name == ros.ODOM:
            stamp_ns, *state = ros.vehicle_state(message)
            column.add(stamp_ns, logged_ns, *state)
        elif name in (ros.STEERING_COMMAND, ros.STEERING_STATE):
            stamp_ns, angle = ros.steering_angle(message)
            column.add(stamp_ns, logged_ns, angle)
        elif name == ros.TARGET_SPEED:
            stamp_ns, speed = ros.target_speed(message)
            column.add(stamp_ns, logged_ns, speed)
        elif name == ros.WIND:
            wind = message.vector
            column.add(ros.nanoseconds(message.header.stamp), logged_ns, wind.x, wind.y)
        elif name == ros.TICK:
            self.add_tick(message, logged_ns, column)
        elif name == ros.REFERENCE_PATH:
            self.add_path(message, logged_ns, column)
        else:  # Bool and Float64 have no stamp
            column.add(0, logged_ns, float(message.data))

    def add_tick(self, message: Any, logged_ns: int, column: Column) -> None:
        """Add all quantities of a tick; their names are those of the first one."""
        self.names = self.names or list(message.name)
        if message.name != self.names or len(message.position) != len(self.names):
            raise ValueError("its quantities are not those of the first message")
        column.add(ros.nanoseconds(message.header.stamp), logged_ns, *message.position)

    def add_path(self, message: Any, logged_ns: int, column: Column) -> None:
        """Keep a path that differs from the one before."""
        points = np.array(ros.path_points(message), dtype=float).reshape(-1, 2)
        if not self.paths or not np.array_equal(points, self.paths[-1][1]):
            self.paths.append((logged_ns, points))
            column.add(0, logged_ns, float(len(points)))
