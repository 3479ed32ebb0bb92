"""Recorded inputs and results of a controller, tick by tick, from a bag."""

from bisect import bisect_right
from collections import Counter, defaultdict
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import ros, topics
from ampc_msgs_config.config import parse
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import NANOSECONDS, REASONS, RUNGS, Array, VehicleState
from ampc_ros.configuration import Configuration, from_yaml
from launch_scripts.bags.bag import open_bag
from launch_scripts.bags.bag_columns import INCOMPLETE, selected, topic_steering

CONTROLLER, SIMULATOR = (f"{node}/{topics.CONFIGURATION}" for node in ("controller", "simulator"))
INPUTS = (
    topics.ODOM,
    topics.REFERENCE_PATH,
    topics.TICK,
    topics.STEERING_COMMAND,
    topics.MEMORY,
    CONTROLLER,
    SIMULATOR,
)
LARGEST_AGE = 1e10
"""Largest age of an input in a tick [s]; that of a stamp 0 is 1.8e9, a larger one is damaged."""
STAMP_ROUNDING_NS = 1000
"""Rounding of a stamp that is computed from an age, at most [ns]."""
LARGEST_COUNT = 2**53
NO_AGES = {"state_age": 0.0, "state_silence": 0.0, "path_age": 0.0, "path_silence": 0.0}
"""Ages in a bag without tick records: a drive in lock-step, in which no input is late."""


CONVERSION_ROUNDING = 1.0e-12
"""Rounding error of a command that is read back from a topic with ratio or offset [rad]."""


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
    """All quantities of the tick by name; without tick records ages, `steering`, its `rounding`."""
    position: int = 0
    """Position in the bag."""
    is_exact: bool = True
    """Whether what the controller remembered at this tick is known."""
    memory: bytes = b""
    """What it remembered; empty: as after the tick before."""

    def ago_ns(self, quantity: str) -> int:
        """Return the time of the tick minus a quantity of the tick [ns]."""
        return self.now_ns - round(self.values[quantity] * NANOSECONDS)


class StoredMemory(NamedTuple):
    """Memory of the controller, as it was published."""

    position: int
    """Position in the bag."""
    commands: int
    """Number of the tick after which it was stored."""
    data: bytes


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
    memories: list[StoredMemory]
    """In the order of the bag."""


class StampIndex:
    """Values of a topic by stamp and position in the bag."""

    def __init__(self) -> None:
        """Create an empty index."""
        self.by_stamp: dict[int, list[tuple[int, Any]]] = defaultdict(list)

    def at(self, stamp_ns: int, position: int) -> Any | None:
        """Return the value of a stamp; of several, the last one before a position in the bag."""
        same = self.by_stamp.get(stamp_ns, [])
        before = bisect_right(same, position, key=lambda each: each[0])
        return same[max(before - 1, 0)][1] if same else None

    def near(self, stamp_ns: int, position: int) -> Any:
        """Return the value of the nearest stamp."""
        return self.at(min(self.by_stamp, key=lambda each: abs(each - stamp_ns)), position)


class Answer(NamedTuple):
    """A tick or a command as it was published."""

    position: int
    """Position in the bag."""
    stamp_ns: int
    """Stamp of the answered state [ns]."""
    values: dict[str, float]


def check_tick(values: dict[str, float]) -> None:
    """Check that a tick can be repeated.

    Raises:
        ValueError: A quantity is missing or out of range.
    """
    if missing := {"steering", *NO_AGES} - values.keys():
        raise ValueError(f"the tick has no {', '.join(sorted(missing))}")
    for name, count in {"rung": len(RUNGS), "reason": len(REASONS)}.items():
        if name in values and not 0 <= values[name] < count:
            raise ValueError(f"the tick has {name} {values[name]}")
    if not all(abs(values[name]) < LARGEST_AGE for name in ("steering", *NO_AGES)):
        raise ValueError("an age or angle of the tick is out of range")
    for name in ("resets", "commands"):
        if not 0 <= values.get(name, 0.0) < LARGEST_COUNT:
            raise ValueError(f"the tick has a wrong number of {name}")


