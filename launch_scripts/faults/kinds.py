"""Kinds of faults between a car and its controller: effect, topics and range of the amount."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from launch_scripts.faults import changes
from launch_scripts.faults.messages import NODE, ODOM, PATH, STEERING, Memory, Message

Change = Callable[[Message, Memory], Sequence[Message]]


class Amount(NamedTuple):
    """Default and range of the size of a fault."""

    default: float
    low: float
    high: float
    unit: str


class Kind(NamedTuple):
    """One kind of fault."""

    change: Change | None
    """None: the target has no messages."""
    topics: tuple[str, ...]
    amount: Amount | None = None
    sided: bool = False
    """True if the mirrored fault has the amount with the opposite sign."""


CAR, ALL = (ODOM, STEERING), (ODOM, STEERING, PATH)
PROBABILITY = Amount(1.0, 0.0, 1.0, "")


def seconds(default: float) -> Amount:
    """Return the range of a delay [s]."""
    return Amount(default, 0.0, 10.0, "s")


def metres(default: float) -> Amount:
    """Return the range of a distance to the left [m]."""
    return Amount(default, -100.0, 100.0, "m")


def radians(default: float) -> Amount:
    """Return the range of an angle, positive to the left [rad]."""
    return Amount(default, -math.pi, math.pi, "rad")


CLOCK = Amount(1.0, -1.0e4, 1.0e4, "s")

KINDS = {
    "drop": Kind(changes.drop, (ODOM,), PROBABILITY),
    "silence": Kind(changes.silence, CAR),
    "restart": Kind(changes.restart, ALL, seconds(0.3)),
    "delay": Kind(changes.delay, (ODOM,), seconds(0.15)),
    "jitter": Kind(changes.jitter, (ODOM,), seconds(0.2)),
    "reorder": Kind(changes.reorder, (ODOM,), seconds(0.2)),
    "duplicate": Kind(changes.duplicate, (ODOM,), seconds(0.01)),
    "hold": Kind(changes.hold, (ODOM,)),
    "burst": Kind(changes.burst, (ODOM,), Amount(1000, 1, 100_000, "messages")),
    "repeat": Kind(changes.repeat, (ODOM,)),
    "freeze": Kind(changes.freeze, (ODOM,)),
    "nan": Kind(changes.nan, (ODOM,)),
    "noise": Kind(changes.noise, (ODOM,), metres(0.1), sided=True),
    "bias_position": Kind(changes.shift, (ODOM,), metres(0.3), sided=True),
    "bias_heading": Kind(changes.bias_heading, (ODOM,), radians(0.05), sided=True),
    "bias_speed": Kind(changes.bias_speed, (ODOM,), Amount(2.0, -100.0, 100.0, "m/s")),
    "drift": Kind(changes.drift, (ODOM,), metres(1.0), sided=True),
    "pose_jump": Kind(changes.shift, (ODOM,), metres(2.0), sided=True),
    "wrong_frame": Kind(changes.wrong_frame, (ODOM,)),
    "zero_quaternion": Kind(changes.zero_quaternion, (ODOM,)),
    "stamp_jump": Kind(changes.clock, (ODOM,), CLOCK),
    "clock_jump": Kind(changes.clock, ALL, CLOCK),
    "bias_steering": Kind(changes.bias_steering, (STEERING,), radians(0.05), sided=True),
    "freeze_steering": Kind(changes.freeze_steering, (STEERING,)),
    "qp_fault": Kind(None, (NODE,)),
    "path_gone": Kind(changes.silence, (PATH,)),
    "path_shift": Kind(changes.path_shift, (PATH,), metres(2.0), sided=True),
    "path_step": Kind(changes.path_step, (PATH,), metres(2.0), sided=True),
    "path_zigzag": Kind(changes.path_zigzag, (PATH,), metres(1.0), sided=True),
    "path_nan": Kind(changes.path_nan, (PATH,)),
    "path_point": Kind(changes.path_point, (PATH,)),
    "path_empty": Kind(changes.path_empty, (PATH,)),
}
"""Kinds by the name in a file of faults. `clock_jump` also moves the controller's own clock."""
