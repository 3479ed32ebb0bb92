"""Paths that no planner sends, for a controller that drives."""

import math
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from nav_msgs.msg import Path
from rclpy.serialization import serialize_message

from ampc_msgs_config import ros
from ampc_msgs_config.types import Array
from tests.workshop.attacks.attempts import Attempt, Choice
from tests.workshop.attacks.auditor import RADIUS
from tests.workshop.attacks.live import Session, attacks_on, parameters_of

WATCHED = 1.2
"""Time for which a path is offered [s]."""
MANY = 100_000
"""Points of the largest path."""


def attempts(choice: Choice) -> Iterator[Attempt]:
    """Publish all kinds of hostile paths."""
    attacks: dict[str, Callable[[Session], object]] = {
        name: publishing(points) for name, points in roads(choice).items()
    }
    attacks |= {f"changed: {name}": changing(change) for name, change in changes().items()}
    rng = choice.rng("bytes")
    for share in (0.1, 0.5, 0.9):
        attacks[f"bytes cut at {share:g}"] = raw(partial(cut, share))
    attacks["bytes random"] = raw(lambda data: data[:4] + rng.randbytes(2000))
    attacks["bytes none"] = raw(lambda _: b"")
    attacks["bytes flipped"] = raw(lambda data: flipped(data, rng.randrange(8 * len(data))))
    attacks["flood"] = flood
    return attacks_on(choice, attacks, parameters_of())


def roads(choice: Choice) -> dict[str, Array]:
    """Return the points of hostile paths, by name."""
    s = np.linspace(0.0, 1.0, 400)
    rng = np.random.default_rng(choice.rng("roads").randrange(2**31))
    turn = 2.0 * math.pi * s
    circle = RADIUS * np.column_stack((np.sin(turn), 1.0 - np.cos(turn)))
    along = np.arange(MANY) * 0.1
    return {
        "empty": np.zeros((0, 2)),
        "one point": np.zeros((1, 2)),
        "two equal points": np.zeros((2, 2)),
        "all points equal": np.ones((500, 2)),
        "points 1e300 m apart": np.array([[0.0, 0.0], [1e300, 0.0], [2e300, 0.0]]),
        "100,000 points": np.column_stack((along, np.zeros(MANY))),
        "random points": rng.uniform(-50.0, 50.0, (300, 2)),
        "noise of 1 m": circle + rng.normal(0.0, 1.0, circle.shape),
        "cusp": np.column_stack((60.0 * np.abs(s - 0.5), 0.0 * s)),
        "hairpin": np.column_stack((60.0 * np.abs(s - 0.5), np.where(s < 0.5, 0.0, 0.5))),
        "loops of 1 m": np.column_stack((np.sin(40.0 * s), np.cos(40.0 * s))),
        "figure eight": RADIUS * np.column_stack((np.sin(turn), np.sin(2.0 * turn))),
        "reversed circle": circle[::-1],
        "circle 5 m aside": circle + np.array([0.0, 5.0]),
        "path far away": circle + 1e6,
    }


def changes() -> dict[str, Callable[[Path], object]]:
    """Return changes of the circle, by name."""

    def position(value: float) -> Callable[[Path], object]:
        return lambda path: setattr(path.poses[7].pose.position, "x", value)

    return {
        "nan": position(math.nan),
        "inf": position(math.inf),
        "1e308": position(1e308),
        "no frame": lambda path: setattr(path.header, "frame_id", ""),
        "another frame": lambda path: setattr(path.header, "frame_id", "nowhere"),
        "frame of a pose": lambda path: setattr(path.poses[3], "header", other_header()),
        "stamp in the future": lambda path: setattr(path.header.stamp, "sec", 2**31 - 1),
        "stamp negative": lambda path: setattr(path.header.stamp, "sec", -(2**31)),
    }


def other_header() -> object:
    """Return the header of a pose in another frame."""
    header = Path().header
    header.frame_id = "other"
    return header


def message_of(live: Session, points: Array) -> Path:
    """Return a path of points, also of those that are no path."""
    if len(points) > 1:
        return ros.path_message(points, live.auditor.now_ns)
    path = ros.path_message(np.eye(2), live.auditor.now_ns)
    path.poses = path.poses[: len(points)]
    return path


def circle_of(live: Session) -> Path:
    """Return the path of the auditor as a message."""
    return live.auditor.path_message()


def publishing(points: Array) -> Callable[[Session], object]:
    """Return an attack by a path; the circle follows it."""
    return raw(lambda _: b"", points)


def changing(change: Callable[[Path], object]) -> Callable[[Session], object]:
    """Return an attack by a change of the circle; the circle follows it."""

    def attack(live: Session) -> None:
        path = circle_of(live)
        change(path)
        offer(live, serialize_message(path))

    return attack


def raw(
    change: Callable[[bytes], bytes], points: Array | None = None
) -> Callable[[Session], object]:
    """Return an attack by the changed bytes of the circle, or by those of points."""

    def attack(live: Session) -> None:
        if points is None:
            data = change(serialize_message(circle_of(live)))
        else:
            data = serialize_message(message_of(live, points))
        live.auditor.forget()  # to serialise a large path takes time
        live.auditor.due = time.monotonic()
        offer(live, data)

    return attack


def offer(live: Session, data: bytes) -> None:
    """Publish a serialised path, and the circle after it."""
    live.auditor.path.publish(data)
    live.auditor.run(WATCHED)
    live.auditor.publish_path()


def cut(share: float, data: bytes) -> bytes:
    """Return the beginning of bytes."""
    return data[: int(share * len(data))]


def flipped(data: bytes, bit: int) -> bytes:
    """Return bytes with one wrong bit."""
    content = bytearray(data)
    content[bit // 8] ^= 1 << bit % 8
    return bytes(content)


def flood(live: Session) -> None:
    """Publish the circle as often as possible."""
    data = serialize_message(circle_of(live))
    for _ in range(100):
        live.auditor.path.publish(data)
        live.auditor.run(0.01)
