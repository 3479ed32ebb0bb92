"""Parameters of the simulated car: vehicle file, measurement noise, and their rows of numbers."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

from ampc_msgs_config.parameters import (
    ChassisParameters,
    SizeParameters,
    SteeringParameters,
)
from ampc_msgs_config.scenarios.scenario import SPEED_PREVIEW
from ampc_msgs_config.validation import Checked, choice, hints, number
from ampc_msgs_config.vehicle_file import SECTIONS, read_vehicle


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


def load_vehicle_file(file: Path) -> Vehicle:
    """Load a vehicle file.

    Raises:
        ValueError: File, key, value and bound.
    """
    content = read_vehicle(file)
    return Vehicle(*(content.section(hints(Vehicle)[n], n, "the simulated car") for n in SECTIONS))
