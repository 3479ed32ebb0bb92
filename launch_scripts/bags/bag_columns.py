"""Read a drive from a bag, of any recorder, into columns of numbers.

No message is kept, because a bag of an hour has a million. Only `odom` is required.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import ros, topics
from ampc_msgs_config.config import build, parse
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from launch_scripts.bags.bag import Bag, open_bag
from launch_scripts.bags.collector import Collector, Stamps, check_size, decode_path

DEBUG = dict(zip(topics.QUANTITIES, topics.DEBUG_QUANTITIES, strict=True))
WANTED = (
    *(topics.ODOM, topics.STEERING_COMMAND, topics.STEERING_STATE, topics.TARGET_SPEED),
    *(topics.WIND, topics.REFERENCE_PATH, topics.PREDICTED_PATH, topics.TICK),
    *(topics.STOP_REQUEST, *topics.CONFIGURATIONS, *topics.QUANTITIES),
)
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
INCOMPLETE = "The bag was not closed or is damaged: a part may be missing."


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


def read_columns(
    path: File,
    namespace: str | None = None,
    odom: str | None = None,
    steering: SteeringParameters = ros.ROAD_WHEEL,
) -> BagColumns:
    """Read a drive from a bag; steering angles become road-wheel angles.

    Args:
        path: Folder of the bag, or one MCAP file.
        namespace: Namespace of the topics, such as `/car1`; by default that of the first steering
            command, otherwise of the first odometry.
        odom: Topic of the odometry; by default `odom` in the namespace.
        steering: Ratio and offset of the steering topics, where the bag has no configuration.

    Raises:
        ValueError: One line that names the bag and the fault.
    """
    with open_bag(path) as bag:
        notes = [] if bag.is_complete else [INCOMPLETE, *(f"{each}." for each in bag.faults)]
        if namespace is None and odom is None:
            namespace = namespace_of(bag)
            used = {f"{namespace}/{topics.ODOM}", f"{namespace}/{topics.FAULTY}{topics.ODOM}"}
            if others := ", ".join(sorted({*odometry_topics(bag)} - used)):
                chosen = f"{namespace}/{topics.ODOM} is evaluated, not {others}"
                notes.append(f"{chosen}; --namespace or --odom selects another.")
        namespace, odom = selected(bag, namespace, odom)
        prefix = namespace + "/"
        wanted = {prefix + name for name in WANTED if name != topics.ODOM} | {odom}
        wanted &= bag.topics.keys()
        for fault in filter(None, map(bag.wrong_type, sorted(wanted))):
            topic = fault.partition(" ")[0]
            if topic == odom:
                raise ValueError(f"{bag.path}: {fault}")
            notes.append(f"Left out: {fault}.")
            wanted.remove(topic)
        if prefix + topics.TICK in wanted:  # contains the debug topics
            wanted -= {prefix + topic for topic in DEBUG}
        collector = Collector(bag, prefix, odom, topic_steering(bag, prefix) or steering)
        for message in bag.messages(wanted):
            collector.take(message)
        collector.finish()
        return arrange(collector, notes)


def odometry_topics(bag: Bag) -> list[str]:
    """Return all topics of a bag that hold odometry, in alphabetical order."""
    return sorted(topic for topic, type_ in bag.topics.items() if type_ == ODOMETRY_TYPE)


def selected(bag: Bag, namespace: str | None, odom: str | None) -> tuple[str, str]:
    """Return the namespace and the topic of the odometry that are evaluated.

    Args:
        bag: Open bag.
        namespace: Namespace chosen by the user, or None.
        odom: Topic of the odometry chosen by the user, or None.

    Raises:
        ValueError: The bag has no such topic; the message lists the odometry that it has.
    """
    if odom and namespace is None:
        names = topics.STEERING_COMMAND, topics.REFERENCE_PATH
        namespace = next((found for n in names for found in namespaces_with(bag, n)), "")
    elif namespace is None:
        namespace = namespace_of(bag)
    namespace = namespace.rstrip("/")
    topic = "/" + odom.lstrip("/") if odom else f"{namespace}/{topics.ODOM}"
    if topic in bag.topics and (not odom or bag.topics[topic] == ODOMETRY_TYPE):
        return namespace, topic
    raise ValueError(f"{bag.path}: holds no odometry on {topic}{other_odometry(bag)}")


def other_odometry(bag: Bag) -> str:
    """Return the part of a message that lists the odometry of a bag, if there is any."""
    found = ", ".join(odometry_topics(bag))
    return f"; it has {found}: select with --odom" if found else ""


def namespace_of(bag: Bag) -> str:
    """Return the namespace of the first steering command, otherwise of the first odometry.

    Raises:
        ValueError: There is neither.
    """
    for name in (topics.STEERING_COMMAND, topics.ODOM):
        for found in namespaces_with(bag, name):
            return found
    missing = f"holds no message on {topics.STEERING_COMMAND}, nor {topics.ODOM}"
    raise ValueError(f"{bag.path}: {missing}{other_odometry(bag)}")


def namespaces_with(bag: Bag, name: str) -> Iterator[str]:
    """Yield the namespaces in which a bag holds a topic; that of the gate's copy is none."""
    for topic in bag.topics:
        if topic.endswith(f"/{name}") and not topic.endswith(f"/{topics.GATE_STEERING}"):
            yield topic.removesuffix(f"/{name}")


