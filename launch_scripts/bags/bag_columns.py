"""Read a drive from a bag, of any recorder, into columns of numbers.

No message is kept, because a bag of an hour has a million. Only `odom` is required.
"""

from array import array
from collections.abc import Callable, Mapping
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from ampc_msgs_config import ros, topics
from ampc_msgs_config.types import NANOSECONDS, Array
from launch_scripts.bags.bag import Bag, BagMessage, open_bag

DEBUG = dict(zip(topics.QUANTITIES, topics.DEBUG_QUANTITIES, strict=True))
WANTED = (
    *(topics.ODOM, topics.STEERING_COMMAND, topics.STEERING_STATE, topics.TARGET_SPEED),
    *(topics.WIND, topics.REFERENCE_PATH, topics.PREDICTED_PATH, topics.TICK),
    *(topics.STOP_REQUEST, *topics.CONFIGURATIONS, *topics.QUANTITIES),
)
UNPACK: dict[str, Callable[[Any], tuple[Any, ...]]] = {
    topics.ODOM: ros.vehicle_state,
    topics.STEERING_COMMAND: ros.steering_angle,
    topics.STEERING_STATE: ros.steering_angle,
    topics.TARGET_SPEED: ros.target_speed,
}
"""Functions that return stamp [ns] and values of a message, by topic."""
MAX_PREDICTIONS = 1000
"""At least this many predicted paths are kept of a bag that has more; they are thinned evenly."""
FIRST_STAMP = 10 * NANOSECONDS
"""A clock that starts at 0 has stamps below this; otherwise a stamp of 0 was never set [ns]."""
Stamps = NDArray[np.int64]


class Sample(NamedTuple):
    """Points of a path at a time."""

    time: float
    """Time since the first command [s]."""
    points: Array
    """(n, 2) in `map` [m]."""


class BagColumns(NamedTuple):
    """A drive, topic by topic; all times are since the first command [s]."""

    bag: File
    namespace: str
    start_ns: int
    """Stamp of the first command, or of the first state if there is no command [ns]."""
    values: dict[str, Array]
    """By topic, (n, 1 + k): time and values, in the order of time."""
    tick: dict[str, Array]
    """By quantity of the controller, (n, 2): time and finite value."""
    paths: list[Sample]
    """Reference paths that differ from the one before."""
    predictions: list[Sample]
    configuration: dict[str, dict[str, Any]]
    """Published configuration of `controller`, `simulator` and `planner`."""
    notes: list[str]
    """Missing or unusual content, one sentence each."""


def read_columns(path: File, namespace: str | None = None) -> BagColumns:
    """Read a drive from a bag.

    Args:
        path: Folder of the bag, or one MCAP file.
        namespace: Namespace of the topics, such as `/car1`; by default that of the first steering
            command, otherwise of the first odometry.

    Raises:
        ValueError: One line that names the bag and the fault.
    """
    with open_bag(path) as bag:
        notes = [] if bag.is_complete else ["The bag was not closed: its end may be missing."]
        if namespace is None:
            namespace = namespace_of(bag)
            notes += other_namespaces(bag, namespace)
        prefix = namespace.rstrip("/") + "/"
        wanted = [prefix + name for name in WANTED if is_usable(bag, prefix + name, notes)]
        if prefix + topics.TICK in wanted:  # contains the debug topics
            wanted = [topic for topic in wanted if topic[len(prefix) :] not in DEBUG]
        collector = Collector(bag, prefix)
        for message in bag.messages(wanted):
            collector.take(message)
        return arrange(collector, notes)


def namespace_of(bag: Bag) -> str:
    """Return the namespace of the first steering command, otherwise of the first odometry.

    Raises:
        ValueError: There is neither.
    """
    for name in (topics.STEERING_COMMAND, topics.ODOM):
        for topic in bag.topics:
            if topic.endswith(f"/{name}"):
                return topic.removesuffix(f"/{name}")
    raise ValueError(
        f"{bag.path}: holds no message on {topics.STEERING_COMMAND}, nor {topics.ODOM}"
    )


def other_namespaces(bag: Bag, namespace: str) -> list[str]:
    """Return a note if the bag has odometry in other namespaces than the chosen one."""
    chosen = f"{namespace}/{topics.ODOM}"
    expected = {chosen, f"{namespace}/{topics.FAULTY}{topics.ODOM}"}
    others = [
        topic for topic in bag.topics if topic.endswith(f"/{topics.ODOM}") and topic not in expected
    ]
    if not others:
        return []
    return [f"{chosen} is evaluated, not {', '.join(others)}; --namespace selects another."]


