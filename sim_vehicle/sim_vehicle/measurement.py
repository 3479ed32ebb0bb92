"""Measured state of the simulated car."""

from typing import NamedTuple

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.types import Array, VehicleState


class Deviations(NamedTuple):
    """Standard deviations, `astuple` of MeasurementNoise."""

    position: float
    heading: float
    yaw_rate: float
    lateral_velocity: float
    speed: float


@in_place
def measured(state: Array, to_rear_axle: float, stamp_ns: int) -> VehicleState:
    """Return the exact motion at `base_link`, the centre of the rear axle.

    Args:
        state: (SIZE,) state of the car.
        to_rear_axle: Distance from the centre of gravity forward to the axle: negative [m].
        stamp_ns: Time of the measurement [ns].
    """
    x, y, yaw, v_x, v_y, yaw_rate = state[0], state[1], state[2], state[3], state[4], state[5]
    centre = VehicleState(stamp_ns, x, y, wrap_angle(yaw), v_x, v_y, yaw_rate)
    return at_distance(centre, to_rear_axle)


@in_place
def noisy(state: VehicleState, noise: Deviations, normal: Array) -> VehicleState:
    """Return a measurement with white noise.

    Args:
        state: Measurement without noise.
        noise: Standard deviations.
        normal: (6,) numbers from the standard normal distribution.
    """
    stamp_ns, x, y, yaw, v_x, v_y, yaw_rate = state
    return VehicleState(
        stamp_ns,
        x + noise.position * normal[0],
        y + noise.position * normal[1],
        wrap_angle(yaw + noise.heading * normal[2]),
        v_x + noise.speed * normal[3],
        v_y + noise.lateral_velocity * normal[4],
        yaw_rate + noise.yaw_rate * normal[5],
    )
