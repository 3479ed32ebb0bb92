"""What can go wrong between a car and its controller: each kind of fault is one small function.

A kind turns one message into those that arrive instead: none, one, or a thousand. It knows nothing
of ROS; the offline loop and the node between simulator and controller share it.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.path import Array
from ampc_msgs_config.types import NANOSECONDS, VehicleState, wrap_angle
from launch_scripts.fault_messages import NODE, ODOM, PATH, STEERING, Memory, Message

HEADING_NOISE = 0.1
"""Of the heading, per noise of the position [rad/m]."""

Change = Callable[[Message, Memory], Sequence[Message]]


def later(message: Message, seconds: float) -> Message:
    """Let a message come in later [s]."""
    return message._replace(arrival_ns=message.arrival_ns + round(seconds * NANOSECONDS))


def with_state(message: Message, **changes: float) -> list[Message]:
    """Change numbers of a state."""
    return [message._replace(value=message.value._replace(**changes))]


def drop(message: Message, memory: Memory) -> Sequence[Message]:
    """Lose messages, each with the probability `amount`."""
    return [] if memory.rng.random() < memory.amount else [message]


def silence(message: Message, memory: Memory) -> Sequence[Message]:
    """Lose all: the peer is gone."""
    return []


def delay(message: Message, memory: Memory) -> Sequence[Message]:
    """Let everything come in later."""
    return [later(message, memory.amount)]


def jitter(message: Message, memory: Memory) -> Sequence[Message]:
    """Let everything come in later, by chance, in order."""
    late = later(message, memory.amount * memory.rng.random())
    memory.latest_ns = max(memory.latest_ns, late.arrival_ns)
    return [late._replace(arrival_ns=memory.latest_ns)]


def reorder(message: Message, memory: Memory) -> Sequence[Message]:
    """Let everything come in later, by chance: messages overtake each other."""
    return [later(message, memory.amount * memory.rng.random())]


def duplicate(message: Message, memory: Memory) -> Sequence[Message]:
    """Let everything come in twice."""
    return [message, later(message, memory.amount)]


def hold(message: Message, memory: Memory) -> Sequence[Message]:
    """Keep everything back, then let it come in at once: a full queue that empties itself."""
    return [message._replace(arrival_ns=max(memory.window.end_ns, message.arrival_ns))]


def burst(message: Message, memory: Memory) -> Sequence[Message]:
    """Let old messages come in once more, all at once, before a new one."""
    old, count = list(memory.history.get(message.topic, ())), round(memory.amount)
    if memory.begun or not old:
        return [message]
    memory.begun = True
    again = [old[i % len(old)] for i in range(count)]
    return [*(each._replace(arrival_ns=message.arrival_ns) for each in again), message]


def repeat(message: Message, memory: Memory) -> Sequence[Message]:
    """Let the last message come in again and again."""
    return [memory.last(message)._replace(arrival_ns=message.arrival_ns)]


def freeze(message: Message, memory: Memory) -> Sequence[Message]:
    """Hold the pose, under new stamps; the twist goes on."""
    x, y, yaw = memory.last(message).value[1:4]
    return with_state(message, x=x, y=y, yaw=yaw)


def nan(message: Message, memory: Memory) -> Sequence[Message]:
    """Break one number."""
    return with_state(message, **{memory.field: math.nan})


def noise(message: Message, memory: Memory) -> Sequence[Message]:
    """Shake position and heading; a negative amount is the mirror image of the same shaking."""
    size, state = memory.amount, message.value
    x, y, yaw = memory.rng.standard_normal(3)
    yaw = wrap_angle(state.yaw + HEADING_NOISE * size * yaw)
    return with_state(message, x=state.x + abs(size) * x, y=state.y + size * y, yaw=yaw)


def shifted(message: Message, left: float) -> list[Message]:
    """Move a pose to the left of where the car heads [m]."""
    state: VehicleState = message.value
    x, y = state.x - left * math.sin(state.yaw), state.y + left * math.cos(state.yaw)
    return with_state(message, x=x, y=y)


def shift(message: Message, memory: Memory) -> Sequence[Message]:
    """Move the position aside, from one message to the next."""
    return shifted(message, memory.amount)


def drift(message: Message, memory: Memory) -> Sequence[Message]:
    """Move the position aside, more and more; at the end it jumps back."""
    return shifted(message, memory.amount * memory.window.share(message.arrival_ns))


def bias_heading(message: Message, memory: Memory) -> Sequence[Message]:
    """Turn the heading."""
    return with_state(message, yaw=wrap_angle(message.value.yaw + memory.amount))


def bias_speed(message: Message, memory: Memory) -> Sequence[Message]:
    """Add to the speed."""
    return with_state(message, v_x=message.value.v_x + memory.amount)


def wrong_frame(message: Message, memory: Memory) -> Sequence[Message]:
    """Tell everything in another frame."""
    return [message._replace(frame_id="odom")]


def zero_quaternion(message: Message, memory: Memory) -> Sequence[Message]:
    """Leave the orientation empty."""
    return [message._replace(length=0.0)]


def clock(message: Message, memory: Memory) -> Sequence[Message]:
    """Let stamps come from a clock that goes wrong."""
    return [message._replace(stamp_ns=message.stamp_ns + round(memory.amount * NANOSECONDS))]


def restart(message: Message, memory: Memory) -> Sequence[Message]:
    """Lose all; in the last `amount` seconds, let stamps count from zero."""
    back_ns = memory.window.end_ns - round(memory.amount * NANOSECONDS)
    if message.arrival_ns < back_ns:
        return []
    return [message._replace(stamp_ns=message.arrival_ns - back_ns)]


def bias_steering(message: Message, memory: Memory) -> Sequence[Message]:
    """Add to the measured steering."""
    return [message._replace(value=message.value + memory.amount)]


def freeze_steering(message: Message, memory: Memory) -> Sequence[Message]:
    """Hold the measured steering, under new stamps."""
    return [message._replace(value=memory.last(message).value)]


def with_points(message: Message, points: Array) -> list[Message]:
    """Change a path."""
    return [message._replace(value=points)]


def to_the_left(points: Array, left: Any) -> Array:
    """Move each point of a path (n, 2) to its left, by (n,) [m]."""
    along = np.gradient(points, axis=0)
    along /= np.hypot(*along.T)[:, None]
    return np.asarray(points + np.column_stack((-along[:, 1], along[:, 0])) * left[:, None])


def path_shift(message: Message, memory: Memory) -> Sequence[Message]:
    """Move the whole path aside."""
    return with_points(
        message, to_the_left(message.value, np.full(len(message.value), memory.amount))
    )


def path_step(message: Message, memory: Memory) -> Sequence[Message]:
    """Move the second half of the path aside: a step in the middle."""
    n = len(message.value)
    return with_points(message, to_the_left(message.value, memory.amount * (np.arange(n) > n / 2)))


def path_zigzag(message: Message, memory: Memory) -> Sequence[Message]:
    """Move every other point of the path aside: bends that no car can drive."""
    n = len(message.value)
    return with_points(message, to_the_left(message.value, memory.amount * (np.arange(n) % 2)))


def path_nan(message: Message, memory: Memory) -> Sequence[Message]:
    """Break one number of the path."""
    points = message.value.copy()
    points[len(points) // 2, 1] = math.nan
    return with_points(message, points)


def path_point(message: Message, memory: Memory) -> Sequence[Message]:
    """Leave one point of the path."""
    return with_points(message, message.value[:1])


def path_empty(message: Message, memory: Memory) -> Sequence[Message]:
    """Leave no point of the path."""
    return with_points(message, message.value[:0])


class Amount(NamedTuple):
    """How much of a fault there is."""

    default: float
    low: float
    high: float
    unit: str


class Kind(NamedTuple):
    """One kind of fault."""

    change: Change | None
    """None: what it befalls has no messages."""
    topics: tuple[str, ...]
    amount: Amount | None = None
    sided: bool = False
    """Whether the mirror image has the amount with the other sign."""


CAR, ALL = (ODOM, STEERING), (ODOM, STEERING, PATH)
PROBABILITY = Amount(1.0, 0.0, 1.0, "")


def late(default: float) -> Amount:
    """Declare a time by which messages come later."""
    return Amount(default, 0.0, 10.0, "s")


def beside(default: float) -> Amount:
    """Declare a distance to the left."""
    return Amount(default, -100.0, 100.0, "m")


def radians(default: float) -> Amount:
    """Declare an angle to the left."""
    return Amount(default, -math.pi, math.pi, "rad")


CLOCK = Amount(1.0, -1.0e4, 1.0e4, "s")

KINDS = {
    "drop": Kind(drop, (ODOM,), PROBABILITY),
    "silence": Kind(silence, CAR),
    "restart": Kind(restart, ALL, late(0.3)),
    "delay": Kind(delay, (ODOM,), late(0.15)),
    "jitter": Kind(jitter, (ODOM,), late(0.2)),
    "reorder": Kind(reorder, (ODOM,), late(0.2)),
    "duplicate": Kind(duplicate, (ODOM,), late(0.01)),
    "hold": Kind(hold, (ODOM,)),
    "burst": Kind(burst, (ODOM,), Amount(1000, 1, 100_000, "messages")),
    "repeat": Kind(repeat, (ODOM,)),
    "freeze": Kind(freeze, (ODOM,)),
    "nan": Kind(nan, (ODOM,)),
    "noise": Kind(noise, (ODOM,), beside(0.1), sided=True),
    "bias_position": Kind(shift, (ODOM,), beside(0.3), sided=True),
    "bias_heading": Kind(bias_heading, (ODOM,), radians(0.05), sided=True),
    "bias_speed": Kind(bias_speed, (ODOM,), Amount(2.0, -100.0, 100.0, "m/s")),
    "drift": Kind(drift, (ODOM,), beside(1.0), sided=True),
    "pose_jump": Kind(shift, (ODOM,), beside(2.0), sided=True),
    "wrong_frame": Kind(wrong_frame, (ODOM,)),
    "zero_quaternion": Kind(zero_quaternion, (ODOM,)),
    "stamp_jump": Kind(clock, (ODOM,), CLOCK),
    "clock_jump": Kind(clock, ALL, CLOCK),
    "bias_steering": Kind(bias_steering, (STEERING,), radians(0.05), sided=True),
    "freeze_steering": Kind(freeze_steering, (STEERING,)),
    "qp_fault": Kind(None, (NODE,)),
    "path_gone": Kind(silence, (PATH,)),
    "path_shift": Kind(path_shift, (PATH,), beside(2.0), sided=True),
    "path_step": Kind(path_step, (PATH,), beside(2.0), sided=True),
    "path_zigzag": Kind(path_zigzag, (PATH,), beside(1.0), sided=True),
    "path_nan": Kind(path_nan, (PATH,)),
    "path_point": Kind(path_point, (PATH,)),
    "path_empty": Kind(path_empty, (PATH,)),
}
"""By the name that a user types. `clock_jump` moves the controller's own clock as well."""