def is_usable(bag: Bag, topic: str, notes: list[str]) -> bool:
    """Return whether the bag has a topic with its type; note a wrong type.

    Raises:
        ValueError: `odom` has another type.
    """
    fault = bag.wrong_type(topic)
    if fault and topic.endswith(f"/{topics.ODOM}"):
        raise ValueError(f"{bag.path}: {fault}")
    if fault:
        notes.append(f"Left out: {fault}.")
    return topic in bag.topics and not fault


class Column:
    """Rows of one topic: stamps and log times as integers, values as floats."""

    def __init__(self) -> None:
        """Create an empty column."""
        self.stamps, self.log_times, self.numbers = array("q"), array("q"), array("d")
        self.rejected, self.reason = 0, ""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.stamps)

    def add(self, log_time_ns: int, stamp_ns: int, *values: float) -> None:
        """Append a row."""
        self.log_times.append(log_time_ns)
        self.stamps.append(stamp_ns)
        self.numbers.extend(values)

    def reject(self, error: Exception) -> None:
        """Count a message that cannot be used."""
        self.rejected, self.reason = self.rejected + 1, self.reason or str(error)

    def drop_unset_stamps(self) -> None:
        """Reject rows whose stamp was never set, where other rows have one."""
        stamps = np.array(self.stamps)
        is_set = stamps != 0
        if is_set.all() or not is_set.any() or stamps[is_set].min() < FIRST_STAMP:
            return
        numbers = np.array(self.numbers).reshape(len(stamps), -1)
        for _ in range(np.count_nonzero(~is_set)):
            self.reject(ValueError("the stamp is 0"))
        self.stamps = array("q", stamps[is_set].tobytes())
        self.log_times = array("q", np.array(self.log_times)[is_set].tobytes())
        self.numbers = array("d", numbers[is_set].tobytes())

    def rows(self, stamps: Stamps, start_ns: int) -> Array:
        """Return time since `start_ns` [s] and values (n, 1 + k), in the order of time."""
        time = (stamps - start_ns) / NANOSECONDS
        values = np.array(self.numbers).reshape(len(time), -1 if len(time) else 1)
        return np.column_stack((time, values))[np.argsort(stamps, kind="stable")]

    def note_faults(self, topic: str, notes: list[str]) -> None:
        """Note rejected messages, and stamps that go back."""
        if self.rejected:
            total = self.rejected + len(self)
            notes.append(f"{topic}: {self.rejected} of {total} messages rejected: {self.reason}.")
        back = int((np.diff(np.array(self.stamps)) < 0).sum())
        if back:
            notes.append(f"{topic}: time goes back {back} times; sorted by the stamps.")


class Collector:
    """Collects the numbers of the messages of one bag."""

    def __init__(self, bag: Bag, prefix: str) -> None:
        """Create an empty collector.

        Args:
            bag: Decodes the messages.
            prefix: Namespace with its slash, which precedes the names of the topics.
        """
        self.bag, self.prefix = bag, prefix
        self.columns: dict[str, Column] = {}
        self.tick_names: list[str] = []
        self.paths: list[tuple[int, Array]] = []
        self.predictions: list[BagMessage] = []
        self.prediction_count, self.prediction_step = 0, 1
        self.texts: dict[str, str] = {}

    def take(self, message: BagMessage) -> None:
        """Add a message to its column; one that cannot be used is counted."""
        name = message.topic[len(self.prefix) :]
        if name == topics.PREDICTED_PATH:
            self.thin(message)
            return
        column = self.columns.setdefault(name, Column())
        try:
            self.unpack(name, self.bag.decode(message), message.log_time_ns, column)
        except ValueError as error:
            column.reject(error)

    def thin(self, prediction: BagMessage) -> None:
        """Keep one prediction in `prediction_step`; double that step when there are too many."""
        if self.prediction_count % self.prediction_step == 0:
            self.predictions.append(prediction)
        self.prediction_count += 1
        if len(self.predictions) > 2 * MAX_PREDICTIONS:
            self.predictions, self.prediction_step = self.predictions[::2], 2 * self.prediction_step

    def unpack(self, name: str, message: Any, log_time_ns: int, column: Column) -> None:
        """Add the numbers of a message to its column.

        Raises:
            ValueError: The content violates the contract of the topic.
        """
        if name in UNPACK:
            column.add(log_time_ns, *UNPACK[name](message))
        elif name == topics.WIND:
            stamp_ns, wind = ros.nanoseconds(message.header.stamp), message.vector
            column.add(log_time_ns, stamp_ns, wind.x, wind.y)
        elif name == topics.TICK:
            # All rows have the quantities of the first message.
            self.tick_names = self.tick_names or list(message.name)
            if message.name != self.tick_names or len(message.position) != len(self.tick_names):
                raise ValueError("its quantities are not those of the first message")
            column.add(log_time_ns, ros.nanoseconds(message.header.stamp), *message.position)
        elif name == topics.REFERENCE_PATH:
            points = path_array(message)
            if not self.paths or not np.array_equal(points, self.paths[-1][1]):
                self.paths.append((log_time_ns, points))
                column.add(log_time_ns, 0, float(len(points)))
        elif name in topics.CONFIGURATIONS:
            self.texts[name.partition("/")[0]] = message.data
        else:  # Bool and Float64 have no stamp
            column.add(log_time_ns, 0, float(message.data))


