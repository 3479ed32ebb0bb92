"""Part (d): what a second thread or process adds."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from functools import cache
from time import monotonic

import numpy as np

from ampc_msgs_config.types import Array
from tests.workshop.bench.bench_ours import make_swarm
from tests.workshop.bench.bench_report import Row, Section

CARS, STEP, SECONDS = 20, 0.005, 30.0
WORKERS = (1, 2)


def measure(*, quick: bool) -> list[Section]:
    """Give one table: threads and processes, one and two."""
    rounds, ticks = (1, 6000) if quick else (7, 60_000)
    with ExitStack() as stack:
        pools = {key: stack.enter_context(pool) for key, pool in make_pools().items()}
        for (_, workers), pool in pools.items():
            total_rate(pool, workers, 1)
        rates = {key: np.empty(rounds) for key in pools}
        for k in range(rounds):
            for key, pool in pools.items():
                rates[key][k] = total_rate(pool, key[1], ticks)
    rows = [row(kind, n, rates[kind, n], rates[kind, WORKERS[0]]) for kind, n in rates]
    note = (
        f"Each worker drives a swarm of {CARS} cars, RK4 at 5 ms, all at the same time; medians "
        f"of {rounds} rounds in turns. The gain needs as many free cores as there are workers."
    )
    return [Section("scaling", "Threads and processes", note, rows)]


def make_pools() -> dict[tuple[str, int], Executor]:
    """Give executors by kind and number of workers."""
    spawn = multiprocessing.get_context("spawn")
    pools: dict[tuple[str, int], Executor] = {}
    for n in WORKERS:
        pools["threads", n] = ThreadPoolExecutor(n)
    for n in WORKERS:
        pools["processes", n] = ProcessPoolExecutor(n, mp_context=spawn)
    return pools


def row(kind: str, workers: int, rates: Array, single: Array) -> Row:
    """Give one row; the gain is the median of the ratios of the rounds."""
    return {
        "workers": f"{workers} {kind}",
        "ticks per second": float(np.median(rates)),
        "times one": float(np.median(rates / single)),
    }


def total_rate(pool: Executor, workers: int, ticks: int) -> float:
    """Ticks per second of all workers together, from the first one's begin to the last one's end.

    Args:
        pool: With so many workers.
        workers: Tasks that are given to it.
        ticks: Of each.
    """
    tasks = [pool.submit(timed_drive, ticks) for _ in range(workers)]
    begins, ends, done = zip(*(task.result() for task in tasks), strict=True)
    return float(sum(done) / (max(ends) - min(begins)))


def timed_drive(ticks: int) -> tuple[float, float, int]:
    """Drive a swarm; gives begin and end on the computer's clock [s], and the ticks."""
    drive, done = swarm(), 0
    begin = monotonic()
    while done < ticks:
        done += drive()
    return begin, monotonic(), done


@cache
def swarm() -> Callable[[], int]:
    """The swarm that all threads of a process drive; none changes it."""
    return make_swarm("paper", CARS, STEP, SECONDS)
