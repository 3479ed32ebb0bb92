"""Closed-loop control ticks per second: over cars and integration step, and over workers."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from functools import cache
from time import monotonic, perf_counter

import numpy as np

from tests.workshop.bench.bench_ours import make_swarm
from tests.workshop.bench.bench_report import Row, Section
from tests.workshop.bench.bench_timing import no_collection

CARS = (1, 5, 20, 50, 100, 200)
STEPS_MS = (1, 2, 5, 10, 20)
TICKS = 6000
"""Minimum number of ticks of a measurement."""
SHORTEST, LONGEST = 10.0, 30.0
"""Range of the simulated duration of a drive [s]."""
FORMULATIONS = ("paper", "preview")
SCALING_CARS, SCALING_STEP, SCALING_DURATION = 20, 0.005, 30.0
"""Cars, integration step [s] and simulated duration [s] of the measurement over workers."""
WORKERS = (1, 2)


def measure(*, quick: bool) -> list[Section]:
    """Return one table for each formulation of the controller."""
    return [swarm_table(formulation, quick=quick) for formulation in FORMULATIONS]


def swarm_table(formulation: str, *, quick: bool) -> Section:
    """Return one row for each number of cars, one column for each integration step."""
    cars, steps = ((1, 20), (5, 20)) if quick else (CARS, STEPS_MS)
    rounds, ticks = (1, 300) if quick else (3, TICKS)
    seconds = {n: min(max(0.1 * ticks / n, SHORTEST), LONGEST) for n in cars}
    swarms = [[make_swarm(formulation, n, step / 1e3, seconds[n]) for step in steps] for n in cars]
    for drive in swarms[0]:
        drive()
    rates = [[[swarm_rate(swarm, ticks) for swarm in row] for row in swarms] for _ in range(rounds)]
    rows = [
        {"cars": str(n), **{f"{step} ms": float(v) for step, v in zip(steps, row, strict=True)}}
        for n, row in zip(cars, np.median(rates, axis=0), strict=True)
    ]
    note = (
        "Shipped gains, settings of Table 3, roads of the paper, a tick every 0.1 s of simulated "
        "time: measurement, controller, driver, dual-track car with the given integration step, "
        f"classical Runge-Kutta. Medians of {rounds} rounds."
    )
    title = f"Closed loop, {formulation}: control ticks per second and core"
    return Section(f"swarm_{formulation}", title, note, rows)


def swarm_rate(drive: Callable[[], int], ticks: int) -> float:
    """Return the control ticks per second of wall time, measured over a minimum number."""
    done = 0
    with no_collection():
        begin = perf_counter()
        while done < ticks:
            done += drive()
        return done / (perf_counter() - begin)


def measure_scaling(*, quick: bool) -> list[Section]:
    """Return one table: one and two threads, one and two processes."""
    rounds, ticks = (1, 6000) if quick else (7, 60_000)
    with ExitStack() as stack:
        pools = {key: stack.enter_context(pool) for key, pool in make_pools().items()}
        for (_, workers), pool in pools.items():
            total_rate(pool, workers, 1)
        rates = {key: np.empty(rounds) for key in pools}
        for k in range(rounds):
            for key, pool in pools.items():
                rates[key][k] = total_rate(pool, key[1], ticks)
    rows: list[Row] = [
        {
            "workers": f"{workers} {kind}",
            "ticks per second": float(np.median(rates[kind, workers])),
            "times one": float(np.median(rates[kind, workers] / rates[kind, WORKERS[0]])),
        }
        for kind, workers in rates
    ]
    note = (
        f"Each worker drives a swarm of {SCALING_CARS} cars, RK4 at 5 ms, all at the same time; "
        f"medians of {rounds} interleaved rounds. The gain needs one free core for each worker."
    )
    return [Section("scaling", "Threads and processes", note, rows)]


def make_pools() -> dict[tuple[str, int], Executor]:
    """Return executors by kind and number of workers."""
    spawn = multiprocessing.get_context("spawn")
    threads = {("threads", n): ThreadPoolExecutor(n) for n in WORKERS}
    processes = {("processes", n): ProcessPoolExecutor(n, mp_context=spawn) for n in WORKERS}
    return {**threads, **processes}


def total_rate(pool: Executor, workers: int, ticks: int) -> float:
    """Return the ticks per second of all workers, from the first start to the last end.

    Args:
        pool: Executor with this number of workers.
        workers: Number of tasks.
        ticks: Minimum number of ticks of each task.
    """
    tasks = [pool.submit(timed_drive, ticks) for _ in range(workers)]
    begins, ends, done = zip(*(task.result() for task in tasks), strict=True)
    return float(sum(done) / (max(ends) - min(begins)))


def timed_drive(ticks: int) -> tuple[float, float, int]:
    """Drive a swarm; return start and end on the monotonic clock [s], and the ticks."""
    drive, done = shared_swarm(), 0
    begin = monotonic()
    while done < ticks:
        done += drive()
    return begin, monotonic(), done


@cache
def shared_swarm() -> Callable[[], int]:
    """Return the swarm of all threads of a process; driving does not change it."""
    return make_swarm("paper", SCALING_CARS, SCALING_STEP, SCALING_DURATION)
