"""Fuzzing of the node's core with extreme ROS messages."""

import math
from collections import Counter
from typing import Any

import numpy as np

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS
from tests.workshop.fuzz.fuzz_core import Core, throw_all
from tests.workshop.fuzz.fuzz_guard import Violation
from tests.workshop.fuzz.fuzz_road import Road

KINDS = {"state": 0.45, "tick": 0.4, "steering": 0.1, "path": 0.05}
"""Shares of the messages; `tick` is the timer."""
FRAMES = ("", "odom", "MAP", "/map", "map\0", "\0", "m" * 10_000, "k\u00e4rt", "\U0001f697")
"""Frames other than `map`."""
ODD = 0.05
"""Share of the messages with one change."""


class Messages:
    """Random messages for a core, mostly valid."""

    def __init__(self, core: Core) -> None:
        """Use the road of the core."""
        self.core, self.rng = core, core.road.rng

    def throw(self, kind: str) -> None:
        """Unpack one message and pass it to the core.

        Raises:
            ValueError: The message is rejected by either.
        """
        now_ns, supervisor = self.core.road.time(), self.core.supervisor
        if kind == "state":
            state = ros.vehicle_state(self.odometry())
            if not all(map(math.isfinite, state)):
                raise Violation(f"{state} was unpacked")
            self.core.take_state(state, now_ns)
        elif kind == "path":
            message = self.path()
            stamp_ns = ros.nanoseconds(message.header.stamp)
            supervisor.take_path(ros.path_points(message), stamp_ns, now_ns)
        elif kind == "steering":
            angle = ros.steering_angle(self.steering()).value
            if not math.isfinite(angle):
                raise Violation(f"the angle {angle!r} was unpacked")
            supervisor.take_steering(angle)
        else:
            self.core.tick(now_ns)

    def odometry(self) -> Any:
        """Return a state message, rarely with an extreme number, quaternion or header."""
        state = self.core.road.odom()
        sound = all(map(math.isfinite, state)) and -(2**31) <= state.stamp_ns // NANOSECONDS < 2**31
        message = ros.odometry_message(state if sound else self.core.road.state)
        if self.rng.random() >= ODD:
            return message
        q, twist = message.pose.pose.orientation, message.twist.twist
        owners = (message.pose.pose.position, q, twist.linear, twist.angular)
        owner = owners[int(self.rng.integers(len(owners)))]
        if self.rng.random() < 0.2:
            q.x = q.y = q.z = q.w = 0.0
        setattr(owner, str(self.rng.choice(["x", "y", "z"])), self.core.road.number(0.0, 1.0))
        return self.odd_header(message)

    def path(self) -> Any:
        """Return a path message, rarely with extreme positions or headers."""
        points = self.core.road.road()
        shape = np.array(points, dtype=float).reshape(-1, 2)
        if len(points) < 2 or not np.isfinite(shape).all():
            message = ros.path_message(np.zeros((2, 2)), self.core.road.now_ns)
            for pose, (x, y) in zip(message.poses, points, strict=False):
                pose.pose.position.x, pose.pose.position.y = x, y
            message.poses = message.poses[: len(points)]
        else:
            message = ros.path_message(shape, self.core.road.now_ns)
        if message.poses and self.rng.random() < ODD:
            pose = message.poses[int(self.rng.integers(len(message.poses)))]
            pose.pose.position.y = self.core.road.number(0.0, 1.0)
            self.odd_header(pose)
        return self.odd_header(message) if self.rng.random() < ODD else message

    def steering(self) -> Any:
        """Return a steering message, rarely without, with several, or with an extreme angle."""
        message = ros.joint_message(self.core.road.now_ns, self.core.supervisor.steering, 0.0)
        if self.rng.random() < 2 * ODD:
            count = int(self.rng.integers(0, 4))
            message.position = [self.core.road.number(0.0, 0.3) for _ in range(count)]
            message.name = [str(name) for name in self.rng.choice(FRAMES, count)]
        return message

    def odd_header(self, message: Any) -> Any:
        """Change frame or stamp of half of the messages."""
        chance = self.rng.random()
        if chance < 0.25:
            message.header.frame_id = FRAMES[int(self.rng.integers(len(FRAMES)))]
        elif chance < 0.5:
            message.header.stamp.sec = int(self.rng.choice([-(2**31), -1, 0, 2**31 - 1]))
            message.header.stamp.nanosec = int(self.rng.choice([0, 2**32 - 1]))
        return message


def message_drive(seed: int, drive: int, count: int) -> Counter[str]:
    """Send messages to the core in one drive; see `throw_all`.

    Args:
        seed: Seed of all drives.
        drive: Number of this drive; seed and number determine the messages.
        count: Number of messages.
    """
    core = Core(Road([seed, drive, len(KINDS)]))
    kinds = core.road.rng.choice(list(KINDS), p=list(KINDS.values()), size=count)
    return throw_all(core, kinds.tolist(), Messages(core).throw)
