"""Internal model and limits of a controller, also as a row of numbers: a fleet is a matrix."""

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
from ampc_ros.mpc.model import BicycleParameters


class Limits(NamedTuple):
    """Period, bounds and solver of one step."""

    T: float
    """Period [s]."""
    Delta_u_max: float
    """Largest increment of the angle per tick [rad]."""
    u_max: float
    """Largest angle [rad]."""
    half_width: float
    """Half width of the soft lane about the reference; infinite: no output rows [m]."""
    slack_weight: float
    exact: bool
    """Whether the active-set method is used; otherwise Hildreth's procedure."""
    sweeps: int
    """Largest number of Hildreth sweeps."""
    tolerance: float
    """Squared change of Hildreth's multipliers that ends the sweeps."""
    mu_g: float
    """Friction coefficient times gravity [m/s^2]."""


class Actuator(NamedTuple):
    """Steering actuator of the internal model: delay = (ticks + share) T."""

    ticks: int
    share: float
    lag: float
    """Time constant; 0: the angle follows at once [s]."""


class InternalModel(NamedTuple):
    """Everything that a controller assumes about its car."""

    vehicle: BicycleParameters
    limits: Limits
    actuator: Actuator
    to_cg: float
    """Distance from the point that `odom` describes forward to the centre of gravity [m]."""
    nominal_speed: float
    """Speed of a model that does not adapt; 0: the model follows the measured speed [m/s]."""


ACTUATOR = 15
"""Position of the actuator's ticks, share and lag in the row of an internal model."""
SHORT_LAG, LARGEST_LAG = 0.1, 0.3
"""Bounds of an estimated lag: a larger one than the first is the first and a delay [s]."""
ROW_SIZE = 20
"""Numbers in the row of an internal model: see `unpack_internal_model`."""


def pack_internal_model(
    chassis: ChassisParameters,
    settings: ControllerSettings,
    steering: SteeringParameters | None = None,
    base_link_to_cg: float | None = None,
) -> Array:
    """Return the row of numbers (ROW_SIZE,) of a controller's internal model.

    Args:
        chassis: Chassis of the internal model.
        settings: Limits and solver.
        steering: Steering actuator, whose limits apply as well; None: no delay, lag or limits.
        base_link_to_cg: Distance from the point that `odom` describes forward to the centre of
            gravity [m]; None: `odom` describes the rear axle.
    """
    actuator = actuator_of(steering, settings.sample_time) if steering else Actuator(0, 0.0, 0.0)
    to_cg = chassis.cg_to_rear_axle if base_link_to_cg is None else base_link_to_cg
    limits = limits_of(settings, steering)
    row = [*astuple(chassis), *limits, *actuator, to_cg, settings.nominal_speed]
    if len(row) != ROW_SIZE:
        raise ValueError(f"internal model: {len(row)} numbers, the row has {ROW_SIZE}")
    return np.array(row, dtype=float)


@in_place
def unpack_internal_model(row: Array) -> InternalModel:
    """Return the internal model of a row of numbers (ROW_SIZE,)."""
    return InternalModel(
        vehicle=(row[0], row[1], row[2], row[3], row[4], row[5]),
        limits=Limits(
            T=row[6],
            Delta_u_max=row[7],
            u_max=row[8],
            half_width=row[9],
            slack_weight=row[10],
            exact=row[11] > 0.0,
            sweeps=int(row[12]),
            tolerance=row[13],
            mu_g=row[14],
        ),
        actuator=Actuator(ticks=int(row[15]), share=row[16], lag=row[17]),
        to_cg=row[18],
        nominal_speed=row[19],
    )


def limits_of(settings: ControllerSettings, steering: SteeringParameters | None = None) -> Limits:
    """Return the limits of the settings, reduced to what the steering can do."""
    step, angle = settings.max_increment, settings.max_angle
    if steering is not None:
        step = min(step, steering.max_rate * settings.sample_time)
        angle = min(angle, steering.max_angle)
    return Limits(
        T=settings.sample_time,
        Delta_u_max=step,
        u_max=angle,
        half_width=settings.max_output_error,
        slack_weight=settings.slack_weight,
        exact=settings.solver == "active_set",
        sweeps=int(settings.hildreth_sweeps),
        tolerance=settings.hildreth_tolerance,
        mu_g=settings.friction * GRAVITY,
    )


def actuator_of(steering: SteeringParameters, T: float) -> Actuator:
    """Return an actuator whose delay is split into whole ticks and a share of a tick of T [s]."""
    return delayed(steering.delay, steering.time_constant, T)


def delayed(delay: float, lag: float, T: float) -> Actuator:
    """Return an actuator of a delay and a lag [s] for ticks of T [s]."""
    ticks, share = divmod(delay / T, 1.0)
    if share > 1.0 - 1e-6:
        ticks, share = ticks + 1.0, 0.0
    return Actuator(int(ticks), share if share > 1e-6 else 0.0, lag)
