"""Parameters of a vehicle for compiled code: as tuples, and as a row of a fleet's matrix."""

from dataclasses import astuple
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.parameters import GRAVITY, SteeringParameters
from ampc_msgs_config.types import Array
from sim_vehicle.parameters import TyreParameters, Vehicle


class VehicleNumbers(NamedTuple):
    """Parameters of a vehicle; each section in the order of the fields of its dataclass."""

    chassis: tuple[float, ...]
    steering: tuple[float, ...]
    body: tuple[float, ...]
    front_tyre: tuple[float, ...]
    """(magic, C, E, k_D, p, sigma, T_d, C_alpha, F_z0) of one tyre of the axle."""
    rear_tyre: tuple[float, ...]
    air: tuple[float, ...]
    powertrain: tuple[float, ...]


SECTION_STARTS = (0, 6, 10, 14, 23, 32, 36, 43)
CHASSIS, SERVO, BODY, FRONT_TYRE, REAR_TYRE, AIR, POWERTRAIN, VEHICLE_ROW_SIZE = SECTION_STARTS
"""Positions of the sections in a row, and the size of the row."""


def vehicle_numbers(vehicle: Vehicle) -> VehicleNumbers:
    """Return the parameters of a vehicle as tuples."""
    chassis = vehicle.chassis
    axle_load = 0.5 * chassis.mass * GRAVITY / chassis.wheelbase  # per tyre and metre of lever
    front_load, rear_load = (
        axle_load * chassis.cg_to_rear_axle,
        axle_load * chassis.cg_to_front_axle,
    )
    return VehicleNumbers(
        chassis=astuple(chassis),
        steering=actuator_numbers(vehicle.steering),
        body=astuple(vehicle.body),
        front_tyre=tyre_numbers(vehicle.tyre, chassis.front_cornering_stiffness, front_load),
        rear_tyre=tyre_numbers(vehicle.tyre, chassis.rear_cornering_stiffness, rear_load),
        air=astuple(vehicle.aerodynamics),
        powertrain=astuple(vehicle.powertrain),
    )


def actuator_numbers(steering: SteeringParameters) -> tuple[float, ...]:
    """Return max_angle, max_rate, time constant and delay; an unknown lag is the assumed one."""
    return steering.max_angle, steering.max_rate, steering.time_constant, steering.delay


def tyre_numbers(tyre: TyreParameters, stiffness: float, static_load: float) -> tuple[float, ...]:
    """Return the numbers of one tyre; see `VehicleNumbers`.

    Args:
        tyre: Parameters of all four tyres.
        stiffness: C_alpha, cornering stiffness of one tyre at its static load [N/rad].
        static_load: F_z0 [N].
    """
    return (
        float(tyre.model == "pacejka"),
        tyre.shape,
        tyre.curvature,
        tyre.load_sensitivity,
        tyre.stiffest_load,
        tyre.relaxation_length,
        tyre.parking_damping,
        stiffness,
        static_load,
    )


def pack_vehicle(vehicle: Vehicle) -> Array:
    """Return the parameters of a vehicle as a row (VEHICLE_ROW_SIZE,), section after section.

    Raises:
        ValueError: A section does not begin where `unpack_vehicle` reads it.
    """
    sections = vehicle_numbers(vehicle)
    starts = (0, *np.cumsum([len(section) for section in sections]).tolist())
    if starts != SECTION_STARTS:
        raise ValueError(f"vehicle row: sections begin at {starts}, read at {SECTION_STARTS}")
    return np.array([number for section in sections for number in section])


@in_place
def unpack_vehicle(row: Array) -> VehicleNumbers:
    """Return the parameters in a row (VEHICLE_ROW_SIZE,) as tuples."""
    return VehicleNumbers(
        chassis=_four(row, CHASSIS) + _two(row, CHASSIS + 4),
        steering=_four(row, SERVO),
        body=_four(row, BODY),
        front_tyre=_four(row, FRONT_TYRE) + _four(row, FRONT_TYRE + 4) + (row[FRONT_TYRE + 8],),
        rear_tyre=_four(row, REAR_TYRE) + _four(row, REAR_TYRE + 4) + (row[REAR_TYRE + 8],),
        air=_four(row, AIR),
        powertrain=_four(row, POWERTRAIN) + _two(row, POWERTRAIN + 4) + (row[POWERTRAIN + 6],),
    )


@inlined
def _two(row: Array, i: int) -> tuple[float, ...]:
    return row[i], row[i + 1]


@inlined
def _four(row: Array, i: int) -> tuple[float, ...]:
    return row[i], row[i + 1], row[i + 2], row[i + 3]
