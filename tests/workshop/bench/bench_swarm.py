"""Part (c): closed-loop control ticks per second and core, over cars and integration step."""

from collections.abc import Callable
from time import perf_counter

import numpy as np

from tests.workshop.bench.bench_ours import make_swarm
from tests.workshop.bench.bench_report import Section
from tests.workshop.bench.bench_timing import no_collection

CARS = (1, 5, 20, 50, 100, 200)
STEPS_MS = (1, 2, 5, 10, 20)
TICKS = 6000
"""Of a measurement, at least."""
SHORTEST, LONGEST = 10.0, 30.0
"""Drive [s]."""
FORMULATIONS = ("paper", "preview")


def measure(*, quick: bool) -> list[Section]:
    """Give a table for each formulation of the controller."""
    return [table(formulation, quick=quick) for formulation in FORMULATIONS]


def table(formulation: str, *, quick: bool) -> Section:
    """Give a row for each size of the swarm, a column for each step."""
    cars, steps = ((1, 20), (5, 20)) if quick else (CARS, STEPS_MS)
    rounds, ticks = (1, 300) if quick else (3, TICKS)
    seconds = {n: min(max(0.1 * ticks / n, SHORTEST), LONGEST) for n in cars}
    swarms = [[make_swarm(formulation, n, step / 1e3, seconds[n]) for step in steps] for n in cars]
    for drive in swarms[0]:
        drive()
    rates = np.array(
        [[[swarm_rate(swarm, ticks) for swarm in row] for row in swarms] for _ in range(rounds)]
    )
    medians = np.median(rates, axis=0)
    rows = [
        {"cars": str(n), **{f"{step} ms": float(v) for step, v in zip(steps, found, strict=True)}}
        for n, found in zip(cars, medians, strict=True)
    ]
    note = (
        "Shipped gains, settings of Table 3, roads of the paper, a tick every 0.1 s of simulated "
        "time: measurement, controller, driver, dual-track car with the integration step above, "
        f"classical Runge-Kutta. Medians of {rounds} rounds."
    )
    title = f"Closed loop, {formulation}: control ticks per second and core"
    return Section(f"swarm_{formulation}", title, note, rows)


def swarm_rate(drive: Callable[[], int], ticks: int) -> float:
    """Control ticks per second of real time, from at least so many."""
    done = 0
    with no_collection():
        begin = perf_counter()
        while done < ticks:
            done += drive()
        return done / (perf_counter() - begin)
