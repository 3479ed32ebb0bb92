"""Bags for tests of the report: complete, old, of other controllers, and damaged."""

from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from ampc_msgs_config import ros
from ampc_msgs_config.recording.bag_writer import Recording
from ampc_msgs_config.recording.message_types import type_name_of
from ampc_msgs_config.types import NANOSECONDS, VehicleState

TICK_NS = NANOSECONDS // 10
Messages = dict[str, list[tuple[int, Any]]]
"""By topic: log time [ns] and message."""


def write_messages(bag: Path, topics: Messages) -> Path:
    """Write messages at their log times, one chunk per 20 messages."""
    with Recording(bag) as recording:
        for name, messages in topics.items():
            recording.add_topic(name, type_name_of(type(messages[0][1])), [ros.RELIABLE])
        rows = [(time, name, each) for name, found in topics.items() for time, each in found]
        for k, (time_ns, name, message) in enumerate(sorted(rows, key=lambda row: row[0])):
            recording.write(name, serialize_message(message), time_ns, time_ns)
            if k % 20 == 0:
                recording.flush()
    return bag


def straight_states(ticks: int, left: float = 0.1) -> list[VehicleState]:
    """Return states parallel to the x axis at 10 m/s, `left` of it [m]."""
    return [
        VehicleState(NANOSECONDS + k * TICK_NS, 1.0 * k, left, 0.0, 10.0, 0.0, 0.0)
        for k in range(ticks)
    ]


def odometry(states: list[VehicleState], offset_ns: int = 0) -> list[tuple[int, Any]]:
    """Return states as messages, logged by a clock that is ahead by `offset_ns`."""
    return [(s.stamp_ns + offset_ns, ros.odometry_message(s)) for s in states]


def road(y: float, time_ns: int) -> tuple[int, Any]:
    """Return a reference path parallel to the x axis."""
    return time_ns, ros.path_message(np.array([[-10.0, y], [200.0, y]]), time_ns)
