"""Part (c): closed-loop control ticks per second and core, over cars and integration step."""

from time import perf_counter

import numpy as np

from launch_scripts.bench_ours import make_swarm
from launch_scripts.bench_report import Section
from launch_scripts.bench_timing import no_collection

CARS = (1, 2, 5, 10, 20, 50, 100, 200)
STEPS_MS = (1, 2, 5, 10, 20)
TICKS = 6000
"""Of a measurement, at least."""
PERIOD = 0.1
"""Of control [s]."""


def measure(*, quick: bool) -> list[Section]:
    """Give one table: a row for each size of the swarm, a column for each step."""
    cars, steps = ((1, 20), (5, 20)) if quick else (CARS, STEPS_MS)
    rounds, ticks = (1, 100) if quick else (5, TICKS)
    rates = np.array([[[0.0] * len(steps)] * len(cars)] * rounds)
    for k in range(rounds):
        for i, size in enumerate(cars):
            for j, step in enumerate(steps):
                rates[k, i, j] = swarm_rate(size, step / 1e3, ticks / size * PERIOD)
    medians = np.median(rates, axis=0)
    rows = [
        {
            "cars": str(size),
            **{f"{step} ms": float(v) for step, v in zip(steps, found, strict=True)},
        }
        for size, found in zip(cars, medians, strict=True)
    ]
    note = (
        "Control ticks per second on one core, gains (45, 15, 5), a tick every 0.1 s of simulated "
        f"time: controller and dual-track car, RK4 with the step above. Medians of {rounds}."
    )
    return [Section("swarm", "Closed loop: control ticks per second and core", note, rows)]


def swarm_rate(cars: int, step: float, seconds: float) -> float:
    """Drive a swarm and give the ticks per second of real time.

    Args:
        cars: In the swarm.
        step: Of the integration [s].
        seconds: Of simulated time.
    """
    advance = make_swarm(cars, step)
    advance(PERIOD)
    with no_collection():
        begin = perf_counter()
        ticks = advance(seconds)
        return ticks / (perf_counter() - begin)
