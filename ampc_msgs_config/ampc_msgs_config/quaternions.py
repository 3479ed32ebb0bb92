"""Angles of quaternions, without compiled code: a process that only converts needs no compiler."""

import math


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """Return the yaw of a quaternion in the z-y-x convention, in [-pi, pi] [rad]."""
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def quaternion_of(yaw: float) -> tuple[float, float]:
    """Return the z and w components of the unit quaternion of a rotation about z."""
    return math.sin(yaw / 2), math.cos(yaw / 2)


def tilt_from_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float]:
    """Return roll and pitch of a quaternion in the z-y-x convention [rad]."""
    length = x * x + y * y + z * z + w * w
    roll = math.atan2(2 * (w * x + y * z), w * w + z * z - x * x - y * y)
    return roll, math.asin(min(max(2 * (w * y - z * x) / length, -1.0), 1.0))