def topic_steering(bag: Bag, prefix: str) -> SteeringParameters | None:
    """Return ratio and offset of the steering topics by the last configuration in a bag.

    Args:
        bag: Open bag.
        prefix: Namespace with its slash.

    Returns:
        The steering of the controller, otherwise of the simulated car; None where neither is
        recorded.
    """
    for topic in (prefix + topics.CONFIGURATIONS[0], prefix + topics.CONFIGURATIONS[1]):
        if topic not in bag.topics or bag.wrong_type(topic):
            continue
        for message in list(bag.messages({topic}))[-1:]:
            with suppress(ValueError):
                content = parse(bag.decode(message).data, topic)
                part = content.get("vehicle", content)
                return build(SteeringParameters, part.get("steering"), topic, "steering")
    return None


def arrange(collector: Collector, notes: list[str]) -> BagColumns:
    """Convert all columns to one time axis.

    Raises:
        ValueError: The bag has no usable odometry.
    """
    namespace, path = collector.prefix[:-1], collector.bag.path
    odom = collector.columns[topics.ODOM]
    rows = {
        name: column.rows(collector.odom if name == topics.ODOM else f"{namespace}/{name}", notes)
        for name, column in collector.columns.items()
    }
    if not len(rows[topics.ODOM].stamps):
        reason = f": {odom.reason}" if odom.rejected else ""
        others = "" if odom.rejected else other_odometry(collector.bag)
        fault = f"holds no usable message on {collector.odom}{reason}{others}"
        raise ValueError(f"{path}: {fault}")
    # Time 0 is the first command, whose stamps also relate the log times to the car's clock.
    first = rows.get(topics.STEERING_COMMAND, rows[topics.ODOM])
    first = first if len(first.stamps) else rows[topics.ODOM]
    log_times = np.maximum.accumulate(first.log_times)
    offsets = log_times - (first.stamps if first.stamps.any() else log_times)
    start_ns = int((log_times - offsets).min())

    def seconds(time_ns: Stamps) -> Array:
        return (time_ns - start_ns) / NANOSECONDS

    def stamps_of(times: Stamps) -> Stamps:
        before = np.searchsorted(log_times, times, side="right") - 1
        return np.asarray(times - offsets[np.clip(before, 0, len(offsets) - 1)])

    values = {}
    collector.columns.clear()
    for name in list(rows):  # the memory of each column is free before the next one is copied
        stamps, times, numbers = rows.pop(name)
        stamps = stamps if stamps.any() else stamps_of(times)
        table = np.column_stack((seconds(stamps), numbers))
        in_order = bool((np.diff(stamps) >= 0).all())
        values[name] = table if in_order else table[np.argsort(stamps, kind="stable")]
    path_times = stamps_of(np.array([time_ns for time_ns, _ in collector.paths], dtype=np.int64))
    configuration = {}
    for node, text in collector.texts.items():
        try:
            configuration[node] = parse(text, node)
        except ValueError:
            notes.append(f"Left out: {node}/{topics.CONFIGURATION} is no YAML mapping.")
    predictions, faults = [], list[str]()
    for serialised in collector.predictions:  # one at a time: they are big
        try:
            path_stamp_ns, points = decode_path(collector.bag, serialised)
            stamp_ns = np.array(path_stamp_ns)
            check_size(points)
            predictions.append(Sample(float(seconds(stamp_ns)), points))
        except ValueError as error:
            faults.append(str(error))
    if faults:
        count = f"{len(faults)} of {len(collector.predictions)} predicted paths"
        notes.append(f"Left out: {count}: {faults[0]}.")
    return BagColumns(
        path,
        namespace,
        start_ns,
        {name: table for name, table in values.items() if len(table)},
        tick_columns(values, collector.tick_names),
        [
            Sample(time, points)
            for time, (_, points) in zip(seconds(path_times).tolist(), collector.paths, strict=True)
        ],
        predictions,
        configuration,
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


def answered(odom: Array, commands: Array) -> tuple[Array, Array]:
    """Return the states (n, 7) whose stamp a command answers, and its angle (n,) [rad]."""
    _, state, last = np.intersect1d(odom[:, 0], commands[::-1, 0], return_indices=True)
    return odom[state], commands[::-1][last, 1]


def states_of(odom: Array, start_ns: int) -> list[VehicleState]:
    """Return rows of time since `start_ns` [s] and state (n, 7) as states."""
    return [
        VehicleState(start_ns + round(time * NANOSECONDS), *state) for time, *state in odom.tolist()
    ]
