"""What a bag holds of a drive, in columns of numbers, whoever recorded it.

No message is kept, as a bag of an hour has a million. Only `odom` must be there.
"""

from collections.abc import Mapping
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import ros
from ampc_msgs_config.config import parse
from ampc_msgs_config.recording.message_types import TYPES
from ampc_msgs_config.types import NANOSECONDS, Array
from launch_scripts.bags.bag import is_complete, read
from launch_scripts.bags.bag_topics import topics
from launch_scripts.bags.columns import Collector, Column, Stamps

DEBUG = dict(zip(ros.QUANTITIES, ros.DEBUG_QUANTITIES, strict=True))
WANTED = (
    *(ros.ODOM, ros.STEERING_COMMAND, ros.STEERING_STATE, ros.TARGET_SPEED, ros.WIND),
    *(ros.REFERENCE_PATH, ros.PREDICTED_PATH, ros.TICK, ros.STOP_REQUEST),
    *ros.CONFIGURATIONS,
    *ros.QUANTITIES,
)


class Sample(NamedTuple):
    """Points of a path, and the time at which they were given."""

    time: float
    """Since the first command [s]."""
    points: Array
    """(n, 2) in `map` [m]."""


class BagColumns(NamedTuple):
    """A drive, topic by topic; all times are since the first command [s]."""

    bag: File
    namespace: str
    start_ns: int
    """Stamp of the first command, or of the first state where there is no command [ns]."""
    values: dict[str, Array]
    """By topic, (n, 1 + k): time and values, in the order of time."""
    tick: dict[str, Array]
    """By quantity of the controller, (n, 2): time and finite value; without those never told."""
    paths: list[Sample]
    """References that differ from the one before."""
    predictions: list[Sample]
    configuration: dict[str, dict[str, Any]]
    """What `controller`, `simulator` and `planner` said about themselves."""
    notes: list[str]
    """What is missing or odd, each in a sentence."""


def read_columns(bag: File, namespace: str | None = None) -> BagColumns:
    """Read a drive from a bag.

    Args:
        bag: Folder of the bag, or one MCAP file.
        namespace: Where the topics stand, such as `/car1`; by default where steering, or else
            odometry, begins.

    Raises:
        ValueError: One line that names the bag and what is wrong.
    """
    found = topics(bag)
    given = namespace_of(bag, found) if namespace is None else namespace.rstrip("/")
    prefix, notes = f"{given}/", list[str]()
    if not is_complete(bag):
        notes.append("The bag was not closed: its last moments may be missing.")
    wanted = [prefix + name for name in WANTED if is_usable(bag, found, prefix, name, notes)]
    if prefix + ros.TICK in wanted:
        wanted = [topic for topic in wanted if topic[len(prefix) :] not in DEBUG]
    collector = Collector(prefix)
    for entry in read(bag, wanted, lazy=(prefix + ros.PREDICTED_PATH,)):
        collector.take(entry)
    return arranged(bag, given, collector, notes)


def namespace_of(bag: File, found: Mapping[str, str]) -> str:
    """Give the namespace of the first steering, or else of the first odometry.

    Raises:
        ValueError: There is neither.
    """
    for name in (ros.STEERING_COMMAND, ros.ODOM):
        for topic in found:
            if topic.endswith(f"/{name}"):
                return topic.removesuffix(f"/{name}")
    raise ValueError(f"{bag}: holds no message on {ros.STEERING_COMMAND}, nor on {ros.ODOM}")


def is_usable(
    bag: File, found: Mapping[str, str], prefix: str, name: str, notes: list[str]
) -> bool:
    """Tell whether a topic is there with its type; notes where it has another.

    Raises:
        ValueError: `odom` has another type.
    """
    topic, wanted = prefix + name, TYPES[name]
    if found.get(topic, wanted) == wanted:
        return topic in found
    sentence = f"{topic} holds {found[topic]}, not {wanted}"
    if name == ros.ODOM:
        raise ValueError(f"{bag}: {sentence}")
    notes.append(f"Left out: {sentence}.")
    return False