def read_run(
    bag: File,
    namespace: str | None = None,
    odom: str | None = None,
    steering: SteeringParameters = ros.ROAD_WHEEL,
) -> RecordedRun:
    """Read a run from a bag.

    Args:
        bag: Folder of the bag, or one MCAP file.
        namespace: Namespace of the topics, such as `/car1`; None: that of the first command.
        odom: Topic of the odometry; None: `odom` in the namespace.
        steering: Ratio and offset of the steering topics, where the bag has no configuration.

    Raises:
        ValueError: Required messages are missing; with bag and topic.
    """
    states, paths, texts = StampIndex(), StampIndex(), defaultdict[str, list[str]](list)
    memories = list[StoredMemory]()
    answers: dict[str, list[Answer]] = {topics.TICK: [], topics.STEERING_COMMAND: []}
    with open_bag(bag) as opened:
        notes = [] if opened.is_complete else [INCOMPLETE, *opened.faults]
        prefix, odometry = selected(opened, namespace, odom)
        steering = topic_steering(opened, f"{prefix}/") or steering
        heard = {f"{prefix}/{name}": name for name in INPUTS}
        for name in INPUTS:
            if (faulty := f"{prefix}/{topics.FAULTY}{name}") in opened.topics:
                del heard[f"{prefix}/{name}"]
                heard[faulty] = name
        if odom:
            heard = {topic: name for topic, name in heard.items() if name != topics.ODOM}
            heard[odometry] = topics.ODOM
        rejected = Counter[str]()
        for position, serialised in enumerate(opened.messages(heard)):
            name = heard[serialised.topic]
            try:
                message = opened.decode(serialised)
                if name in (CONTROLLER, SIMULATOR):
                    texts[name].append(message.data)
                    continue
                if name == topics.MEMORY:
                    memories.append(StoredMemory(position, *ros.memory_of(message)))
                    continue
                stamp_ns = ros.nanoseconds(message.header.stamp)
                if name == topics.ODOM:
                    states.by_stamp[stamp_ns].append((position, ros.vehicle_state(message)))
                elif name == topics.REFERENCE_PATH:
                    points = np.array(ros.path_points(message), dtype=float)
                    paths.by_stamp[stamp_ns].append((position, RecordedPath(stamp_ns, points)))
                elif name == topics.TICK:
                    values = dict(zip(message.name, message.position, strict=True))
                    check_tick(values)
                    answers[name].append(Answer(position, stamp_ns, values))
                else:
                    angle = ros.steering_angle(message, steering).value
                    rounding = 0.0 if angle == message.position[0] else CONVERSION_ROUNDING
                    values = {"steering": angle, "rounding": rounding, **NO_AGES}
                    answers[name].append(Answer(position, stamp_ns, values))
            except ValueError:  # the controller must have rejected it, too
                rejected[serialised.topic] += 1
    if not paths.by_stamp:
        (topic,) = (topic for topic, name in heard.items() if name == topics.REFERENCE_PATH)
        raise ValueError(f"{bag}: holds no message on {topic}")
    notes += [f"{topic}: {n} messages cannot be used" for topic, n in rejected.items()]
    if not answers[topics.TICK]:
        notes.append("no controller/tick: read as a drive in lock-step, in which no input is late")
    messages, ticks = answers[topics.TICK] or answers[topics.STEERING_COMMAND], []
    without_state = without_path = 0
    for position, stamp_ns, values in messages:
        if (state := states.at(stamp_ns, position)) is None:
            without_state += 1
            continue
        now_ns = stamp_ns + round(values["state_age"] * NANOSECONDS)
        path_ns = now_ns - round(values["path_age"] * NANOSECONDS)
        path = paths.near(path_ns, position)
        if answers[topics.TICK] and abs(path.stamp_ns - path_ns) > STAMP_ROUNDING_NS:
            without_path += 1
            continue
        ticks.append(RecordedTick(now_ns, state, path, values, position))
    if without_state:
        notes.append(f"{without_state} ticks answer a state that is not in the bag")
    if without_path:
        notes.append(f"{without_path} ticks follow a path that is not in the bag")
    if not ticks:
        raise ValueError(f"{bag}: holds no command that answers a recorded state and path")
    config, faults = [], list[ValueError]()
    for text in texts[CONTROLLER]:
        try:
            config.append(from_yaml(text, f"{bag}: {CONTROLLER}"))
        except ValueError as error:
            faults.append(error)
    if faults and not config:
        raise faults[0]
    notes += [f"left out: {fault}" for fault in faults]
    version = str(parse(texts[CONTROLLER][0], "").get("version", "")) if config else ""
    simulator = "".join(texts[SIMULATOR][-1:])
    by_number = {number: each for each, number in config}
    count = len(ticks)
    if by_number:
        default = float(min(by_number))
        ticks = [tick for tick in ticks if tick.values.get("configuration", default) in by_number]
    if len(ticks) < count:
        notes.append(f"{count - len(ticks)} ticks refer to a configuration that is not in the bag")
    if not ticks:
        raise ValueError(f"{bag}: holds no tick whose configuration is in the bag")
    return RecordedRun(bag, ticks, by_number, version, simulator, notes, memories)