def path_array(message: Any) -> Array:
    """Return the positions of a path (n, 2) [m]."""
    return np.array(ros.path_points(message), dtype=float).reshape(-1, 2)


class Clock:
    """Converts log times, which may come from another clock, to the clock of the stamps."""

    def __init__(self, column: Column) -> None:
        """Learn the offset from a column that has both."""
        self.log_times = np.maximum.accumulate(np.array(column.log_times))
        stamps = np.array(column.stamps)
        self.given: Stamps = stamps if stamps.any() else self.log_times

    def stamps(self, column: Column) -> Stamps:
        """Return the stamps of a column, from its log times if it has none [ns]."""
        stamps: Stamps = np.array(column.stamps)
        return stamps if stamps.any() else self.convert(np.array(column.log_times))

    def convert(self, log_times: Stamps) -> Stamps:
        """Convert log times with the offset of the previous message [ns]."""
        before = np.searchsorted(self.log_times, log_times, side="right") - 1
        before = np.clip(before, 0, len(self.log_times) - 1)
        return np.asarray(log_times - (self.log_times - self.given)[before])


def arrange(collector: Collector, notes: list[str]) -> BagColumns:
    """Convert all columns to one time axis.

    Raises:
        ValueError: The bag has no usable odometry.
    """
    namespace, path = collector.prefix[:-1], collector.bag.path
    columns = collector.columns
    for name, column in columns.items():
        column.drop_unset_stamps()
        column.note_faults(f"{namespace}/{name}", notes)
    odom, commands = (
        columns.get(name, Column()) for name in (topics.ODOM, topics.STEERING_COMMAND)
    )
    if not odom:
        reason = f": {odom.reason}" if odom.rejected else ""
        raise ValueError(f"{path}: holds no usable message on {namespace}/{topics.ODOM}{reason}")
    # Time 0 is the first command.
    clock = Clock(commands or odom)
    start_ns = int(clock.stamps(commands or odom).min())

    def seconds(time_ns: int) -> float:
        return (time_ns - start_ns) / NANOSECONDS

    rows = {name: column.rows(clock.stamps(column), start_ns) for name, column in columns.items()}
    paths = [
        Sample(seconds(int(clock.convert(np.array([log_time_ns]))[0])), points)
        for log_time_ns, points in collector.paths
    ]
    predictions = []
    for message in map(collector.bag.decode, collector.predictions):
        stamp_ns = ros.nanoseconds(message.header.stamp)
        predictions.append(Sample(seconds(stamp_ns), path_array(message)))
    return BagColumns(
        path,
        namespace,
        start_ns,
        {name: value for name, value in rows.items() if len(value)},
        tick_columns(rows, collector.tick_names),
        paths,
        predictions,
        parse_configurations(collector.texts, notes),
        notes,
    )


def tick_columns(rows: Mapping[str, Array], names: list[str]) -> dict[str, Array]:
    """Return the quantities of `controller/tick`, or else of the controller's debug topics."""
    if names and topics.TICK in rows:
        tick = rows[topics.TICK]
        quantities = {name: tick[:, [0, k + 1]] for k, name in enumerate(names)}
    else:
        quantities = {name: rows[topic] for topic, name in DEBUG.items() if topic in rows}
        commands = rows.get(topics.STEERING_COMMAND, np.empty((0, 2)))
        for values in quantities.values():
            if len(values) == len(commands):  # one value for each command: same stamps
                values[:, 0] = commands[:, 0]
    finite = {name: values[np.isfinite(values[:, 1])] for name, values in quantities.items()}
    return {name: values for name, values in finite.items() if len(values)}


def parse_configurations(texts: Mapping[str, str], notes: list[str]) -> dict[str, dict[str, Any]]:
    """Parse the YAML documents of the nodes; note any that is not a mapping."""
    configuration = {}
    for node, text in texts.items():
        try:
            content = yaml.safe_load(text)
        except (yaml.YAMLError, RecursionError):
            content = None
        if isinstance(content, dict):
            configuration[node] = content
        else:
            notes.append(f"Left out: {node}/{topics.CONFIGURATION} is no YAML mapping.")
    return configuration
