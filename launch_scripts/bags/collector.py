"""Collect the numbers of the messages of a bag, topic by topic."""

from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config import ros, topics
from ampc_msgs_config.nodes.serialized_path import NotTabular, positions, preamble
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.quaternions import yaw_of
from ampc_msgs_config.types import NANOSECONDS, QUATERNION_LENGTH, Array
from launch_scripts.bags.bag import Bag, BagMessage
from launch_scripts.bags.cdr_tables import Layout, layout_of, read_table
from launch_scripts.bags.salvage import uncompressed

UNPACK: dict[str, Callable[[Any], tuple[Any, ...]]] = {
    topics.ODOM: ros.vehicle_state,
    topics.TARGET_SPEED: ros.target_speed,
    topics.WIND: lambda m: (ros.nanoseconds(m.header.stamp), m.vector.x, m.vector.y),
    topics.TICK: lambda m: (ros.nanoseconds(m.header.stamp), *m.position),
}
"""Functions that return stamp [ns] and values of a message, by topic."""
STEERING = (topics.STEERING_COMMAND, topics.STEERING_STATE)
MAX_PREDICTIONS = 1000
"""At least this many predicted paths are kept of a bag that has more; they are thinned evenly."""
FIRST_STAMP = 10 * NANOSECONDS
"""A clock that starts at 0 has stamps below this; otherwise a stamp of 0 was never set [ns]."""
LARGEST_VALUE = 1e12
"""Largest value of a message; a larger one is damaged."""
BATCH = 500
"""Messages of a topic that are read together."""
AT_BOUND = 1e-9
"""Distance from the bound of an angle within which a message is read by itself [rad]."""
MOST_LAYOUTS = 8
"""Layouts of one topic; messages of further ones are read one by one."""
Stamps = NDArray[np.int64]
Row = tuple[int, Sequence[float]]
"""Stamp [ns] and values of a message."""


class ColumnRows(NamedTuple):
    """Rows of one topic."""

    stamps: Stamps
    """(n,) [ns]; all 0 without stamps."""
    log_times: Stamps
    """(n,) [ns]."""
    values: Array
    """(n, k)."""


class Column:
    """Collects the rows of one topic in little memory."""

    def __init__(self) -> None:
        """Create an empty column."""
        self.stamps, self.log_times, self.numbers = array("q"), array("q"), array("d")
        self.rejected, self.reason = 0, ""
        self.waiting: list[BagMessage] = []
        self.layouts: dict[int, tuple[Layout, bytes]] = {}
        """By length of the messages: their layout, and one of them."""

    def add(self, log_times: list[int], stamps: list[int], numbers: list[float]) -> None:
        """Append rows: log times and stamps [ns], and the values of one row after the other."""
        self.log_times.extend(log_times)
        self.stamps.extend(stamps)
        self.numbers.extend(numbers)

    def reject(self, reason: str, count: int = 1) -> None:
        """Count messages that cannot be used."""
        self.rejected, self.reason = self.rejected + count, self.reason or reason

    def rows(self, topic: str, notes: list[str]) -> ColumnRows:
        """Return the rows without stamps that were never set; note rejected messages.

        Args:
            topic: Full name of the topic.
            notes: Receives one sentence for each kind of fault.
        """
        stamps, total = np.asarray(self.stamps), self.rejected + len(self.stamps)
        values = np.asarray(self.numbers).reshape(len(stamps), -1 if len(stamps) else 1)
        is_set: Any = stamps != 0
        unset = len(stamps) - int(is_set.sum())
        if 0 < unset < len(stamps) and stamps[is_set].min() >= FIRST_STAMP:
            self.reject("the stamp is 0", unset)
        else:
            is_set = slice(None)  # no copy
        if self.rejected:
            notes.append(f"{topic}: {self.rejected} of {total} messages rejected: {self.reason}.")
        if back := int((np.diff(stamps[is_set]) < 0).sum()):
            notes.append(f"{topic}: time goes back {back} times; sorted by the stamps.")
        return ColumnRows(stamps[is_set], np.asarray(self.log_times)[is_set], values[is_set])


