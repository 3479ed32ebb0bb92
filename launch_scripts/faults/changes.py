"""Effects of faults on a message from the car to the controller, one function for each kind.

Each function returns the messages that arrive instead of the given one: none, one or many. They do
not depend on ROS; the offline loop and the injector node share them.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from launch_scripts.faults.messages import Memory, Message

HEADING_NOISE = 0.1
"""Standard deviation of the heading divided by that of the position [rad/m]."""


def delayed(message: Message, seconds: float) -> Message:
    """Delay a message by a time [s]."""
    return message._replace(arrival_ns=message.arrival_ns + round(seconds * NANOSECONDS))


def with_state(message: Message, **changes: float) -> list[Message]:
    """Replace fields of a state."""
    return [message._replace(value=message.value._replace(**changes))]


def drop(message: Message, memory: Memory) -> Sequence[Message]:
    """Drop each message with probability `amount`."""
    return [] if memory.rng.random() < memory.amount else [message]


def silence(message: Message, memory: Memory) -> Sequence[Message]:
    """Drop all messages, as if the sender had stopped."""
    return []


def delay(message: Message, memory: Memory) -> Sequence[Message]:
    """Delay every message by `amount` [s]."""
    return [delayed(message, memory.amount)]


def jitter(message: Message, memory: Memory) -> Sequence[Message]:
    """Delay every message by a random time up to `amount` [s], in order."""
    late = delayed(message, memory.amount * memory.rng.random())
    memory.latest_ns = max(memory.latest_ns, late.arrival_ns)
    return [late._replace(arrival_ns=memory.latest_ns)]


def reorder(message: Message, memory: Memory) -> Sequence[Message]:
    """Delay every message by a random time up to `amount` [s]; the order can change."""
    return [delayed(message, memory.amount * memory.rng.random())]


def duplicate(message: Message, memory: Memory) -> Sequence[Message]:
    """Deliver every message twice, the copy `amount` later [s]."""
    return [message, delayed(message, memory.amount)]


def hold(message: Message, memory: Memory) -> Sequence[Message]:
    """Hold all messages and deliver them at once at the end, as a full queue does."""
    return [message._replace(arrival_ns=max(memory.window.end_ns, message.arrival_ns))]


def burst(message: Message, memory: Memory) -> Sequence[Message]:
    """Deliver `amount` old messages again, at once, before the first new one."""
    old, count = list(memory.history.get(message.topic, ())), round(memory.amount)
    if memory.begun or not old:
        return [message]
    memory.begun = True
    again = [old[i % len(old)] for i in range(count)]
    return [*(each._replace(arrival_ns=message.arrival_ns) for each in again), message]


def repeat(message: Message, memory: Memory) -> Sequence[Message]:
    """Deliver the last message before the fault again and again."""
    return [memory.last(message)._replace(arrival_ns=message.arrival_ns)]


def freeze(message: Message, memory: Memory) -> Sequence[Message]:
    """Freeze the pose under new stamps; the twist stays current."""
    x, y, yaw = memory.last(message).value[1:4]
    return with_state(message, x=x, y=y, yaw=yaw)


def nan(message: Message, memory: Memory) -> Sequence[Message]:
    """Replace one field by NaN."""
    return with_state(message, **{memory.field: math.nan})


def noise(message: Message, memory: Memory) -> Sequence[Message]:
    """Add noise to position and heading; a negative amount gives the mirrored noise."""
    size, state = memory.amount, message.value
    x, y, yaw = memory.rng.standard_normal(3)
    yaw = wrap_angle(state.yaw + HEADING_NOISE * size * yaw)
    return with_state(message, x=state.x + abs(size) * x, y=state.y + size * y, yaw=yaw)


def moved_left(message: Message, left: float) -> list[Message]:
    """Move a pose to the left of its heading [m]."""
    state: VehicleState = message.value
    x, y = state.x - left * math.sin(state.yaw), state.y + left * math.cos(state.yaw)
    return with_state(message, x=x, y=y)


def shift(message: Message, memory: Memory) -> Sequence[Message]:
    """Move the position to the left by `amount` [m]."""
    return moved_left(message, memory.amount)


def drift(message: Message, memory: Memory) -> Sequence[Message]:
    """Move the position to the left, linearly up to `amount` [m]; it jumps back at the end."""
    return moved_left(message, memory.amount * memory.window.share(message.arrival_ns))


def bias_heading(message: Message, memory: Memory) -> Sequence[Message]:
    """Add `amount` to the heading [rad]."""
    return with_state(message, yaw=wrap_angle(message.value.yaw + memory.amount))


def bias_speed(message: Message, memory: Memory) -> Sequence[Message]:
    """Add `amount` to the speed [m/s]."""
    return with_state(message, v_x=message.value.v_x + memory.amount)


def wrong_frame(message: Message, memory: Memory) -> Sequence[Message]:
    """Replace the frame."""
    return [message._replace(frame_id="odom")]


def zero_quaternion(message: Message, memory: Memory) -> Sequence[Message]:
    """Replace the quaternion by zeros."""
    return [message._replace(length=0.0)]


def clock(message: Message, memory: Memory) -> Sequence[Message]:
    """Add `amount` to the stamps [s]."""
    return [message._replace(stamp_ns=message.stamp_ns + round(memory.amount * NANOSECONDS))]


def restart(message: Message, memory: Memory) -> Sequence[Message]:
    """Drop all messages; in the last `amount` seconds deliver them with stamps from zero."""
    back_ns = memory.window.end_ns - round(memory.amount * NANOSECONDS)
    if message.arrival_ns < back_ns:
        return []
    return [message._replace(stamp_ns=message.arrival_ns - back_ns)]


def bias_steering(message: Message, memory: Memory) -> Sequence[Message]:
    """Add `amount` to the measured steering angle [rad]."""
    return [message._replace(value=message.value + memory.amount)]


def freeze_steering(message: Message, memory: Memory) -> Sequence[Message]:
    """Freeze the measured steering angle under new stamps."""
    return [message._replace(value=memory.last(message).value)]


def with_points(message: Message, points: Array) -> list[Message]:
    """Replace the points of a path."""
    return [message._replace(value=points)]


def move_points(message: Message, left: Any) -> list[Message]:
    """Move each point of a path (n, 2) to the left of the path, by (n,) [m]."""
    along = np.gradient(message.value, axis=0)
    along /= np.hypot(*along.T)[:, None]
    normal = np.column_stack((-along[:, 1], along[:, 0]))
    return with_points(message, np.asarray(message.value + normal * left[:, None]))


def path_shift(message: Message, memory: Memory) -> Sequence[Message]:
    """Move the whole path to the left by `amount` [m]."""
    return move_points(message, np.full(len(message.value), memory.amount))


def path_step(message: Message, memory: Memory) -> Sequence[Message]:
    """Move the second half of the path to the left by `amount` [m]."""
    n = len(message.value)
    return move_points(message, memory.amount * (np.arange(n) > n / 2))


def path_zigzag(message: Message, memory: Memory) -> Sequence[Message]:
    """Move every second point of the path to the left by `amount` [m]; no car can follow it."""
    return move_points(message, memory.amount * (np.arange(len(message.value)) % 2))


def path_nan(message: Message, memory: Memory) -> Sequence[Message]:
    """Replace one coordinate of the path by NaN."""
    points = message.value.copy()
    points[len(points) // 2, 1] = math.nan
    return with_points(message, points)


def path_point(message: Message, memory: Memory) -> Sequence[Message]:
    """Keep only the first point of the path."""
    return with_points(message, message.value[:1])


def path_empty(message: Message, memory: Memory) -> Sequence[Message]:
    """Remove all points of the path."""
    return with_points(message, message.value[:0])
