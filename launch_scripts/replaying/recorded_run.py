"""Recorded inputs and results of a controller, tick by tick, from a bag."""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import ros
from ampc_msgs_config.config import parse
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.configuration import Configuration, from_yaml
from launch_scripts.bags.bag import Bag, open_bag
from launch_scripts.bags.bag_columns import namespace_of

CONTROLLER, SIMULATOR = (f"{node}/{ros.CONFIGURATION}" for node in ("controller", "simulator"))
INPUTS = (ros.ODOM, ros.REFERENCE_PATH, ros.TICK, ros.STEERING_COMMAND, CONTROLLER, SIMULATOR)
NO_AGES = {"state_age": 0.0, "state_silence": 0.0, "path_age": 0.0, "path_silence": 0.0}
"""Ages in a bag without tick records: a drive in lock-step, in which no input is late."""


class RecordedPath(NamedTuple):
    """A reference path as it was published."""

    stamp_ns: int
    points: Array
    """(n, 2) positions in `map` [m]."""


class RecordedTick(NamedTuple):
    """Inputs and results of a tick."""

    now_ns: int
    """Time of the controller's clock [ns]."""
    state: VehicleState
    path: RecordedPath
    values: dict[str, float]
    """All quantities of the tick by name; without tick records ages and `steering`."""

    def ago_ns(self, quantity: str) -> int:
        """Return the time of the tick minus a quantity of the tick [ns]."""
        return self.now_ns - round(self.values[quantity] * NANOSECONDS)


class RecordedRun(NamedTuple):
    """All ticks of a bag."""

    bag: File
    ticks: list[RecordedTick]
    config: dict[int, Configuration]
    """Configurations by number; empty if the bag has none."""
    version: str
    """Version of the recording program; empty if the bag does not name it."""
    simulator: str
    """Configuration of the simulator as YAML; empty without a simulator."""
    notes: list[str]
    """Missing contents, one sentence each."""


class StampIndex:
    """Values of a topic by stamp and position in the bag."""

    def __init__(self) -> None:
        """Create an empty index."""
        self.by_stamp: dict[int, list[tuple[int, Any]]] = defaultdict(list)

    def add(self, stamp_ns: int, position: int, value: Any) -> None:
        """Add a value."""
        self.by_stamp[stamp_ns].append((position, value))

    def at(self, stamp_ns: int, position: int) -> Any | None:
        """Return the value of a stamp; of several, the last one before a position in the bag."""
        same = self.by_stamp.get(stamp_ns, [])
        before = bisect_right(same, position, key=lambda each: each[0])
        return same[max(before - 1, 0)][1] if same else None

    def near(self, stamp_ns: int, position: int) -> Any:
        """Return the value of the nearest stamp."""
        return self.at(min(self.by_stamp, key=lambda each: abs(each - stamp_ns)), position)


class TickMessage(NamedTuple):
    """A tick or a command from its message."""

    position: int
    """Position in the bag."""
    stamp_ns: int
    """Stamp of the answered state [ns]."""
    values: dict[str, float]


class Messages(NamedTuple):
    """The messages of a run."""

    states: StampIndex
    paths: StampIndex
    ticks: list[TickMessage]
    commands: list[TickMessage]
    texts: dict[str, list[str]]


def read_run(bag: File, namespace: str | None = None) -> RecordedRun:
    """Read a run from a bag.

    Args:
        bag: Folder of the bag, or one MCAP file.
        namespace: Namespace of the topics, such as `/car1`; None: that of the first command.

    Raises:
        ValueError: Required messages are missing; with bag and topic.
    """
    with open_bag(bag) as opened:
        prefix = namespace_of(opened) if namespace is None else namespace.rstrip("/")
        heard = {name: f"{prefix}/{name}" for name in INPUTS}
        faulty = {name: f"{prefix}/{ros.FAULTY}{name}" for name in INPUTS}
        heard |= {name: topic for name, topic in faulty.items() if topic in opened.topics}
        messages, notes = read_messages(opened, heard), list[str]()
    if not messages.paths.by_stamp:
        raise ValueError(f"{bag}: holds no message on {heard[ros.REFERENCE_PATH]}")
    if not messages.ticks:
        notes.append("no controller/tick: read as a drive in lock-step, in which no input is late")
    answers = messages.ticks or messages.commands
    resolved = (resolve(each, messages.states, messages.paths) for each in answers)
    ticks = [tick for tick in resolved if tick]
    if not ticks:
        raise ValueError(f"{bag}: holds no command that answers a recorded state")
    if len(ticks) < len(answers):
        notes.append(f"{len(answers) - len(ticks)} ticks answer a state that is not in the bag")
    config, version = read_configurations(bag, messages.texts[CONTROLLER])
    simulator = "".join(messages.texts[SIMULATOR][-1:])
    return RecordedRun(bag, ticks, config, version, simulator, notes)


def read_messages(bag: Bag, heard: Mapping[str, str]) -> Messages:
    """Read the messages of a run, without those that the controller must have rejected.

    Args:
        bag: The open bag.
        heard: Topic of the controller's input, by name of the contract.
    """
    names = {topic: name for name, topic in heard.items()}
    messages = Messages(StampIndex(), StampIndex(), [], [], defaultdict(list))
    for position, message in enumerate(bag.messages(names)):
        try:
            add_message(messages, names[message.topic], position, bag.decode(message))
        except ValueError:
            continue
    return messages


def add_message(messages: Messages, name: str, position: int, message: Any) -> None:
    """Add one message.

    Raises:
        ValueError: The message is invalid.
    """
    if name in (CONTROLLER, SIMULATOR):
        messages.texts[name].append(message.data)
        return
    stamp_ns = ros.nanoseconds(message.header.stamp)
    if name == ros.ODOM:
        messages.states.add(stamp_ns, position, ros.vehicle_state(message))
    elif name == ros.REFERENCE_PATH:
        points = np.array(ros.path_points(message), dtype=float)
        messages.paths.add(stamp_ns, position, RecordedPath(stamp_ns, points))
    elif name == ros.TICK:
        values = dict(zip(message.name, message.position, strict=True))
        messages.ticks.append(TickMessage(position, stamp_ns, values))
    else:
        values = {"steering": ros.steering_angle(message).value, **NO_AGES}
        messages.commands.append(TickMessage(position, stamp_ns, values))


def resolve(message: TickMessage, states: StampIndex, paths: StampIndex) -> RecordedTick | None:
    """Look up state and path of a tick; None: the state is not in the bag."""
    state = states.at(message.stamp_ns, message.position)
    if state is None:
        return None
    now_ns = message.stamp_ns + round(message.values["state_age"] * NANOSECONDS)
    path_ns = now_ns - round(message.values["path_age"] * NANOSECONDS)
    return RecordedTick(now_ns, state, paths.near(path_ns, message.position), message.values)


def read_configurations(bag: File, texts: Sequence[str]) -> tuple[dict[int, Configuration], str]:
    """Return the configurations of the controller by number, and the recording version."""
    config = [from_yaml(text, f"{bag}: {CONTROLLER}") for text in texts]
    version = str(parse(texts[0], "").get("version", "")) if texts else ""
    return {number: each for each, number in config}, version
