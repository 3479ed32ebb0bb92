"""Odometry that no car sends: numbers, times, frames, rates."""

import copy
import math
import random
from collections.abc import Callable, Iterable, Iterator
from functools import partial

from nav_msgs.msg import Odometry

from ampc_msgs_config import ros
from tests.workshop.attacks.attempts import Attempt, Choice
from tests.workshop.attacks.auditor import RATE, Faulty
from tests.workshop.attacks.live import Session, attacks_on, parameters_of

DURATION = 0.7
"""Of an attack [s]."""
SHARE = 0.5
"""Share of the messages that are hostile, where sound ones come between them."""


def attempts(choice: Choice) -> Iterator[Attempt]:
    """Send all kinds of hostile odometry, to controller and gate."""
    attacks = {name: sending(choice, name, change) for name, change in changes().items()}
    attacks |= {name: streaming(faulty) for name, faulty in streams().items()}
    return attacks_on(choice, attacks, parameters_of())


def sending(
    choice: Choice, name: str, change: Callable[[Odometry], object]
) -> Callable[[Session], object]:
    """Return an attack that changes a random half of the messages, then all, for a time each."""

    def attack(live: Session) -> None:
        rng = choice.rng(name)
        for share in (SHARE, 1.0):
            live.auditor.faulty = partial(changed, rng, share, change)
            live.auditor.run(DURATION)

    return attack


def changed(
    rng: random.Random, share: float, change: Callable[[Odometry], object], message: Odometry
) -> list[Odometry]:
    """Return a message, changed in a share of all calls."""
    if rng.random() < share:
        change(message)
    return [message]


def streaming(make: Callable[[], Faulty]) -> Callable[[Session], None]:
    """Return an attack by a stream of messages with a memory."""

    def attack(live: Session) -> None:
        live.auditor.faulty = make()
        live.auditor.run(2.0 * DURATION)

    return attack


def changes() -> dict[str, Callable[[Odometry], object]]:
    """Return changes of single messages, by name."""
    attacks: dict[str, Callable[[Odometry], object]] = {}
    for value in (math.nan, math.inf, 1e308):
        for key, owner in FIELDS.items():
            attacks[f"{key} {value:g}"] = setter(owner, value)
    for seconds in (-5.0, -0.3, 0.3, 5.0, 1e9):
        attacks[f"stamp {seconds:+g} s"] = shifter(seconds)
    attacks["stamp zero"] = lambda m: setattr(m.header, "stamp", ros.time_message(0))
    attacks["stamp negative"] = lambda m: setattr(m.header.stamp, "sec", -(2**31))
    for name, q in QUATERNIONS.items():
        attacks[f"quaternion {name}"] = turner(q)
    for name in ("", "other", "/map", "m" * 10_000, "k\u00e4rt\U0001f697"):
        attacks[f"frame {name[:8]!r}"] = partial(set_frame, name)
    attacks["child frame"] = lambda m: setattr(m, "child_frame_id", "c" * 10_000)
    attacks["position jump 3 m"] = lambda m: add(m.pose.pose.position, "y", 3.0)
    attacks["position jump 1 km"] = lambda m: add(m.pose.pose.position, "x", 1000.0)
    attacks["speed 60 m/s"] = setter("twist.twist.linear.x", 60.0)
    attacks["speed -8 m/s"] = setter("twist.twist.linear.x", -8.0)
    attacks["yaw rate 9 rad/s"] = setter("twist.twist.angular.z", 9.0)
    attacks["lateral velocity 9 m/s"] = setter("twist.twist.linear.y", 9.0)
    attacks["covariance nan"] = lambda m: m.pose.covariance.__setitem__(0, math.nan)
    return attacks


FIELDS = {"x": "pose.pose.position.x", "v": "twist.twist.linear.x", "turn": "twist.twist.angular.z"}
QUATERNIONS = {
    "zero": (0.0, 0.0, 0.0, 0.0),
    "long": (0.0, 0.0, 9.0, 9.0),
    "nan": (math.nan, 0.0, 0.0, 1.0),
    "roll 90 deg": (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)),
    "z down": (1.0, 0.0, 0.0, 0.0),
}


def setter(path: str, value: float) -> Callable[[Odometry], object]:
    """Return a change that sets a field."""
    *owners, field = path.split(".")

    def change(message: Odometry) -> None:
        owner = message
        for name in owners:
            owner = getattr(owner, name)
        setattr(owner, field, value)

    return change


def set_frame(name: str, message: Odometry) -> None:
    """Set the frame."""
    message.header.frame_id = name


def add(owner: object, field: str, value: float) -> None:
    """Add to a number."""
    setattr(owner, field, getattr(owner, field) + value)


def shifter(seconds: float) -> Callable[[Odometry], object]:
    """Return a change of the stamp."""

    def change(message: Odometry) -> None:
        stamp_ns = ros.nanoseconds(message.header.stamp) + int(seconds * 1e9)
        message.header.stamp = ros.time_message(min(max(stamp_ns, 0), (2**31 - 1) * 10**9))

    return change


def turner(q: tuple[float, ...]) -> Callable[[Odometry], object]:
    """Return a change of the orientation."""

    def change(message: Odometry) -> None:
        orientation = message.pose.pose.orientation
        orientation.x, orientation.y, orientation.z, orientation.w = q

    return change


def streams() -> dict[str, Callable[[], Faulty]]:
    """Return changes of the stream of messages, by name."""
    return {
        "silence": lambda: lambda _: [],
        "1 Hz": lambda: every(int(RATE)),
        "3 Hz": lambda: every(int(RATE) // 3),
        "duplicates": lambda: lambda m: [m] * 5,
        "duplicates, changed": lambda: lambda m: [m, altered(m)],
        "frozen": frozen,
        "reversed": in_reverse,
        "late by 0.3 s": lambda: delayed(int(0.3 * RATE)),
        "two sources": lambda: lambda m: [m, altered(m, 20.0)],
        "flood": lambda: lambda m: [m] * 100,
    }


def every(count: int) -> Faulty:
    """Return one message of so many."""
    number = iter(range(10**9))
    return lambda message: [] if next(number) % count else [message]


def altered(message: Odometry, offset: float = 0.5) -> Odometry:
    """Return a copy at another place."""
    other = copy.deepcopy(message)
    other.pose.pose.position.y += offset
    return other


def frozen() -> Faulty:
    """Return a stream whose pose is that of its first message."""
    first: list[Odometry] = []

    def faulty(message: Odometry) -> Iterable[Odometry]:
        first.append(copy.deepcopy(message))
        message.pose = first[0].pose
        return [message]

    return faulty


def in_reverse() -> Faulty:
    """Return a stream of groups of five messages in reverse order."""
    group: list[Odometry] = []

    def faulty(message: Odometry) -> Iterable[Odometry]:
        group.append(message)
        if len(group) < 5:
            return []
        sent = group[::-1]
        group.clear()
        return sent

    return faulty


def delayed(count: int) -> Faulty:
    """Return a stream that is late by so many messages."""
    queue: list[Odometry] = []

    def faulty(message: Odometry) -> Iterable[Odometry]:
        queue.append(message)
        return [queue.pop(0)] if len(queue) > count else []

    return faulty
