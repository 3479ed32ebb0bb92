"""Angles, quaternions, and the point that a vehicle state describes; compiled."""

import math

import numpy as np

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.quaternions import quaternion_of, yaw_of
from ampc_msgs_config.types import VehicleState


@compiled
def wrap_angle(angle: float) -> float:
    """Return the same direction in [-pi, pi] [rad].

    Note:
        math.remainder does not exist in compiled code. Up to 3 pi this gives the same number;
        beyond it is exact to the rounding of the whole turns, as the angle itself is.
    """
    turns: float = np.rint(angle / math.tau)
    return angle - math.tau * turns


quaternion_from_yaw = compiled(quaternion_of)
"""`quaternions.quaternion_of`, compiled."""
yaw_from_quaternion = compiled(yaw_of)
"""`quaternions.yaw_of`, compiled."""


@compiled
def as_received(state: VehicleState) -> VehicleState:
    """Return the state as a subscriber receives it, with the heading converted by a quaternion."""
    stamp_ns, x, y, yaw, v_x, v_y, yaw_rate = state
    z, w = quaternion_from_yaw(yaw)
    yaw = yaw_from_quaternion(0.0, 0.0, z, w)
    return VehicleState(stamp_ns, x, y, yaw, v_x, v_y, yaw_rate)


@compiled
def at_distance(state: VehicleState, distance: float) -> VehicleState:
    """Move the point that a state describes forward along the body's x axis by `distance` [m]."""
    stamp_ns, x, y, yaw, v_x, v_y, yaw_rate = state
    x += distance * math.cos(yaw)
    y += distance * math.sin(yaw)
    return VehicleState(stamp_ns, x, y, yaw, v_x, v_y + distance * yaw_rate, yaw_rate)
