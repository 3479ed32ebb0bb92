"""What a controller was given and what it answered, tick by tick, as a bag tells it."""

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
ALONE = {"state_age": 0.0, "state_silence": 0.0, "path_age": 0.0, "path_silence": 0.0}
"""Of a bag without ticks: a drive in lock-step, in which nothing is late."""


class RecordedPath(NamedTuple):
    """A reference as it was published."""

    stamp_ns: int
    points: Array
    """(n, 2) in `map` [m]."""


class RecordedTick(NamedTuple):
    """Inputs of a tick, and its outcome."""

    now_ns: int
    """Time of the controller's clock [ns]."""
    state: VehicleState
    path: RecordedPath
    values: dict[str, float]
    """All quantities of the tick, by name; of a bag without ticks ages and `steering`."""

    def ago_ns(self, quantity: str) -> int:
        """Give the time that lies back by a quantity of the tick [ns]."""
        return self.now_ns - round(self.values[quantity] * NANOSECONDS)


class RecordedRun(NamedTuple):
    """All ticks of a bag."""

    bag: File
    ticks: list[RecordedTick]
    config: dict[int, Configuration]
    """By number; empty where the bag does not say what the controller was made of."""
    version: str
    """Of the programme that recorded; empty where the bag does not say."""
    simulator: str
    """Configuration of the simulator as YAML; empty where no simulator told."""
    notes: list[str]
    """What is missing, each in a sentence."""


class Stamped:
    """What a topic carried, by stamp, and where in the bag it stands."""

    def __init__(self) -> None:
        """Hold nothing."""
        self.found: dict[int, list[tuple[int, Any]]] = defaultdict(list)

    def add(self, stamp_ns: int, place: int, value: Any) -> None:
        """Keep a value."""
        self.found[stamp_ns].append((place, value))

    def at(self, stamp_ns: int, place: int) -> Any | None:
        """Give the value of a stamp; of several, the last one before a place in the bag."""
        same = self.found.get(stamp_ns, [])
        before = bisect_right(same, place, key=lambda each: each[0])
        return same[max(before - 1, 0)][1] if same else None

    def near(self, stamp_ns: int, place: int) -> Any:
        """Give the value of the nearest stamp."""
        return self.at(min(self.found, key=lambda each: abs(each - stamp_ns)), place)


class Answer(NamedTuple):
    """A tick as its message tells it."""

    place: int
    """In the bag."""
    stamp_ns: int
    """Of the state that it answers [ns]."""
    values: dict[str, float]


class Collected(NamedTuple):
    """The messages of a run."""

    states: Stamped
    paths: Stamped
    ticks: list[Answer]
    commands: list[Answer]
    texts: dict[str, list[str]]


def read_run(bag: File, namespace: str | None = None) -> RecordedRun:
    """Read a run from a bag.

    Args:
        bag: Folder of the bag, or one MCAP file.
        namespace: Where the topics stand, such as `/car1`; by default where steering begins.

    Raises:
        ValueError: Names the bag and what it lacks.
    """
    with open_bag(bag) as opened:
        prefix = namespace_of(opened) if namespace is None else namespace.rstrip("/")
        heard = {name: f"{prefix}/{name}" for name in INPUTS}
        faulty = {name: f"{prefix}/{ros.FAULTY}{name}" for name in INPUTS}
        heard |= {name: topic for name, topic in faulty.items() if topic in opened.topics}
        found, notes = collected(opened, heard), list[str]()
    if not found.paths.found:
        raise ValueError(f"{bag}: holds no message on {heard[ros.REFERENCE_PATH]}")
    if not found.ticks:
        notes.append("no controller/tick: taken as a drive in lock-step, in which nothing is late")
    answers = found.ticks or found.commands
    ticks = [tick for each in answers if (tick := resolved(each, found.states, found.paths))]
    if not ticks:
        raise ValueError(f"{bag}: holds no command that answers a recorded state")
    if len(ticks) < len(answers):
        notes.append(f"{len(answers) - len(ticks)} ticks answer a state that is not in the bag")
    config, version = configurations(bag, found.texts[CONTROLLER])
    return RecordedRun(bag, ticks, config, version, "".join(found.texts[SIMULATOR][-1:]), notes)


def collected(bag: Bag, heard: Mapping[str, str]) -> Collected:
    """Read what a run consists of; messages that the controller must have refused are left out.

    Args:
        bag: The open bag.
        heard: The topic that the controller heard, by name of the contract.
    """
    names = {topic: name for name, topic in heard.items()}
    found = Collected(Stamped(), Stamped(), [], [], defaultdict(list))
    for place, message in enumerate(bag.messages(names)):
        try:
            keep(found, names[message.topic], place, bag.decode(message))
        except ValueError:
            continue
    return found


def keep(found: Collected, name: str, place: int, message: Any) -> None:
    """Add a message to what was found."""
    if name in (CONTROLLER, SIMULATOR):
        found.texts[name].append(message.data)
        return
    stamp_ns = ros.nanoseconds(message.header.stamp)
    if name == ros.ODOM:
        found.states.add(stamp_ns, place, ros.vehicle_state(message))
    elif name == ros.REFERENCE_PATH:
        points = np.array(ros.path_points(message), dtype=float)
        found.paths.add(stamp_ns, place, RecordedPath(stamp_ns, points))
    elif name == ros.TICK:
        values = dict(zip(message.name, message.position, strict=True))
        found.ticks.append(Answer(place, stamp_ns, values))
    else:
        values = {"steering": ros.steering_angle(message).value, **ALONE}
        found.commands.append(Answer(place, stamp_ns, values))


def resolved(answer: Answer, states: Stamped, paths: Stamped) -> RecordedTick | None:
    """Find state and path of a tick; None where the state is not in the bag."""
    state = states.at(answer.stamp_ns, answer.place)
    if state is None:
        return None
    now_ns = answer.stamp_ns + round(answer.values["state_age"] * NANOSECONDS)
    path_ns = now_ns - round(answer.values["path_age"] * NANOSECONDS)
    return RecordedTick(now_ns, state, paths.near(path_ns, answer.place), answer.values)


def configurations(bag: File, texts: Sequence[str]) -> tuple[dict[int, Configuration], str]:
    """Give what the controller was made of, by number, and the version that recorded it."""
    config = [from_yaml(text, f"{bag}: {CONTROLLER}") for text in texts]
    version = str(parse(texts[0], "").get("version", "")) if texts else ""
    return {number: each for each, number in config}, version