def arranged(bag: File, namespace: str, collector: Collector, notes: list[str]) -> BagColumns:
    """Bring all that was collected onto one axis of time."""
    columns = collector.columns
    odom, commands = (columns.get(name, Column()) for name in (ros.ODOM, ros.STEERING_COMMAND))
    if not odom:
        reason = f": {odom.reason}" if odom.refused else ""
        raise ValueError(f"{bag}: holds no usable message on {namespace}/{ros.ODOM}{reason}")
    for name, column in columns.items():
        note_oddities(f"{namespace}/{name}", column, notes)
    clock = Clock(commands or odom)
    start_ns = int(clock.stamps(commands or odom).min())
    rows = {name: column.rows(clock.stamps(column), start_ns) for name, column in columns.items()}
    return BagColumns(
        bag,
        namespace,
        start_ns,
        {name: value for name, value in rows.items() if len(value)},
        tick_columns(rows, collector.names),
        [
            Sample(seconds(int(clock.translate(np.array([logged]))[0]), start_ns), points)
            for logged, points in collector.paths
        ],
        [predicted(message(), start_ns) for message in collector.predicted.kept],
        configurations(collector.texts, notes),
        notes,
    )


def seconds(time_ns: int, start_ns: int) -> float:
    """Give a time since the start [s]."""
    return (time_ns - start_ns) / NANOSECONDS


def predicted(message: Any, start_ns: int) -> Sample:
    """Give a predicted path and its time."""
    points = np.array(ros.path_points(message), dtype=float).reshape(-1, 2)
    return Sample(seconds(ros.nanoseconds(message.header.stamp), start_ns), points)


def note_oddities(topic: str, column: Column, notes: list[str]) -> None:
    """Tell of messages that cannot be used, and of stamps that go back."""
    if column.refused:
        total = column.refused + len(column)
        notes.append(f"{topic}: {column.refused} of {total} messages refused: {column.reason}.")
    back = int((np.diff(np.array(column.stamps)) < 0).sum())
    if back:
        notes.append(f"{topic}: time goes back {back} times; sorted by the stamps.")


class Clock:
    """Brings log times, which may be another clock's, onto that of the stamps."""

    def __init__(self, column: Column) -> None:
        """Learn it from a column that has both."""
        self.logged = np.maximum.accumulate(np.array(column.logged))
        given = np.array(column.stamps)
        self.given: Stamps = given if given.any() else self.logged

    def stamps(self, column: Column) -> Stamps:
        """Give the stamps of a column, from its log times where it has none [ns]."""
        stamps: Stamps = np.array(column.stamps)
        return stamps if stamps.any() else self.translate(np.array(column.logged))

    def translate(self, logged: Stamps) -> Stamps:
        """Give log times by the stamps' clock: the offset is that of the message before [ns]."""
        before = np.searchsorted(self.logged, logged, side="right") - 1
        before = np.clip(before, 0, len(self.logged) - 1)
        return np.asarray(logged - (self.logged - self.given)[before])


def tick_columns(rows: Mapping[str, Array], names: list[str]) -> dict[str, Array]:
    """Give the controller's quantities, of `controller/tick` or else of its debug topics."""
    if names and ros.TICK in rows:
        tick = rows[ros.TICK]
        found = {name: tick[:, [0, k + 1]] for k, name in enumerate(names)}
    else:
        found = {name: rows[topic] for topic, name in DEBUG.items() if topic in rows}
        commands = rows.get(ros.STEERING_COMMAND, np.empty((0, 2)))
        for values in found.values():
            if len(values) == len(commands):  # one each: then they belong together
                values[:, 0] = commands[:, 0]
    told = {name: values[np.isfinite(values[:, 1])] for name, values in found.items()}
    return {name: values for name, values in told.items() if len(values)}


def configurations(texts: Mapping[str, str], notes: list[str]) -> dict[str, dict[str, Any]]:
    """Read the YAML documents of the nodes; notes which are none."""
    found = {}
    for node, text in texts.items():
        try:
            found[node] = parse(text, f"{node}/{ros.CONFIGURATION}")
        except ValueError as error:
            notes.append(f"Left out: {error}.")
    return found
