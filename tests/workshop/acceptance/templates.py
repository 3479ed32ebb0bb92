"""Drive random vehicle templates: `python -m tests.workshop.acceptance.templates`.

Each template is drawn within its type: mass, wheelbase, front share. With the default gains, it is
model and true car of a double lane change, which is as sharp as lateral acceleration, steering
angle and rate allow. The exit code is 1 where a template misses the bound.
"""

import argparse
import math
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.metrics import errors
from ampc_msgs_config.paths.curves import q
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedProfile
from ampc_msgs_config.vehicle_warnings import vehicle_warnings
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from launch_scripts.templates.vehicle_rules import DENSITY, TYPES, DataSheet, vehicle_template
from launch_scripts.templates.vehicle_text import vehicle_text
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import Vehicle, load_vehicle_file

BOUND = 0.15
"""Largest cross-track error [m]; of a model car BOUND / 3, which is as much of its lane change."""
SHIFT, MODEL_SHIFT = 3.5, 0.5
"""Lateral shift of the lane change [m]."""
SPEEDS = {
    "passenger": (5.0, 30.0),
    "sport": (5.0, 35.0),
    "truck": (5.0, 23.0),
    "bus": (4.0, 22.0),
    "model_car": (1.0, 5.0),
}
"""Range of the speed [m/s]."""
ACCELERATIONS = {"truck": (1.0, 2.0), "bus": (1.0, 2.0)}
"""Range of the largest lateral acceleration [m/s^2]: loaded trucks roll over above 3."""
OTHERS = (1.0, 3.0)
STEERING_SHARE = 0.5
"""Largest share of angle and rate of the steering that the road needs."""


class TemplateDrive(NamedTuple):
    """One drive of a template."""

    sheet: DataSheet
    vehicle: Vehicle
    speed: float
    """[m/s]"""
    acceleration: float
    """Largest lateral acceleration of the road [m/s^2]."""
    error: float
    """Largest cross-track error [m]."""
    warnings: list[str]


def bound_of(kind: str) -> float:
    """Return the largest cross-track error of a type [m]."""
    return BOUND / 3.0 if kind == "model_car" else BOUND


def drawn_sheet(kind: str, rng: np.random.Generator) -> DataSheet:
    """Return a random data sheet of a type."""
    rules = TYPES[kind]
    while True:
        L = math.exp(rng.uniform(*np.log(rules.wheelbase)))
        low = max(rules.mass[0], 1.001 * DENSITY[0] * L**3)
        high = min(rules.mass[1], 0.999 * DENSITY[1] * L**3)
        if low < high:
            mass = math.exp(rng.uniform(math.log(low), math.log(high)))
            return DataSheet(mass=mass, wheelbase=L, front_share=rng.uniform(*rules.shares))


def lane_change(speed: float, acceleration: float, vehicle: Vehicle, shift: float) -> Scenario:
    """Return a double lane change within a lateral acceleration and the limits of the steering.

    The peaks of the derivatives of shift * q(s / l) are 5.77 shift / l^2 and 60 shift / l^3.
    """
    angle, rate = (
        STEERING_SHARE * limit for limit in (vehicle.steering.max_angle, vehicle.steering.max_rate)
    )
    by_angle = math.sqrt(5.7735 * shift * vehicle.chassis.wheelbase / angle)
    by_rate = (60.0 * shift * vehicle.chassis.wheelbase * speed / rate) ** (1 / 3)
    over = max(speed * math.sqrt(5.7735 * shift / acceleration), by_angle, by_rate)
    x = np.arange(0.0, 2.0 * over + 9.0 * speed, shift / 8.0)
    starts = speed, 2.0 * speed + over
    out, back = (np.array([q(z) for z in np.clip((x - s) / over, 0.0, 1.0)]) for s in starts)
    profile = SpeedProfile(False, np.array([0.0]), np.array([speed]))
    points = np.column_stack((x, shift * (out - back)))
    return Scenario("lane change", points, profile, (2.0 * over + 4.0 * speed) / speed)


def drive_template(kind: str, rng: np.random.Generator, folder: Path) -> TemplateDrive:
    """Write a random template of a type, load it, and drive it as model and true car."""
    sheet, file = drawn_sheet(kind, rng), folder / f"{kind}.yaml"
    file.write_text(vehicle_text(vehicle_template(sheet, kind), "a test", file), encoding="utf-8")
    vehicle = load_vehicle_file(file)
    speed = rng.uniform(*SPEEDS[kind])
    acceleration = rng.uniform(*ACCELERATIONS.get(kind, OTHERS))
    shift = MODEL_SHIFT if kind == "model_car" else SHIFT
    road = lane_change(speed, acceleration, vehicle, shift)
    driven = drive(Simulation(vehicle, road), make_controller(Choices(vehicle=str(file))))
    error = errors(driven, make_path(road.points), vehicle.chassis.cg_to_rear_axle)[:, 0]
    warnings = vehicle_warnings(vehicle.chassis, vehicle.steering)
    largest = float(np.abs(error).max())
    return TemplateDrive(sheet, vehicle, speed, acceleration, largest, warnings)


def main() -> int:
    """Drive templates of all types, print a line for each type, and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--drives", type=int, default=300, help="of each type")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng, missed = np.random.default_rng(options.seed), 0
    with tempfile.TemporaryDirectory() as folder:
        for kind in TYPES:
            drives = [drive_template(kind, rng, Path(folder)) for _ in range(options.drives)]
            worst = max(drives, key=lambda each: each.error)
            late = sum(each.error > bound_of(kind) for each in drives)
            warned = sum(bool(each.warnings) for each in drives)
            missed += late + warned
            print(
                f"{kind}: median {np.median([each.error for each in drives]):.3f} m, largest "
                f"{worst.error:.3f} m of {bound_of(kind):.3f} m, {late} missed, {warned} with "
                f"warnings; largest with {worst.sheet} at {worst.speed:.3g} m/s"
            )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
