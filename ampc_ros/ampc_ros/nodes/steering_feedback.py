"""Measured steering angles in the message types of several cars, as `steering_state`.

The gate receives `steering_report`, whose type the parameter `feedback` selects, and publishes the
same angle as `steering_state`, so that controller, recorder and replay know one type.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros, topics
from ampc_ros.nodes.message_packages import import_message

NO_FEEDBACK = "none"
"""The car publishes `steering_state` itself, or measures nothing."""
JOINT_STATE = "joint_state"
REPORTS = {
    "autoware": ("autoware_vehicle_msgs", "SteeringReport", "steering_tire_angle", "stamp"),
    "ackermann": ("ackermann_msgs", "AckermannDrive", "steering_angle", ""),
    "ackermann_stamped": (
        "ackermann_msgs",
        "AckermannDriveStamped",
        "drive.steering_angle",
        "header.stamp",
    ),
}
"""Values of `feedback`: package, message, fields of angle and stamp."""
FEEDBACK = [NO_FEEDBACK, JOINT_STATE, *REPORTS]


class Feedback(NamedTuple):
    """Type of `steering_report`, and what a message of it means."""

    kind: Any
    """Message class."""
    position: Callable[[Any], float | None]
    """Position in a message, in the units of the steering topics; None: it is about others."""
    stamp: Callable[[Any], Time] | None
    """Stamp of a message; None: it has none."""

    def state(self, message: Any, now_ns: int) -> JointState | None:
        """Return a report as message of `steering_state`; None: it is about other joints.

        Args:
            message: Report.
            now_ns: Stamp where the report has none [ns].

        Raises:
            ValueError: The message lacks one of the joints.
        """
        position = self.position(message)
        if position is None:
            return None
        state = JointState(name=[topics.STEERING_JOINT], position=[position])
        state.header.stamp = self.stamp(message) if self.stamp else ros.time_message(now_ns)
        state.header.frame_id = topics.BASE_LINK
        return state


def choose_feedback(name: str, joints: str) -> Feedback | None:
    """Return the feedback that the parameters select; None: none.

    Args:
        name: One of FEEDBACK.
        joints: Joints of a JointState, joined by commas; empty: its only one.

    Raises:
        ValueError: The package of the message is missing.
    """
    if name == NO_FEEDBACK:
        return None
    if name == JOINT_STATE:
        names = [each.strip() for each in joints.split(",") if each.strip()]
        return Feedback(JointState, partial(mean_position, names=names), attrgetter("header.stamp"))
    package, message, angle, stamp = REPORTS[name]
    kind = import_message(package, message, f"feedback = {name}")
    return Feedback(kind, attrgetter(angle), attrgetter(stamp) if stamp else None)


def mean_position(message: JointState, names: Sequence[str]) -> float | None:
    """Return the mean position of the named joints, or that of the only one.

    The mean of both front wheels is the angle of the single-track model within 0.6 deg up to 30 deg
    where the track is at most 0.62 wheelbases. A message without any of the joints is about others:
    robots publish joints apart.

    Raises:
        ValueError: Not exactly one position without names, or only some of the joints.
    """
    if not names:
        return ros.only_position(message)
    found = {
        name: position
        for name, position in zip(message.name, message.position, strict=False)
        if name in names
    }
    if found and len(found) < len(names):
        missing = ", ".join(sorted(set(names) - set(found)))
        raise ValueError(
            f"steering_report: name must hold {', '.join(names)}; {missing} is missing"
        )
    return math.fsum(found.values()) / len(found) if found else None
