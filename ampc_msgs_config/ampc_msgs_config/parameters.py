"""Parameters that check themselves at birth: frozen dataclasses with a range for every number.

`dataclasses.astuple` of these is what compiled code receives and unpacks in the same order.
"""

import math
from dataclasses import MISSING, dataclass, field, fields
from itertools import pairwise
from typing import Any


def number(low: float, high: float, unit: str, default: Any = MISSING) -> Any:
    """Declare a dataclass field in [low, high]; infinite bounds themselves are allowed values."""
    return field(default=default, metadata={"low": low, "high": high, "unit": unit})


def row(low: float, high: float, unit: str) -> Any:
    """Declare a dataclass field that takes one or more numbers in [low, high]."""
    return field(metadata={"low": low, "high": high, "unit": unit, "row": True})


def choice(*options: str, default: Any = MISSING) -> Any:
    """Declare a dataclass field that takes one of a few words."""
    return field(default=default, metadata={"options": options})


@dataclass(frozen=True, kw_only=True)
class Checked:
    """Base of all parameters: refuses, by name, value and bound, what lies outside its range."""

    def __post_init__(self) -> None:
        """Check every field against its metadata."""
        for item in fields(self):
            value = getattr(self, item.name)
            if "options" in item.metadata and value not in item.metadata["options"]:
                raise ValueError(
                    f"{item.name} = {value!r} must be one of {', '.join(item.metadata['options'])}"
                )
            if "row" in item.metadata:
                check_row(item.name, value, item.metadata)
            elif "low" in item.metadata:
                check_range(item.name, value, item.metadata)


def check_row(name: str, values: Any, metadata: Any) -> None:
    """Raise a ValueError with name, index, value and bound unless all values are in range."""
    if not isinstance(values, (list, tuple)) or not values:
        raise ValueError(f"{name} = {values!r} must be a list of numbers")
    for i, value in enumerate(values):
        check_range(f"{name}[{i}]", value, metadata)


def check_range(name: str, value: Any, metadata: Any) -> None:
    """Raise a ValueError with name, value and bound unless low <= value <= high."""
    low, high, unit = metadata["low"], metadata["high"], metadata["unit"]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        hint = " (YAML needs a point in the mantissa: 1.0e-3)" if isinstance(value, str) else ""
        raise ValueError(f"{name} = {value!r} must be a number{hint}")
    if math.isnan(value) or not low <= value <= high:
        raise ValueError(f"{name} = {value!r} must lie in [{low:g}, {high:g}] {unit}".rstrip())


@dataclass(frozen=True, kw_only=True)
class ChassisParameters(Checked):
    """Single-track view of a car, Table 3 of the paper: m, I_z, l_f, l_r, C_f, C_r."""

    mass: float = number(1.0, 1.0e5, "kg")
    yaw_inertia: float = number(0.01, 1.0e6, "kg m^2")
    cg_to_front_axle: float = number(0.05, 20.0, "m")
    cg_to_rear_axle: float = number(0.05, 20.0, "m")
    front_cornering_stiffness: float = number(1.0, 1.0e7, "N/rad for ONE tyre")
    rear_cornering_stiffness: float = number(1.0, 1.0e7, "N/rad for ONE tyre")

    @property
    def wheelbase(self) -> float:
        """L = l_f + l_r [m]."""
        return self.cg_to_front_axle + self.cg_to_rear_axle

    @property
    def understeer_gradient(self) -> float:
        """K_us = m/L (l_r / 2 C_f - l_f / 2 C_r) [rad s^2/m]; positive: the car understeers."""
        front = self.cg_to_rear_axle / (2 * self.front_cornering_stiffness)
        rear = self.cg_to_front_axle / (2 * self.rear_cornering_stiffness)
        return self.mass / self.wheelbase * (front - rear)


@dataclass(frozen=True, kw_only=True)
class SteeringParameters(Checked):
    """Steering actuator between the commanded and the real road-wheel angle."""

    max_angle: float = number(0.0, 1.5, "rad")
    max_rate: float = number(0.0, math.inf, "rad/s", math.inf)
    lag: float = number(0.0, 5.0, "s", 0.0)
    """Time constant of the first-order lag."""
    delay: float = number(0.0, 2.0, "s", 0.0)
    """Pure delay."""


@dataclass(frozen=True, kw_only=True)
class ControllerSettings(Checked):
    """Limits and solver of the controller; its gains are in the gain table."""

    sample_time: float = number(0.001, 1.0, "s", 0.1)
    max_increment: float = number(0.0, 3.0, "rad per tick", math.pi / 12)
    max_angle: float = number(0.0, 1.5, "rad", math.pi / 6)
    max_output_error: float = number(0.0, math.inf, "m", math.inf)
    """Half-width of the soft lane about the reference, Eq. (15); infinite: no output rows."""
    friction: float = number(0.05, 2.0, "", 0.9)
    """Of the road as the controller believes it to be; the bound of the angle follows it."""
    slack_weight: float = number(1.0e-3, 1.0e9, "1/m^2", 1.0e4)
    nominal_speed: float = number(0.0, 100.0, "m/s", 0.0)
    """Speed of a model that does not adapt; 0: the model follows the measured speed."""
    solver: str = choice("active_set", "hildreth", default="active_set")
    hildreth_sweeps: float = number(1, 1_000_000, "", 38)
    hildreth_tolerance: float = number(0.0, 1.0, "", 1.0e-7)
    look_ahead_time: float = number(0.0, 10.0, "s", 0.6)
    """Pure pursuit: look-ahead distance per speed."""
    min_look_ahead: float = number(0.1, 100.0, "m", 4.0)
    """Pure pursuit: shortest look-ahead distance."""


@dataclass(frozen=True, kw_only=True)
class SizeParameters(Checked):
    """Outline of the car, for lanes and cones."""

    width: float = number(0.1, 10.0, "m")
    front_overhang: float = number(0.0, 10.0, "m")
    """From the front axle to the front bumper."""
    rear_overhang: float = number(0.0, 10.0, "m")
    """From the rear axle to the rear bumper."""


@dataclass(frozen=True, kw_only=True)
class GuardLimits(Checked):
    """What a steering command has to keep to, whoever computed it, by speed.

    Each row has one value for each speed; between the speeds it is linear, beyond them it is held.
    """

    speed: tuple[float, ...] = row(0.0, 100.0, "m/s")
    """Increasing."""
    max_angle: tuple[float, ...] = row(0.01, 1.5, "rad")
    max_rate: tuple[float, ...] = row(0.01, 20.0, "rad/s")
    lateral_acceleration: tuple[float, ...] = row(0.1, 50.0, "m/s^2")
    """Of the steady circle that belongs to the angle."""
    lateral_jerk: tuple[float, ...] = row(0.1, 1000.0, "m/s^3")
    """By which that acceleration changes, from turning the wheel alone."""
    measured_step: tuple[float, ...] = row(0.01, 3.0, "rad")
    """Farthest that a command may move away from the measured road-wheel angle."""

    def __post_init__(self) -> None:
        """Check the rows, each for itself and against the speeds, and make tuples of them."""
        super().__post_init__()
        for item in fields(self):
            values = tuple(float(value) for value in getattr(self, item.name))
            object.__setattr__(self, item.name, values)
            if len(values) != len(self.speed):
                raise ValueError(
                    f"{item.name} = {list(values)} must have {len(self.speed)} values, as speed has"
                )
        for i, (slow, fast) in enumerate(pairwise(self.speed), start=1):
            if fast <= slow:
                raise ValueError(f"speed[{i}] = {fast:g} must be greater than {slow:g} before it")
