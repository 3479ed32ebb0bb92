"""The car that a controller assumes at present: as configured, or with estimated differences."""

import math
from dataclasses import astuple
from typing import NamedTuple

from ampc_msgs_config.compiled import inlined
from ampc_ros.configuration import Configuration
from ampc_ros.mpc.model import BicycleParameters

MOST_STIFF = 4.0
"""Largest ratio of an estimated front cornering stiffness to the configured one."""


class SteeringResponse(NamedTuple):
    """Delay and first-order lag of a steering [s]."""

    delay: float
    lag: float


class AssumedCar(NamedTuple):
    """Chassis and steering of the internal model."""

    vehicle: BicycleParameters
    """m, I_z, l_f, l_r, C_f, C_r."""
    response: SteeringResponse
    offset: float = 0.0
    """Road-wheel angle at a commanded angle of zero [rad]."""
    caution: float = 0.0
    """Share of the state filter that is used also without noise, 0 to 1: an uncertain steering, or
    a slow one, needs its margin."""


def assumed_car(config: Configuration) -> AssumedCar:
    """Return the car of a configuration."""
    steering = config.steering
    response = SteeringResponse(steering.delay, steering.time_constant)
    caution = 0.0 if steering.is_lag_configured else 1.0
    return AssumedCar(astuple(config.chassis), response, 0.0, caution)


@inlined
def with_tyres(vehicle: BicycleParameters, change: float, stiffness: float) -> BicycleParameters:
    """Return a chassis with another rear cornering stiffness and another understeer gradient.

    The front cornering stiffness follows from both: it contains the compliance of the steering,
    which no data sheet states. It is limited to MOST_STIFF times the configured one.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        change: Difference of the understeer gradient [rad s^2/m].
        stiffness: Natural logarithm of the ratio of the rear cornering stiffnesses.
    """
    m, I_z, l_f, l_r, C_f, C_r = vehicle
    rear = C_r * math.exp(stiffness)
    compliance = l_r / C_f + 2.0 * change * (l_f + l_r) / m + l_f / rear - l_f / C_r
    return m, I_z, l_f, l_r, l_r / max(compliance, l_r / (MOST_STIFF * C_f)), rear


def front_share(vehicle: BicycleParameters) -> float:
    """Return the part m l_r / (2 C_f L) of the understeer gradient [rad s^2/m]."""
    m, _, l_f, l_r, C_f, _ = vehicle
    return m * l_r / (2 * C_f * (l_f + l_r))
