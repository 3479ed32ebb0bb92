"""What a controller believes and may do, as one row of numbers: a swarm of them is a matrix."""

from dataclasses import astuple
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.parameters import (
    GRAVITY,
    ChassisParameters,
    ControllerSettings,
    SteeringParameters,
)
from ampc_msgs_config.types import Array
from ampc_ros.mpc.model import Vehicle


class Limits(NamedTuple):
    """Period, bounds and solver of one step."""

    T: float
    Delta_u_max: float
    u_max: float
    half_width: float
    slack_weight: float
    exact: bool
    sweeps: int
    tolerance: float
    mu_g: float


class Actuator(NamedTuple):
    """Steering actuator as the controller believes it to be: delay = (ticks + share) T."""

    ticks: int
    share: float
    lag: float
    """Time constant; 0: the angle follows at once [s]."""


class InternalModel(NamedTuple):
    """All of it."""

    vehicle: Vehicle
    limits: Limits
    actuator: Actuator
    to_cg: float
    """From the point that `odom` describes forward to the centre of gravity [m]."""
    nominal_speed: float
    """Of a model that does not adapt; 0: the model follows the measured speed [m/s]."""


def internal_model_row(
    chassis: ChassisParameters,
    settings: ControllerSettings,
    steering: SteeringParameters | None = None,
    base_link_to_cg: float | None = None,
) -> Array:
    """Give the numbers of a controller (20,); see `believed`.

    Args:
        chassis: The car as the controller believes it to be.
        settings: Limits and solver.
        steering: Its actuator, whose limits count as well; None: without delay, lag and limits.
        base_link_to_cg: From the point that `odom` describes forward to the centre of gravity
            [m]; None: `odom` describes the rear axle.
    """
    actuator = actuator_of(steering, settings.sample_time) if steering else Actuator(0, 0.0, 0.0)
    to_cg = chassis.cg_to_rear_axle if base_link_to_cg is None else base_link_to_cg
    limits = limits_of(settings, steering)
    return np.array(
        [*astuple(chassis), *limits, *actuator, to_cg, settings.nominal_speed], dtype=float
    )


@in_place
def believed(row: Array) -> InternalModel:
    """Read a row of numbers (20,)."""
    vehicle = (row[0], row[1], row[2], row[3], row[4], row[5])
    bounds = row[6], row[7], row[8], row[9], row[10]
    limits = Limits(*bounds, row[11] > 0.0, int(row[12]), row[13], row[14])
    return InternalModel(
        vehicle, limits, Actuator(int(row[15]), row[16], row[17]), row[18], row[19]
    )


def limits_of(settings: ControllerSettings, steering: SteeringParameters | None = None) -> Limits:
    """Give the settings as compiled code takes them, within what the steering can do."""
    step, angle = settings.max_increment, settings.max_angle
    if steering is not None:
        step = min(step, steering.max_rate * settings.sample_time)
        angle = min(angle, steering.max_angle)
    return Limits(
        settings.sample_time,
        step,
        angle,
        settings.max_output_error,
        settings.slack_weight,
        settings.solver == "active_set",
        int(settings.hildreth_sweeps),
        settings.hildreth_tolerance,
        settings.friction * GRAVITY,
    )


def actuator_of(steering: SteeringParameters, T: float) -> Actuator:
    """Give an actuator as whole ticks and a share of a tick of T [s] of delay, and its lag."""
    ticks, share = divmod(steering.delay / T, 1.0)
    if share > 1.0 - 1e-6:
        ticks, share = ticks + 1.0, 0.0
    return Actuator(int(ticks), share if share > 1e-6 else 0.0, steering.lag)
