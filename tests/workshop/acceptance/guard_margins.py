"""Measure how close the commands come to the limits of the guard, and how often it clips.

`python -m tests.workshop.acceptance.guard_margins`; `--guard my_limits.yaml` for other limits.
Ordinary driving must not be clipped by `road`, and no drive by `track`.
"""

import argparse
from collections.abc import Sequence
from itertools import product
from pathlib import Path as File
from typing import NamedTuple

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.metrics import ticks
from ampc_msgs_config.parameters import GuardLimits
from ampc_ros.supervision.guard import Guard, bounds
from launch_scripts.run.simulated import SimulatedDrive
from tests.workshop.acceptance.road_data import DATA
from tests.workshop.acceptance.trials import Trial, run

CARS = ("paper", "ordinary")
ORDINARY_DRIVES = ("sc1", "sc1_falcone", "iso3888_1", "iso3888_2", "circle", "sine", "straight")
DRIVES_AT_THE_LIMIT = ("sc2", "sc3_constant", "sc3_varying", "sc3_wind", "sc3_fast_wind")
HEADINGS = ("drive", "car", "angle", "acceleration", "rate", "jerk", "clipped", "by")
WIDTH = 120
"""Minimum width of the printed table [characters]."""


class Margin(NamedTuple):
    """Commands of one drive relative to the limits."""

    shares: tuple[float, ...]
    """Largest angle, lateral acceleration, rate and lateral jerk, as shares of their limits."""
    clipped: int
    """Number of commands that the guard clips, each with an unclipped predecessor."""
    commands: int
    limits: dict[str, int]
    """Number of clipped commands by limit."""


def margin(driven: SimulatedDrive, limits: GuardLimits) -> Margin:
    """Compare the commands of a drive with the limits."""
    steering, states = driven.drive.steering.tolist(), driven.drive.states
    period = float(np.diff(ticks(driven.drive)).mean())
    guard = Guard(limits, driven.vehicle.chassis, period)
    clipped, last, shares = 0, 0.0, []
    for angle, state in zip(steering, states, strict=True):
        guard.reset(last)
        rate = (angle - last) / period
        clipped += guard.step(angle, rate, state.v_x).limit > 0
        bound = bounds(limits, driven.vehicle.chassis, state.v_x)
        here = np.abs([angle, angle, rate, rate]) / np.array(bound[:4])
        shares.append(here)
        last = angle
    return Margin(tuple(np.max(shares, axis=0).tolist()), clipped, len(steering), guard.count)


def names() -> tuple[str, ...]:
    """Return the shipped scenarios, and the roads of `road_data`."""
    roads = (str(file.relative_to(DATA)) for file in sorted(DATA.glob("*/*.csv")))
    return (*ORDINARY_DRIVES, *roads, *DRIVES_AT_THE_LIMIT)


def cells(trial: Trial, result: Margin) -> tuple[str, ...]:
    """Return a row of the table."""
    by = ", ".join(f"{name} {n}" for name, n in result.limits.items() if n)
    clipped = f"{result.clipped} of {result.commands}"
    return (
        File(trial.scenario).stem,
        trial.car,
        *(f"{share:.2f}" for share in result.shares),
        clipped,
        by,
    )


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    known = ", ".join(shipped("guards"))
    parser.add_argument("--guard", default="road", help=f"YAML file, or {known}; %(default)s")
    parser.add_argument("--only", nargs="+", help="drives; default: all", choices=names())
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive all scenarios, print the table, and return the exit code."""
    chosen, console = options(arguments), Console(highlight=False)
    try:
        limits = load(GuardLimits, find("guards", chosen.guard))
    except ValueError as error:
        console.print(f"error: {error}", markup=False, soft_wrap=True)
        return 2
    console.width = max(console.width, WIDTH)
    table = Table(*HEADINGS, box=SIMPLE_HEAD, title=f"shares of the limits of {chosen.guard}")
    for name, car in product(chosen.only or names(), CARS):
        trial = Trial(name, car)
        table.add_row(*cells(trial, margin(run(trial, "preview"), limits)))
    console.print(table)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
