"""Drive cars that differ from their vehicle file, and check what the adaptation makes of it.

`python -m tests.workshop.acceptance.adaptation`. Errors are those of the true centre of gravity.
The roads of the ordinary driving were not used to choose any number of the adaptation. Exit code 0:
all targets are met. `--hostile 100000` drives as many hostile drives (about four hours).
"""

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_msgs_config.types import NANOSECONDS
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.parameters import load_vehicle_file
from tests.workshop.acceptance.adapted_drives import (
    Change,
    ChangedCar,
    ChangedOwnCar,
    changed,
    config_of,
    drive,
    hostile_drive,
    lane_change,
    ordinary_road,
    template_chassis,
)
from tests.workshop.acceptance.independent_plant import assumed_parameters
from tests.workshop.acceptance.targets import Observation, Section, Task, observe, targets_of
from tests.workshop.acceptance.trials import INDEPENDENT

SERVO_LAG = 0.05
"""Lag of the steering servo of the independent car [s]."""
ROADS = (11, 12, 13)
"""Seeds of the ordinary driving."""
MAX = "largest error [m]"
SHARE = "largest error / that with the true file"
WITHOUT = "largest error without adaptation [m]"
OUTSIDE, LOST = "estimates outside their bounds", "cars lost that are not lost without adaptation"
TEMPLATE_LIMITS = {9.0: 0.04, 10.0: 0.04, 11.0: 0.04, 13.0: 0.07, 15.0: 0.10}
CHANGES = (
    Change(tyres=0.7),
    Change(tyres=1.3),
    Change(mass=1.2),
    Change(offset_deg=1.0),
    Change(offset_deg=-1.0),
    Change(delay=0.1),
    Change(0.7, 1.2, 1.0),
    Change(1.3, 1.2, -1.0),
    Change(0.7, 1.2, -1.0, 0.1),
)
SPEEDS = (9.0, 11.0, 13.0, 15.0)
CHUNK = 100
"""Hostile drives of one task."""
FAR = 300 * NANOSECONDS
"""Time of the test drive, after the ordinary one [ns]."""


def template_name(speed: float) -> str:
    """Return the name of the rows of a template."""
    return f"template, 100 ms not configured, {speed:g} m/s"


def changed_name(car: str, change: Change) -> str:
    """Return the name of the rows of a changed car."""
    return f"{car}: {change}"


CARS = ("independent", "ordinary", "paper")
LIMITS = targets_of(
    {
        **{
            template_name(v): {MAX: limit, WITHOUT: math.inf}
            for v, limit in TEMPLATE_LIMITS.items()
        },
        **{
            changed_name(car, change): {SHARE: 1.5, MAX: math.inf, WITHOUT: math.inf}
            for car in CARS
            for change in CHANGES
        },
        "hostile drives": {OUTSIDE: 0.0, LOST: 0.0},
    }
)
SECTION = Section(
    "adaptation", "adaptation", LIMITS, Path(__file__).with_name("adaptation_before.json")
)


def largest(
    car: str,
    chassis: ChassisParameters,
    steering: SteeringParameters,
    change: Change,
    speed: float,
    road: int | None,
    *,
    adaptation: bool = True,
) -> float:
    """Return the largest error of the lane change, after ordinary driving on a road, if any."""
    supervisor = Supervisor(config_of(chassis, steering, adaptation=adaptation))
    if car == "independent":
        to_cg = assumed_parameters(INDEPENDENT)[0].cg_to_rear_axle
        build: Callable[..., ChangedCar | ChangedOwnCar] = partial(
            ChangedCar, change=change, lag=SERVO_LAG
        )
    else:
        vehicle = load_vehicle_file(find("vehicles", car))
        to_cg = vehicle.chassis.cg_to_rear_axle
        build = partial(ChangedOwnCar, vehicle, change=change)
    if road is not None:
        before = ordinary_road(road)
        drive(supervisor, before, build(scenario=before), to_cg, NANOSECONDS)
        supervisor.forget()
        supervisor.restart(0.0)  # the next car starts with straight wheels
    test = lane_change(speed)
    return float(np.abs(drive(supervisor, test, build(scenario=test), to_cg, FAR)).max())


def measure_template(speed: float, road: int) -> list[Observation]:
    """Drive the independent car with a file of its mass and wheelbase only."""
    chassis, change = template_chassis(), Change(delay=0.1)
    steering = SteeringParameters(max_angle=0.6)
    values = {
        MAX: largest("independent", chassis, steering, change, speed, road),
        WITHOUT: largest("independent", chassis, steering, change, speed, road, adaptation=False),
    }
    return observe(template_name(speed), f"road {road}", values)


def measure_changed(car: str, change: Change, speed: float) -> list[Observation]:
    """Drive a car that has changed since its file was written."""
    if car == "independent":
        chassis, steering = assumed_parameters(INDEPENDENT)
        steering = replace(steering, lag=SERVO_LAG)
    else:
        vehicle = load_vehicle_file(find("vehicles", car))
        chassis, steering = vehicle.chassis, vehicle.steering
    true_steering = replace(steering, delay=steering.delay + change.delay)
    straight = change._replace(offset_deg=0.0)
    right = largest(car, changed(chassis, change), true_steering, straight, speed, None)
    adapted = largest(car, chassis, steering, change, speed, ROADS[0])
    without = largest(car, chassis, steering, change, speed, ROADS[0], adaptation=False)
    values = {SHARE: adapted / right, MAX: adapted, WITHOUT: without}
    return observe(changed_name(car, change), f"{speed:g} m/s", values)


def measure_hostile(first: int, count: int) -> list[Observation]:
    """Drive hostile drives; a car that is lost is driven again without adaptation."""
    outside = lost = 0
    for seed in range(first, first + count):
        result = hostile_drive(seed, adaptation=True)
        outside += result.outside
        lost += result.lost and not hostile_drive(seed, adaptation=False).lost
    values = {OUTSIDE: outside, LOST: lost}
    return observe("hostile drives", f"seeds {first} to {first + count - 1}", values)


def tasks(hostile: int) -> list[Task]:
    """Return all tasks for parallel processes."""
    return [
        *(partial(measure_template, v, road) for v in TEMPLATE_LIMITS for road in ROADS),
        *(partial(measure_changed, car, c, v) for car in CARS for c in CHANGES for v in SPEEDS),
        *(
            partial(measure_hostile, first, min(CHUNK, hostile - first))
            for first in range(0, hostile, CHUNK)
        ),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure all targets, print and write the table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/acceptance"), help="folder")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    parser.add_argument("--hostile", type=int, default=1000, help="hostile drives")
    parser.add_argument("--only", default="", help="tasks whose function name contains this text")
    parser.add_argument("--update", type=Path, help="page whose table is replaced")
    chosen, console = parser.parse_args(arguments), Console(highlight=False, soft_wrap=True)
    jobs = [job for job in tasks(chosen.hostile) if chosen.only in job.func.__name__]
    rows = SECTION.measure_alone(jobs, chosen.workers, console)
    return SECTION.report(rows, chosen.output, chosen.update, console)


if __name__ == "__main__":
    raise SystemExit(main())