class Collector:
    """Collects the numbers of the messages of one bag."""

    def __init__(self, bag: Bag, prefix: str, odom: str, steering: SteeringParameters) -> None:
        """Create an empty collector.

        Args:
            bag: Decodes the messages.
            prefix: Namespace with its slash, which precedes the names of the topics.
            odom: Full name of the topic of the odometry.
            steering: Ratio and offset of the steering topics.
        """
        self.bag, self.prefix, self.odom, self.steering = bag, prefix, odom, steering
        self.columns: dict[str, Column] = {topics.ODOM: Column()}
        self.tick_names: list[str] = []
        self.paths: list[tuple[int, Array]] = []
        self.predictions: list[BagMessage] = []
        self.prediction_count, self.prediction_step = 0, 1
        self.texts: dict[str, str] = {}

    def take(self, message: BagMessage) -> None:
        """Add a message to its column; one that cannot be used is counted."""
        name = message.topic[len(self.prefix) :]
        name = topics.ODOM if message.topic == self.odom else name
        if name == topics.PREDICTED_PATH:
            self.thin(message)
            return
        column = self.columns.setdefault(name, Column())
        if name == topics.REFERENCE_PATH or name in topics.CONFIGURATIONS:
            try:
                self.take_large(name, message, column)
            except ValueError as error:
                column.reject(str(error))
            return
        column.waiting.append(message)
        if len(column.waiting) >= BATCH:
            self.read_waiting(name, column)

    def finish(self) -> None:
        """Read the messages that wait for others of their topics."""
        for name, column in self.columns.items():
            self.read_waiting(name, column)

    def thin(self, prediction: BagMessage) -> None:
        """Keep one prediction in `prediction_step`; double that step when there are too many."""
        if self.prediction_count % self.prediction_step == 0:
            self.predictions.append(prediction)
        self.prediction_count += 1
        if len(self.predictions) > 2 * MAX_PREDICTIONS:
            self.predictions, self.prediction_step = self.predictions[::2], 2 * self.prediction_step

    def take_large(self, name: str, message: BagMessage, column: Column) -> None:
        """Add a path that differs from the one before, or a configuration.

        Raises:
            ValueError: The content violates the contract of the topic.
        """
        if name in topics.CONFIGURATIONS:
            self.texts[name.partition("/")[0]] = self.bag.decode(message).data
            return
        _, points = decode_path(self.bag, message)
        check_size(points)
        if not self.paths or not np.array_equal(points, self.paths[-1][1]):
            self.paths.append((message.log_time_ns, points))
            column.add([message.log_time_ns], [0], [float(len(points))])

    def read_waiting(self, name: str, column: Column) -> None:
        """Add the waiting messages of a topic to its column, in their order.

        Messages that look like an accepted one are read as a table, all others one by one.
        """
        waiting, column.waiting = column.waiting, []
        rows: dict[int, Row] = {}
        by_length: dict[int, list[int]] = {}
        for i, message in enumerate(waiting):
            by_length.setdefault(len(message.data), []).append(i)
        for length, places in by_length.items():
            if length not in column.layouts:
                self.learn_layout(name, [waiting[i] for i in places[:2]], column)
            if layout := column.layouts.get(length):
                table = read_table([waiting[i].data for i in places], *layout)
                usable, values = USABLE.get(name, all_usable)(table.values, self.steering)
                usable &= table.belongs
                stamps, numbers = table.stamps[usable].tolist(), values[usable].tolist()
                found = np.array(places)[usable].tolist()
                rows |= dict(zip(found, zip(stamps, numbers, strict=True), strict=True))
        for i, message in enumerate(waiting):
            if i not in rows:
                try:
                    rows[i] = self.row_of(name, message)
                except ValueError as error:
                    column.reject(str(error))
        used = sorted(rows)
        column.add(
            [waiting[i].log_time_ns for i in used],
            [rows[i][0] for i in used],
            [number for i in used for number in rows[i][1]],
        )

    def learn_layout(self, name: str, messages: Sequence[BagMessage], column: Column) -> None:
        """Store the layout of the first of some messages of one length that can be used."""
        for message in messages[: MOST_LAYOUTS - len(column.layouts)]:
            with suppress(ValueError, NotTabular):
                self.row_of(name, message)
                layout = layout_of(self.bag.topics[message.topic], message.data)
                column.layouts[len(message.data)] = layout, message.data
                return

    def row_of(self, name: str, message: BagMessage) -> Row:
        """Return stamp [ns] and values of a message.

        Raises:
            ValueError: The content violates the contract of the topic.
        """
        content = self.bag.decode(message)
        if name == topics.TICK:  # all rows have the quantities of the first message
            self.tick_names = self.tick_names or list(content.name)
            if content.name != self.tick_names or len(content.position) != len(self.tick_names):
                raise ValueError("its quantities are not those of the first message")
        if name in STEERING:
            stamp_ns, angle = ros.steering_angle(content, self.steering)
            check_size([angle])
            return stamp_ns, (angle,)
        if name in UNPACK:
            stamp_ns, *values = UNPACK[name](content)
            if name != topics.TICK:  # its quantities have ranges of their own
                check_size(values)
            return stamp_ns, values
        check_size([content.data], allow_nan=True)  # Bool and Float64
        return 0, (float(content.data),)


