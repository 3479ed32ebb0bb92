"""The car and the controller that are certified, and the speeds at which they are checked."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.types import Array
from ampc_ros.certificate import CERTIFIED_CONTROLLERS
from ampc_ros.configuration import Choices, Configuration, configuration, gain_file
from ampc_ros.controller import build_controller
from launch_scripts.certifying.linear_loop import CertifiedController
from sim_vehicle.parameters import Vehicle, load_vehicle_file

PARTS = (0.25, 0.5, 0.75)
"""Places between two nodes of a table that are checked."""
EXTENT = 1.1
"""Factor by which the checked speeds exceed those of the table at both ends."""
DIGITS = 4
"""Significant digits of a speed."""
FRONT, REAR = "chassis.front_cornering_stiffness", "chassis.rear_cornering_stiffness"
DEFAULT_SPREAD = {FRONT: 0.3, REAR: 0.3, "chassis.mass": 0.2}
"""Relative spread of a car whose file does not state one."""
LEAST_FACTOR = 0.05
"""Least factor on an estimated value, for a spread of 1 or more."""


class Subject(NamedTuple):
    """A vehicle and a controller with its gains."""

    choices: Choices
    config: Configuration
    vehicle: Vehicle
    spread: Mapping[str, float]
    """Relative spread by dotted key of the vehicle file."""
    gain_table: Path

    def controller(self) -> CertifiedController:
        """Build the controller before its first step."""
        controller = build_controller(self.config, self.gain_table)
        assert isinstance(controller, CertifiedController)
        return controller

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
    vehicle = load_vehicle_file(find("vehicles", choices.vehicle))
    spread = dict(getattr(vehicle, "estimated", {}))
    subject = Subject(choices, config, vehicle, spread, gains)
    subject.controller()  # numerically singular gains are reported before anything is driven
    return subject


def speed_grid(nodes: Sequence[float], fastest: float) -> tuple[Array, Array]:
    """Return the speeds to check, and those of the grid that the car cannot reach [m/s].

    The grid consists of the nodes of a table, PARTS of each interval, and EXTENT at both ends.
    """
    low, high = nodes[0], nodes[-1]
    between = [a + part * (b - a) for a, b in zip(nodes, nodes[1:], strict=False) for part in PARTS]
    beyond = [low / EXTENT, high * (1.0 + EXTENT) / 2.0, high * EXTENT]
    speeds = sorted({float(f"{v:.{DIGITS}g}") for v in (*nodes, *between, *beyond) if v > 0.0})
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


def cars_within_spread(vehicle: Vehicle, spread: Mapping[str, float]) -> Iterator[Vehicle]:
    """Yield cars at the ends of the spread; both axles vary together, all other values alone.

    Args:
        vehicle: Nominal car.
        spread: Relative spread by dotted key; empty: DEFAULT_SPREAD, where the car is only heavier.

    Raises:
        ValueError: A key is no number of the vehicle file, or a value leaves its range.
    """
    tyres = {key: size for key, size in (spread or DEFAULT_SPREAD).items() if key in (FRONT, REAR)}
    others = {k: size for k, size in (spread or DEFAULT_SPREAD).items() if k not in tyres}
    if tyres:
        for sign in (-1.0, 1.0):
            yield scaled(vehicle, {key: 1.0 + sign * size for key, size in tyres.items()})
    for key, size in others.items():
        for sign in (-1.0, 1.0) if spread else (1.0,):
            yield scaled(vehicle, {key: 1.0 + sign * size})


def scaled(vehicle: Vehicle, factors: Mapping[str, float]) -> Vehicle:
    """Return a vehicle with numbers multiplied by factors, by dotted key.

    Raises:
        ValueError: A key is no number of the vehicle file, or a value leaves its range.
    """
    for key, factor in factors.items():
        section, _, field = key.partition(".")
        part = getattr(vehicle, section, None)
        value = getattr(part, field, None)
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value):
            raise ValueError(f"estimated: {key} is no number of the vehicle file")
        changed = {field: value * max(factor, LEAST_FACTOR)}
        vehicle = vehicle._replace(**{section: replace(part, **changed)})
    return vehicle
