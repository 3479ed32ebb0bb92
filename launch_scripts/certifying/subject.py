"""The car and the controller that are certified, and the speeds at which they are checked."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import hints, number_bounds, unwrap
from ampc_msgs_config.vehicle_file import ABSOLUTE_SPREADS, VehicleContent, read_vehicle
from ampc_ros.configuration import (
    CERTIFIED_CONTROLLERS,
    Choices,
    Configuration,
    configuration,
    gain_file,
)
from ampc_ros.controller import build_controller
from launch_scripts.certifying.linear_loop import CertifiedController
from sim_vehicle.parameters import Vehicle, load_vehicle_file

INTERVAL_PARTS = (0.25, 0.5, 0.75)
"""Places between two nodes of a table that are checked."""
EXTENT = 1.1
"""Factor by which the checked speeds exceed those of the table at both ends."""
SPEED_DIGITS = 4
"""Significant digits of a speed."""
FRONT, REAR = "chassis.front_cornering_stiffness", "chassis.rear_cornering_stiffness"
MASS = "chassis.mass"
DEFAULT_SPREAD = {FRONT: 0.3, REAR: 0.3, MASS: 0.2}
"""Relative spread of values that the vehicle file does not mark as estimated."""
LEAST_FACTOR = 0.05
"""Least factor on an estimated value, for a spread of 1 or more."""


class Variation(NamedTuple):
    """A car that differs from the internal model of the controller."""

    car: Vehicle
    effect: float = 1.0
    """Factor on the effect of the steering, behind its limits."""
    misalignment: float = 0.0
    """Road-wheel angle when straight ahead is commanded [rad]."""


class Subject(NamedTuple):
    """A vehicle and a controller with its gains."""

    choices: Choices
    config: Configuration
    vehicle: Vehicle
    content: VehicleContent
    """Content of the vehicle file."""
    gain_table: Path

    def controller(self) -> CertifiedController:
        """Build the controller before its first step."""
        controller = build_controller(self.config, self.gain_table)
        assert isinstance(controller, CertifiedController)
        return controller

    @property
    def variations(self) -> list[Variation]:
        """Cars within the spread of the vehicle file."""
        return list(cars_within_spread(self.vehicle, self.content.estimated))

    @property
    def period(self) -> float:
        """Period of the controller [s]."""
        return self.config.settings.sample_time

    @property
    def max_angle(self) -> float:
        """Largest road-wheel angle of controller and steering [rad]."""
        return self.config.max_angle


def load_subject(choices: Choices) -> Subject:
    """Load vehicle, controller and gains.

    Raises:
        ValueError: Names file, key, value and bound, or a controller that cannot be certified.
    """
    if choices.controller not in CERTIFIED_CONTROLLERS:
        names = ", ".join(CERTIFIED_CONTROLLERS)
        raise ValueError(f"controller = {choices.controller!r} must be one of {names}")
    config, gains = configuration(choices), gain_file(choices)
    assert gains is not None
    if config.gains.get("schedule"):
        raise ValueError(f"{gains}: schedule: gains that change within a drive cannot be certified")
    file = find("vehicles", choices.vehicle)
    content = read_vehicle(file)
    subject = Subject(choices, config, load_vehicle_file(file), content, gains)
    subject.controller()  # numerically singular gains are reported before anything is driven
    return subject


def speed_grid(nodes: Sequence[float], fastest: float) -> tuple[Array, Array]:
    """Return the speeds to check, and those of the grid that the car cannot reach [m/s].

    The grid consists of the nodes of a table, INTERVAL_PARTS between them, and EXTENT at both ends.
    """
    low, high = nodes[0], nodes[-1]
    between = [a + part * (b - a) for a, b in pairwise(nodes) for part in INTERVAL_PARTS]
    beyond = [low / EXTENT, high * (1.0 + EXTENT) / 2.0, high * EXTENT]
    speeds = sorted(
        {float(f"{v:.{SPEED_DIGITS}g}") for v in (*nodes, *between, *beyond) if v > 0.0}
    )
    grid = np.array(speeds)
    return grid[grid <= fastest], grid[grid > fastest]


def top_speed(vehicle: Vehicle) -> float:
    """Return the speed at which drag and rolling resistance need the whole engine [m/s].

    Bisection; the engine is limited by force and by power.
    """
    engine, air = vehicle.powertrain, vehicle.aerodynamics
    rolling = engine.rolling_resistance * vehicle.chassis.mass * GRAVITY

    def surplus(v: float) -> float:
        drag = 0.5 * air.air_density * air.drag_area * v * v
        return min(engine.max_drive_force, engine.max_power / max(v, 1.0)) - drag - rolling

    low, high = 0.0, 100.0
    for _ in range(40):
        middle = (low + high) / 2.0
        low, high = (middle, high) if surplus(middle) > 0.0 else (low, middle)
    return low


def cars_within_spread(vehicle: Vehicle, spread: Mapping[str, float]) -> Iterator[Variation]:
    """Yield the cars at both ends of the spread of each value; both axles vary together.

    A mass that is not estimated only grows: that is the load.

    Args:
        vehicle: Nominal car.
        spread: Spread of estimated values by dotted key, see `vehicle_file`; DEFAULT_SPREAD holds
            for keys that are missing.
    """
    sizes = {**DEFAULT_SPREAD, **spread}
    nominal, tyres = Variation(vehicle), {key: sizes.pop(key) for key in (FRONT, REAR)}
    for sign in (-1.0, 1.0):
        softer = vary(nominal, FRONT, sign * tyres[FRONT])
        yield vary(softer, REAR, sign * tyres[REAR])
    for key, size in sizes.items():
        if key.partition(".")[0] == "size":
            continue
        for sign in (-1.0, 1.0) if key in spread or key != MASS else (1.0,):
            yield vary(nominal, key, sign * size)


def vary(nominal: Variation, key: str, change: float) -> Variation:
    """Return a variation with one value changed.

    Args:
        nominal: Variation to change.
        key: Dotted key of the vehicle file.
        change: Relative change, or an absolute one for the keys of ABSOLUTE_SPREADS. The value
            stays within its declared range.
    """
    factor, car = max(1.0 + change, LEAST_FACTOR), nominal.car
    if key == "steering.offset":
        return nominal._replace(misalignment=change)
    if key == "steering.ratio":
        return nominal._replace(effect=1.0 / factor)
    section, _, field = key.partition(".")
    part: Any = getattr(car, section)
    value = car.steering.time_constant if key == "steering.lag" else getattr(part, field)
    if isinstance(value, str | bool) or math.isinf(value):
        return nominal
    value = max(value + change, 0.0) if key in ABSOLUTE_SPREADS else value * factor
    _, declared = unwrap(hints(type(part))[field])
    if declared:
        low, high = number_bounds(declared)
        value = min(max(value, low), high)
    sections: dict[str, Any] = {section: replace(part, **{field: value})}
    return nominal._replace(car=car._replace(**sections))
