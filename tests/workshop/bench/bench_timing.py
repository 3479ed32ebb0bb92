"""Times competitors side by side, so that the load of the machine hits all alike."""

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from time import perf_counter_ns
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.types import Array

BLOCK = 20
"""Calls that a competitor makes in a row before it is the next one's turn."""
Call = Callable[[], object]


class Entrant(NamedTuple):
    """A competitor: one call for each problem, the same problems in the same order for all."""

    calls: Sequence[Call]
    rounds: int
    """How often it goes through them; slow ones less often."""


class Timing(NamedTuple):
    """Statistics of one competitor [us]."""

    median: float
    """Of all calls."""
    p99: float
    """Of all calls: what the solver and the machine did."""
    p99_of_problems: float
    """Of the medians of each problem over the rounds: what the solver did."""


def interleaved(entrants: Mapping[str, Entrant]) -> dict[str, Array]:
    """Time every call, block by block, the competitors taking turns.

    The first call of each block is repeated and only the repetition counts: the caches then know
    the competitor.

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
    """Time calls one after the other [us]."""
    calls[0]()
    taken = []
    for call in calls:
        begin = perf_counter_ns()
        call()
        taken.append((perf_counter_ns() - begin) / 1e3)
    return taken


@contextmanager
def no_collection() -> Iterator[None]:
    """Keep the garbage collector from running."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def statistics(times: Array) -> Timing:
    """Sum durations (rounds, problems) up."""
    per_problem = np.median(times, axis=0)
    return Timing(
        float(np.median(times)),
        float(np.percentile(times, 99)),
        float(np.percentile(per_problem, 99)),
    )


def timing_cells(timing: Timing, unit: Timing) -> dict[str, float]:
    """Give medians, tails and ratios."""
    return {
        "median [us]": timing.median,
        "p99 [us]": timing.p99,
        "median / DAQP": timing.median / unit.median,
        "p99 / median": timing.p99 / timing.median,
        "p99 of problems / median": timing.p99_of_problems / timing.median,
    }
