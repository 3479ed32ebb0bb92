"""Parameters of the simulated car: vehicle file, measurement noise, and their rows of numbers."""

import math
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.config import load
from ampc_msgs_config.parameters import (
    GRAVITY,
    ChassisParameters,
    SizeParameters,
    SteeringParameters,
)
from ampc_msgs_config.scenarios.scenario import SPEED_PREVIEW
from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import Checked, choice, number


@dataclass(frozen=True, kw_only=True)
class TyreParameters(Checked):
    """All four tyres; their cornering stiffness at the static load is in the chassis."""

    model: Annotated[str, choice(("pacejka", "linear"), "Force law of the tyres.")] = "pacejka"
    friction: Annotated[float, number(0.01, 3.0, "", "Friction at the static load, mu.")]
    shape: Annotated[float, number(1.0, 2.0, "", "Shape factor C of the Magic Formula.")] = 1.5
    curvature: Annotated[
        float, number(-10.0, 1.0, "", "Curvature factor E of the Magic Formula.")
    ] = -0.5
    load_sensitivity: Annotated[
        float, number(0.0, 0.5, "", "Loss of mu when the load doubles, k_D.")
    ] = 0.1
    stiffest_load: Annotated[
        float, number(1.0, 10.0, "static loads", "Load of the largest stiffness, p.")
    ] = 2.0
    relaxation_length: Annotated[float, number(0.01, 5.0, "m", "Relaxation length, sigma.")]
    parking_damping: Annotated[
        float, number(0.0, 1.0, "s", "Damping over lateral stiffness at rest.")
    ] = 0.04


@dataclass(frozen=True, kw_only=True)
class BodyParameters(Checked):
    """Body parameters that determine the wheel loads."""

    track: Annotated[float, number(0.05, 10.0, "m", "Track width of both axles.")]
    cg_height: Annotated[float, number(0.0, 5.0, "m", "Height of the centre of gravity.")]
    front_roll_share: Annotated[float, number(0.0, 1.0, "", "Front share of the roll stiffness.")]
    load_lag: Annotated[float, number(0.01, 2.0, "s", "Time constant of the wheel loads.")] = 0.05


@dataclass(frozen=True, kw_only=True)
class AerodynamicsParameters(Checked):
    """Drag and side force; areas include their coefficient."""

    air_density: Annotated[float, number(0.0, 10.0, "kg/m^3", "Density of the air.")] = 1.225
    drag_area: Annotated[float, number(0.0, 100.0, "m^2", "Drag coefficient times frontal area.")]
    side_area: Annotated[float, number(0.0, 100.0, "m^2", "Side coefficient times lateral area.")]
    side_force_arm: Annotated[
        float, number(-10.0, 10.0, "m", "Centre of gravity forward to the side force.")
    ]


@dataclass(frozen=True, kw_only=True)
class PowertrainParameters(Checked):
    """Engine, brakes, rolling resistance, and the driver who controls the speed."""

    max_drive_force: Annotated[float, number(0.0, 1.0e6, "N", "Largest drive force.")]
    max_power: Annotated[float, number(0.0, 1.0e7, "W", "Largest power of the engine.")]
    max_brake_force: Annotated[float, number(0.0, 1.0e6, "N", "Largest brake force.")]
    front_drive_share: Annotated[float, number(0.0, 1.0, "", "Front share of the drive force.")]
    front_brake_share: Annotated[float, number(0.0, 1.0, "", "Front share of the brake force.")]
    rolling_resistance: Annotated[
        float, number(0.0, 0.5, "", "Rolling resistance divided by weight.")
    ]
    driver_time_constant: Annotated[
        float, number(0.05, 10.0, "s", "Time constant of the driver's speed control.")
    ] = SPEED_PREVIEW


@dataclass(frozen=True, kw_only=True)
class MeasurementNoise(Checked):
    """Standard deviations of white noise on the measured state."""

    position: Annotated[float, number(0.0, 100.0, "m", "Noise of x and of y.")] = 0.0
    heading: Annotated[float, number(0.0, math.pi, "rad", "Noise of the heading.")] = 0.0
    yaw_rate: Annotated[float, number(0.0, 10.0, "rad/s", "Noise of the yaw rate.")] = 0.0
    lateral_velocity: Annotated[
        float, number(0.0, 10.0, "m/s", "Noise of the lateral velocity.")
    ] = 0.0
    speed: Annotated[float, number(0.0, 10.0, "m/s", "Noise of the longitudinal speed.")] = 0.0


class Vehicle(NamedTuple):
    """Content of a vehicle file."""

    chassis: ChassisParameters
    steering: SteeringParameters
    size: SizeParameters
    tyre: TyreParameters
    body: BodyParameters
    aerodynamics: AerodynamicsParameters
    powertrain: PowertrainParameters


class Numbers(NamedTuple):
    """Vehicle for compiled code: each section in the order of its fields."""

    chassis: tuple[float, ...]
    steering: tuple[float, ...]
    body: tuple[float, ...]
    front_tyre: tuple[float, ...]
    """(magic, C, E, k_D, p, sigma, T_d, C_alpha, F_z0) of one tyre of the axle."""
    rear_tyre: tuple[float, ...]
    air: tuple[float, ...]
    powertrain: tuple[float, ...]


def load_vehicle(file: Path) -> Vehicle:
    """Load a vehicle file.

    Raises:
        ValueError: File, key, value and bound.
    """
    return load(Vehicle, file)


def numbers(vehicle: Vehicle) -> Numbers:
    """Return a vehicle as the argument of compiled code."""
    chassis = vehicle.chassis
    axle_load = 0.5 * chassis.mass * GRAVITY / chassis.wheelbase  # per tyre and metre of lever
    front_load, rear_load = (
        axle_load * chassis.cg_to_rear_axle,
        axle_load * chassis.cg_to_front_axle,
    )
    return Numbers(
        chassis=astuple(chassis),
        steering=astuple(vehicle.steering),
        body=astuple(vehicle.body),
        front_tyre=_tyre(vehicle.tyre, chassis.front_cornering_stiffness, front_load),
        rear_tyre=_tyre(vehicle.tyre, chassis.rear_cornering_stiffness, rear_load),
        air=astuple(vehicle.aerodynamics),
        powertrain=astuple(vehicle.powertrain),
    )


def flat_numbers(vehicle: Vehicle) -> Array:
    """Return `numbers` as one row, section after section, so that a swarm of cars is a matrix."""
    return np.array([number for section in numbers(vehicle) for number in section])


@in_place
def numbers_of(row: Array) -> Numbers:
    """Return the numbers of a car from its row of `flat_numbers`."""
    return Numbers(
        chassis=(row[0], row[1], row[2], row[3], row[4], row[5]),
        steering=_four(row, 6),
        body=_four(row, 10),
        front_tyre=_nine(row, 14),
        rear_tyre=_nine(row, 23),
        air=_four(row, 32),
        powertrain=(row[36], row[37], row[38], row[39], row[40], row[41], row[42]),
    )


@inlined
def _four(row: Array, i: int) -> tuple[float, ...]:
    return row[i], row[i + 1], row[i + 2], row[i + 3]


@inlined
def _nine(row: Array, i: int) -> tuple[float, ...]:
    a, b, c, d = _four(row, i)
    e, f, g, h = _four(row, i + 4)
    return a, b, c, d, e, f, g, h, row[i + 8]


def _tyre(tyre: TyreParameters, stiffness: float, static_load: float) -> tuple[float, ...]:
    model, _, *shape = astuple(tyre)
    return (float(model == "pacejka"), *shape, stiffness, static_load)
