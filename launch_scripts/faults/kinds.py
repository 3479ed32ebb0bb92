"""Kinds of faults between a car and its controller: topics, effect, range of the amount.

An effect returns the messages that arrive instead of the given one: none, one or many. Effects do
not depend on ROS; the offline loop and the injector node share them.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from launch_scripts.faults.messages import (
    NODE,
    ODOM_INPUT,
    PATH,
    STEERING_INPUT,
    FaultState,
    Message,
)

HEADING_NOISE = 0.1
"""Standard deviation of the heading divided by that of the position [rad/m]."""
CAR, ALL = (ODOM_INPUT, STEERING_INPUT), (ODOM_INPUT, STEERING_INPUT, PATH)


class Amount(NamedTuple):
    """Default and range of the size of a fault."""

    default: float
    low: float
    high: float
    unit: str


class Kind(NamedTuple):
    """One kind of fault."""

    topics: tuple[str, ...]
    change: Callable[[Message, FaultState], Sequence[Message]] | None
    """None: the target has no messages."""
    amount: Amount | None = None
    sided: bool = False
    """True if the mirrored fault has the amount with the opposite sign."""


def seconds(default: float, low: float = 0.0, high: float = 10.0) -> Amount:
    """Return the range of a time [s]."""
    return Amount(default, low, high, "s")


def metres(default: float) -> Amount:
    """Return the range of a distance to the left [m]."""
    return Amount(default, -100.0, 100.0, "m")


def radians(default: float) -> Amount:
    """Return the range of an angle, positive to the left [rad]."""
    return Amount(default, -math.pi, math.pi, "rad")


def arriving(message: Message, arrival_ns: int) -> Message:
    """Return a message with another time of arrival [ns]."""
    return message._replace(arrival_ns=arrival_ns)


def late(message: Message, delay: float) -> Message:
    """Return a message delayed by a time [s]."""
    return arriving(message, message.arrival_ns + round(delay * NANOSECONDS))


def restamped(message: Message, stamp_ns: int) -> list[Message]:
    """Return a message with another stamp [ns]."""
    return [message._replace(stamp_ns=stamp_ns)]


def replace_value(message: Message, value: Any) -> list[Message]:
    """Return a message with another value."""
    return [message._replace(value=value)]


def replace_state(message: Message, **changes: float) -> list[Message]:
    """Return a message with changed fields of its state."""
    return replace_value(message, message.value._replace(**changes))


def in_order(message: Message, fault: FaultState) -> list[Message]:
    """Delay a message by a random time, but not behind an earlier one."""
    delayed = late(message, fault.amount * fault.rng.random())
    fault.latest_ns = max(fault.latest_ns, delayed.arrival_ns)
    return [arriving(delayed, fault.latest_ns)]


def burst(message: Message, fault: FaultState) -> list[Message]:
    """Repeat old messages, at once, before the first new one."""
    old, n = list(fault.history.get(message.topic, ())), round(fault.amount)
    if fault.begun or not old:
        return [message]
    fault.begun = True
    return [*(arriving(old[i % len(old)], message.arrival_ns) for i in range(n)), message]


def restart(message: Message, fault: FaultState) -> list[Message]:
    """Drop all messages; in the last `amount` seconds deliver them with stamps from zero."""
    back_ns = fault.window.end_ns - round(fault.amount * NANOSECONDS)
    return restamped(message, message.arrival_ns - back_ns) * (message.arrival_ns >= back_ns)


def freeze(message: Message, fault: FaultState) -> list[Message]:
    """Freeze the pose under new stamps; the twist stays current."""
    x, y, yaw = fault.last(message).value[1:4]
    return replace_state(message, x=x, y=y, yaw=yaw)


def noise(message: Message, fault: FaultState) -> list[Message]:
    """Add noise to position and heading; a negative amount results in the mirrored noise."""
    size, state = fault.amount, message.value
    x, y, yaw = fault.rng.standard_normal(3)
    yaw = wrap_angle(state.yaw + HEADING_NOISE * size * yaw)
    return replace_state(message, x=state.x + abs(size) * x, y=state.y + size * y, yaw=yaw)


def shift(message: Message, left: float) -> list[Message]:
    """Move a pose to the left of its heading [m]."""
    state: VehicleState = message.value
    x, y = state.x - left * math.sin(state.yaw), state.y + left * math.cos(state.yaw)
    return replace_state(message, x=x, y=y)


def shift_points(message: Message, left: Any) -> list[Message]:
    """Move each point of a path (n, 2) to the left of the path, by (n,) [m]."""
    along = np.gradient(message.value, axis=0)
    along /= np.hypot(*along.T)[:, None]
    normal = np.column_stack((-along[:, 1], along[:, 0]))
    return replace_value(message, np.asarray(message.value + normal * left[:, None]))


def indices(message: Message) -> Array:
    """Return the indices of the points of a path (n,)."""
    return np.arange(len(message.value), dtype=float)


def path_nan(message: Message, fault: FaultState) -> list[Message]:
    """Replace one coordinate of the path by NaN."""
    points = message.value.copy()
    points[len(points) // 2, 1] = math.nan
    return replace_value(message, points)


def shift_stamp(message: Message, fault: FaultState) -> list[Message]:
    """Add `amount` to the stamp [s]."""
    return restamped(message, message.stamp_ns + round(fault.amount * NANOSECONDS))


CLOCK_JUMP = seconds(1.0, -1.0e4, 1.0e4)
FAULT_KINDS = {
    # messages are lost, late, doubled or repeated
    "drop": Kind(
        (ODOM_INPUT,),
        lambda m, f: [] if f.rng.random() < f.amount else [m],
        Amount(1.0, 0.0, 1.0, ""),  # probability
    ),
    "silence": Kind(CAR, lambda m, f: []),
    "restart": Kind(ALL, restart, seconds(0.3)),
    "delay": Kind((ODOM_INPUT,), lambda m, f: [late(m, f.amount)], seconds(0.15)),
    "jitter": Kind((ODOM_INPUT,), in_order, seconds(0.2)),
    "reorder": Kind((ODOM_INPUT,), lambda m, f: [late(m, f.amount * f.rng.random())], seconds(0.2)),
    "duplicate": Kind((ODOM_INPUT,), lambda m, f: [m, late(m, f.amount)], seconds(0.01)),
    "hold": Kind((ODOM_INPUT,), lambda m, f: [arriving(m, max(f.window.end_ns, m.arrival_ns))]),
    "burst": Kind((ODOM_INPUT,), burst, Amount(1000, 1, 100_000, "messages")),
    "repeat": Kind((ODOM_INPUT,), lambda m, f: [arriving(f.last(m), m.arrival_ns)]),
    # states with wrong values
    "freeze": Kind((ODOM_INPUT,), freeze),
    "nan": Kind((ODOM_INPUT,), lambda m, f: replace_state(m, **{f.field: math.nan})),
    "noise": Kind((ODOM_INPUT,), noise, metres(0.1), sided=True),
    "bias_position": Kind((ODOM_INPUT,), lambda m, f: shift(m, f.amount), metres(0.3), sided=True),
    "bias_heading": Kind(
        (ODOM_INPUT,),
        lambda m, f: replace_state(m, yaw=wrap_angle(m.value.yaw + f.amount)),
        radians(0.05),
        sided=True,
    ),
    "bias_speed": Kind(
        (ODOM_INPUT,),
        lambda m, f: replace_state(m, v_x=m.value.v_x + f.amount),
        Amount(2.0, -100.0, 100.0, "m/s"),
    ),
    "drift": Kind(  # linearly up to `amount`, then back at once
        (ODOM_INPUT,), lambda m, f: shift(m, f.amount * f.elapsed(m)), metres(1.0), sided=True
    ),
    "pose_jump": Kind((ODOM_INPUT,), lambda m, f: shift(m, f.amount), metres(2.0), sided=True),
    "wrong_frame": Kind((ODOM_INPUT,), lambda m, f: [m._replace(frame_id="odom")]),
    "zero_quaternion": Kind((ODOM_INPUT,), lambda m, f: [m._replace(length=0.0)]),
    "stamp_jump": Kind((ODOM_INPUT,), shift_stamp, CLOCK_JUMP),
    "clock_jump": Kind(ALL, shift_stamp, CLOCK_JUMP),
    # steering sensor and solver
    "bias_steering": Kind(
        (STEERING_INPUT,),
        lambda m, f: replace_value(m, m.value + f.amount),
        radians(0.05),
        sided=True,
    ),
    "freeze_steering": Kind((STEERING_INPUT,), lambda m, f: replace_value(m, f.last(m).value)),
    "qp_fault": Kind((NODE,), None),
    # paths: moved, with a step in the middle, with every second point aside, unusable
    "path_gone": Kind((PATH,), lambda m, f: []),
    "path_shift": Kind(
        (PATH,),
        lambda m, f: shift_points(m, np.full(len(m.value), f.amount)),
        metres(2.0),
        sided=True,
    ),
    "path_step": Kind(
        (PATH,),
        lambda m, f: shift_points(m, f.amount * (indices(m) > len(m.value) / 2)),
        metres(2.0),
        sided=True,
    ),
    "path_zigzag": Kind(
        (PATH,), lambda m, f: shift_points(m, f.amount * (indices(m) % 2)), metres(1.0), sided=True
    ),
    "path_nan": Kind((PATH,), path_nan),
    "path_point": Kind((PATH,), lambda m, f: replace_value(m, m.value[:1])),
    "path_empty": Kind((PATH,), lambda m, f: replace_value(m, m.value[:0])),
}
"""Kinds by the name in a file of faults. `clock_jump` also moves the controller's own clock."""
