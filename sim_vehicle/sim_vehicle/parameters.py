"""What a vehicle file says about the real car, beyond what the controller reads of it."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, get_type_hints

from ampc_msgs_config import config
from ampc_msgs_config.parameters import (
    ChassisParameters,
    Checked,
    SizeParameters,
    SteeringParameters,
    choice,
    number,
)
from ampc_msgs_config.scenarios.scenario import SPEED_PREVIEW

GRAVITY = 9.81
"""[m/s^2]"""


@dataclass(frozen=True, kw_only=True)
class TyreParameters(Checked):
    """All four tyres; their cornering stiffness at the static load stands in the chassis."""

    model: str = choice("pacejka", "linear", default="pacejka")
    friction: float = number(0.01, 3.0, "")
    """mu at the static load."""
    shape: float = number(1.0, 2.0, "", 1.5)
    """C of the Magic Formula."""
    curvature: float = number(-10.0, 1.0, "", -0.5)
    """E of the Magic Formula."""
    load_sensitivity: float = number(0.0, 0.5, "", 0.1)
    """Loss of mu when the load doubles, k_D."""
    stiffest_load: float = number(1.0, 10.0, "static loads", 2.0)
    """Load at which the cornering stiffness is largest, p."""
    relaxation_length: float = number(0.01, 5.0, "m")
    parking_damping: float = number(0.0, 1.0, "s", 0.04)
    """Damping over stiffness of the tyre's sideways spring at standstill."""


@dataclass(frozen=True, kw_only=True)
class BodyParameters(Checked):
    """What decides about the wheel loads."""

    track: float = number(0.05, 10.0, "m")
    cg_height: float = number(0.0, 5.0, "m")
    front_roll_share: float = number(0.0, 1.0, "")
    """Share of the front axle in the roll stiffness."""
    load_lag: float = number(0.01, 2.0, "s", 0.05)
    """Time constant with which the wheel loads follow the acceleration."""


@dataclass(frozen=True, kw_only=True)
class AerodynamicsParameters(Checked):
    """Areas include their coefficient."""

    air_density: float = number(0.0, 10.0, "kg/m^3", 1.225)
    drag_area: float = number(0.0, 100.0, "m^2")
    side_area: float = number(0.0, 100.0, "m^2")
    side_force_arm: float = number(-10.0, 10.0, "m")
    """Distance from the centre of gravity forward to the point where the side force acts."""


@dataclass(frozen=True, kw_only=True)
class PowertrainParameters(Checked):
    """Engine, brakes, rolling resistance, and the driver at the pedals."""

    max_drive_force: float = number(0.0, 1.0e6, "N")
    max_power: float = number(0.0, 1.0e7, "W")
    max_brake_force: float = number(0.0, 1.0e6, "N")
    front_drive_share: float = number(0.0, 1.0, "")
    front_brake_share: float = number(0.0, 1.0, "")
    rolling_resistance: float = number(0.0, 0.5, "")
    """Resistance over weight."""
    driver_time_constant: float = number(0.05, 10.0, "s", SPEED_PREVIEW)
    """With which the driver closes a speed error; the planner looks ahead as far."""


@dataclass(frozen=True, kw_only=True)
class MeasurementNoise(Checked):
    """Standard deviations of white noise on what the car reports."""

    position: float = number(0.0, 100.0, "m", 0.0)
    """Of x and of y."""
    heading: float = number(0.0, math.pi, "rad", 0.0)
    yaw_rate: float = number(0.0, 10.0, "rad/s", 0.0)
    lateral_velocity: float = number(0.0, 10.0, "m/s", 0.0)
    speed: float = number(0.0, 10.0, "m/s", 0.0)


class Vehicle(NamedTuple):
    """A vehicle file."""

    chassis: ChassisParameters
    steering: SteeringParameters
    size: SizeParameters
    tyre: TyreParameters
    body: BodyParameters
    aerodynamics: AerodynamicsParameters
    powertrain: PowertrainParameters


def load_vehicle(file: Path) -> Vehicle:
    """Load a vehicle file.

    Raises:
        ValueError: Names the file, the section, the key, the value and the bound.
    """
    content, sections = config.read(file), get_type_hints(Vehicle)
    for section in content:
        if section not in sections:
            raise ValueError(f"{file}: unknown section {section!r}; known: {', '.join(sections)}")
    for section in sections:
        if section not in content:
            raise ValueError(f"{file}: missing section {section!r}")
    return Vehicle(
        *(config.build(cls, content[key], f"{file}: {key}") for key, cls in sections.items())
    )
