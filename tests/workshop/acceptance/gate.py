"""Stop cars by the gate at many moments of many roads, and check how far they leave their path.

`python -m tests.workshop.acceptance.gate`. The controller falls silent (as after kill -9, SIGSTOP,
a hanging callback or a closed terminal), sends numbers that are not finite, jumps, or gets a second
publisher. Errors are those of the true centre of gravity. Exit code 0: all targets are met.
"""

import argparse
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from tests.workshop.acceptance.gate_drives import FAULTS, StopCase, stops
from tests.workshop.acceptance.real_roads import roads
from tests.workshop.acceptance.targets import Observation, Section, Task, observe, targets_of

ERROR, REACTION = "largest error until standstill [m]", "fault to gate action [s]"
STEP, ROLLS = "step / guard step over elapsed time", "cars that do not stand"
BARS = {9.0: 0.5, 15.0: 1.0, 20.0: 1.5}
"""Largest error by speed [m/s, m]."""
REACTIONS = {10: 0.3, 50: 0.15}
"""Longest reaction by the rate of the controller [Hz, s]."""
STEPS = 1.0 + 1e-9
REPORTED = ("silence without odometry", "held angle")
"""Faults without a bar: nothing measures the car, or there is no gate."""
CARS = ("paper", "ordinary")


def name_of(fault: str, speed: float) -> str:
    """Return the name of a row."""
    return f"{fault}, up to {speed:g} m/s"


def limits_of(fault: str, bar: float) -> dict[str, float]:
    """Return the bars of a fault."""
    if fault in REPORTED:
        return {ERROR: math.inf}
    reactions = {f"{REACTION}, {rate} Hz": limit for rate, limit in REACTIONS.items()}
    return {ERROR: bar, **reactions, STEP: STEPS, ROLLS: 0.0}


LIMITS = targets_of(
    {name_of(fault, v): limits_of(fault, bar) for fault in FAULTS for v, bar in BARS.items()}
)
SECTION = Section("gate", "gate", LIMITS, Path(__file__).with_name("gate_before.json"))


def measure(case: StopCase, every: int) -> list[Observation]:
    """Return the observations of all stops of a case; each speed has the bar of its range."""
    found = []
    for fault, each in stops(case, every).items():
        for done in each:
            bar = next((v for v in BARS if done.speed <= v + 0.5), max(BARS))
            values = {ERROR: done.error if done.stands or fault in REPORTED else math.inf}
            if fault not in REPORTED:
                values |= {f"{REACTION}, {case.rate} Hz": done.reaction, STEP: done.step}
                values |= {ROLLS: 1.0 - done.stands}
            found += observe(name_of(fault, bar), f"{case}, at {done.speed:.1f} m/s", values)
    return found


def tasks(every: int) -> list[Task]:
    """Return all tasks for parallel processes."""
    names = ("sc1", "sc2", "20 m circle", *(["Norisring"] if "Norisring" in roads() else []))
    return [
        partial(measure, StopCase(car, road, speed, rate), every * rate // 10)
        for road in names
        for car in CARS
        for speed in BARS
        for rate in REACTIONS
        if not (road == "20 m circle" and speed > min(BARS))  # bends limit it to 9 m/s
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure all targets, print and write the table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/acceptance"), help="folder")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    parser.add_argument("--every", type=int, default=3, help="a fault each so many ticks at 10 Hz")
    parser.add_argument("--update", type=Path, help="page whose table is replaced")
    chosen, console = parser.parse_args(arguments), Console(highlight=False, soft_wrap=True)
    rows = SECTION.measure_alone(tasks(chosen.every), chosen.workers, console)
    return SECTION.report(rows, chosen.output, chosen.update, console)


if __name__ == "__main__":
    raise SystemExit(main())
