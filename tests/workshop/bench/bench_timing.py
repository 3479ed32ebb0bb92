"""Interleaved timing, so that the load of the machine affects all competitors equally."""

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from time import perf_counter_ns
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.types import Array

BLOCK = 20
"""Number of consecutive calls of a competitor before the next one continues."""
Call = Callable[[], object]


class Entrant(NamedTuple):
    """A competitor: one call for each problem, the same problems in the same order for all."""

    calls: Sequence[Call]
    rounds: int
    """Number of repetitions; slow competitors have fewer."""


class Timing(NamedTuple):
    """Statistics of one competitor [us]."""

    median: float
    """Median of all calls."""
    p99: float
    """Tail of all calls, caused by solver and machine."""
    p99_of_problems: float
    """Tail of the medians of each problem over the rounds, caused by the solver."""


def interleaved(entrants: Mapping[str, Entrant]) -> dict[str, Array]:
    """Time every call in blocks that alternate between the competitors.

    The first call of each block is repeated to warm the caches; only the repetition counts.

    Returns:
        Duration of each call by competitor, (rounds, problems) [us].
    """
    size = len(next(iter(entrants.values())).calls)
    times: dict[str, Array] = {
        name: np.empty((entrant.rounds, size)) for name, entrant in entrants.items()
    }
    with no_collection():
        for round_number in range(max(entrant.rounds for entrant in entrants.values())):
            for start in range(0, size, BLOCK):
                for name, entrant in entrants.items():
                    if round_number < entrant.rounds:
                        block = entrant.calls[start : start + BLOCK]
                        times[name][round_number, start : start + BLOCK] = durations(block)
    return times


def durations(calls: Sequence[Call]) -> list[float]:
    """Return the durations of consecutive calls after one warm-up call [us]."""
    calls[0]()
    result = []
    for call in calls:
        begin = perf_counter_ns()
        call()
        result.append((perf_counter_ns() - begin) / 1e3)
    return result


@contextmanager
def no_collection() -> Iterator[None]:
    """Disable the garbage collector."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def statistics(times: Array) -> Timing:
    """Return the statistics of durations (rounds, problems)."""
    per_problem = np.median(times, axis=0)
    return Timing(
        float(np.median(times)),
        float(np.percentile(times, 99)),
        float(np.percentile(per_problem, 99)),
    )


def timing_cells(timing: Timing, unit: Timing) -> dict[str, float]:
    """Return medians, tails and ratios as cells of a table."""
    return {
        "median [us]": timing.median,
        "p99 [us]": timing.p99,
        "median / DAQP": timing.median / unit.median,
        "p99 / median": timing.p99 / timing.median,
        "p99 of problems / median": timing.p99_of_problems / timing.median,
    }
