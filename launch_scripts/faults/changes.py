"""What a fault does to a message on its way from a car to its controller: one small function each.

It turns one message into those that arrive instead: none, one, or a thousand. It knows nothing of
ROS; the offline loop and the node between simulator and controller share it.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from launch_scripts.faults.messages import Memory, Message

HEADING_NOISE = 0.1
"""Of the heading, per noise of the position [rad/m]."""


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