def decode_path(bag: Bag, message: BagMessage) -> tuple[int, Array]:
    """Return stamp [ns] and positions (n, 2) [m] of a path.

    Raises:
        ValueError: The content violates the contract of the topic.
    """
    data = uncompressed(message.data)
    with suppress(NotTabular):
        start = preamble(data)
        if start.frame_id:
            return start.stamp_ns, positions(data, start)
    content = bag.decode(message)
    points = np.array(ros.path_points(content), dtype=float).reshape(-1, 2)
    return ros.nanoseconds(content.header.stamp), points


def usable_states(numbers: Array, _: SteeringParameters) -> tuple[NDArray[np.bool_], Array]:
    """Return which rows `ros.vehicle_state` accepts, but for those at its bounds; and states."""
    x, y, q_x, q_y, q_z, q_w, v_x, v_y, yaw_rate = numbers.T
    low, high = QUATERNION_LENGTH
    most = ros.MAX_TILT - AT_BOUND
    with np.errstate(all="ignore"):  # such rows are not used
        squares = q_x * q_x + q_y * q_y + q_z * q_z + q_w * q_w
        roll = np.arctan2(
            2 * (q_w * q_x + q_y * q_z), q_w * q_w + q_z * q_z - q_x * q_x - q_y * q_y
        )
        sine = 2 * (q_w * q_y - q_z * q_x) / squares
    yaw = [yaw_of(*quaternion) for quaternion in numbers[:, 2:6].tolist()]
    states = np.column_stack((x, y, yaw, v_x, v_y, yaw_rate))
    usable: Any = (low * low <= squares) & (squares <= high * high) & (np.abs(roll) <= most)
    usable &= (np.abs(sine) <= np.sin(most)) & (np.abs(states) <= LARGEST_VALUE).all(axis=1)
    return usable, states


def usable_angles(
    positions: Array, steering: SteeringParameters
) -> tuple[NDArray[np.bool_], Array]:
    """Return which rows `ros.steering_angle` accepts, and the road-wheel angles [rad]."""
    if positions.shape[1] != 1:
        return np.zeros(len(positions), dtype=bool), positions
    angles = positions / steering.ratio - (0.0 - steering.offset)  # as `steering.angle`
    usable: Any = np.abs(angles[:, 0]) <= ros.MAX_STEERING
    return usable, angles


def usable_speeds(speeds: Array, _: SteeringParameters) -> tuple[NDArray[np.bool_], Array]:
    """Return which rows `ros.target_speed` accepts, and the speeds [m/s]."""
    return (speeds[:, 0] >= 0.0) & (speeds[:, 0] <= ros.MAX_TARGET_SPEED), speeds


def usable_sizes(values: Array, _: SteeringParameters) -> tuple[NDArray[np.bool_], Array]:
    """Return which rows `check_size` accepts, but for those that are not finite; and the values."""
    usable: Any = (np.abs(values) <= LARGEST_VALUE).all(axis=1)
    return usable, values


def all_usable(values: Array, _: SteeringParameters) -> tuple[NDArray[np.bool_], Array]:
    """Return that all rows can be used, and the values."""
    return np.ones(len(values), dtype=bool), values


USABLE: dict[str, Callable[[Array, SteeringParameters], tuple[NDArray[np.bool_], Array]]] = {
    topics.ODOM: usable_states,
    topics.TARGET_SPEED: usable_speeds,
    **dict.fromkeys(STEERING, usable_angles),
    **dict.fromkeys((topics.WIND, *topics.QUANTITIES), usable_sizes),
}
"""By topic, the function that returns which rows of a table are used, and their values; rows that
it leaves out are read one by one. Those of TICK have ranges of their own."""


def check_size(values: Any, *, allow_nan: bool = False) -> None:
    """Check that values are not those of a damaged message.

    Args:
        values: Numbers of a message, in its units.
        allow_nan: Whether numbers may be nan or infinite, which means that there is none.

    Raises:
        ValueError: A number is not finite, or its size is beyond the limit.
    """
    numbers = np.asarray(values, dtype=float)
    finite = np.isfinite(numbers)
    if not (allow_nan or finite.all()):
        raise ValueError("a value is not finite")
    if np.abs(numbers[finite]).max(initial=0.0) > LARGEST_VALUE:
        raise ValueError(f"a value is beyond {LARGEST_VALUE:g}")
