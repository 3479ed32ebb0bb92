"""Delay margin and gain margins of a certificate, driven on the simulated car."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.types import Array
from launch_scripts.certifying.measurements import SLOW, Case, Report, drive_cases, rest
from launch_scripts.certifying.subject import Subject
from launch_scripts.tuning.drives import straight
from sim_vehicle.parameters import Vehicle

MARGIN_OFFSET, MARGIN_DURATION, MARGIN_REST_TIME, MARGIN_REST = 0.5, 15.0, 5.0, 0.05
"""Initial offset [m] and duration [s] of the drives of the margins. A car has settled if its error
is below the last number [m] during the time before it [s]."""
COARSE_DELAYS = tuple(i * 0.02 for i in range(16))
COARSE_GAINS = tuple(1.0 + i * 0.2 for i in range(16))
COARSE_REDUCTIONS = tuple(1.0 - i * 0.1 for i in range(9))
"""Values of the margins that are tried first, in this order; see `last_settling`."""
DELAY_STEP, GAIN_STEP = 0.005, 0.05
"""Resolution of the margins; that of the delay is the integration step [s]."""


def margins(
    subject: Subject, speeds: Array, threads: int, report: Report
) -> dict[str, list[float]]:
    """Measure delay margin [s] and gain margins on the nonlinear car.

    Returns:
        Values at each speed by key of the bounds; nan where the nominal car does not settle.
    """

    def scaled_steering(v: float, factor: float) -> Case:
        return margin_case(subject.vehicle, v)._replace(effect=factor)

    def measured(values: tuple[float, ...]) -> list[float]:
        drives = Drives(subject, speeds, threads, report)
        return last_settling_drive(drives, values, GAIN_STEP, scaled_steering)

    return {
        "delay_margin": delay_margins(Drives(subject, speeds, threads, report)),
        "gain_margin": measured(COARSE_GAINS),
        "gain_reduction_margin": measured(COARSE_REDUCTIONS),
    }


class Drives(NamedTuple):
    """Loops of one car and controller at several speeds, and how they are driven."""

    subject: Subject
    speeds: Array
    """(n,) [m/s]."""
    threads: int
    report: Report


Settled = Callable[[Array, float], bool]
"""Returns whether a log with a period [s] is that of a car that has settled."""


def has_settled(log: Array, period: float) -> bool:
    """Return whether a drive of the margins ends on its road."""
    return rest(log, period, MARGIN_REST_TIME) <= MARGIN_REST


def delay_margins(
    drives: Drives,
    offset: float = MARGIN_OFFSET,
    delays: Sequence[float] = COARSE_DELAYS,
    settled: Settled = has_settled,
) -> list[float]:
    """Return the largest unknown delay with which the nonlinear car settles, at each speed [s].

    Args:
        drives: Car, controller and speeds.
        offset: Distance from the path at the start [m].
        delays: Delays that are tried first; see `last_settling` [s].
        settled: Criterion.
    """
    vehicle = drives.subject.vehicle

    def delayed(v: float, delay: float) -> Case:
        steering = replace(vehicle.steering, delay=vehicle.steering.delay + delay)
        return margin_case(vehicle._replace(steering=steering), v, offset)

    return last_settling_drive(drives, delays, DELAY_STEP, delayed, settled)


def last_settling_drive(
    drives: Drives,
    values: Sequence[float],
    step: float,
    case: Callable[[float, float], Case],
    settled: Settled = has_settled,
) -> list[float]:
    """Return the last value with which the drive at each speed settles; see `last_settling`."""
    subject, speeds, threads, report = drives

    def settles(places: Sequence[int], at: Sequence[float]) -> list[bool]:
        cases = [case(float(speeds[i]), value) for i, value in zip(places, at, strict=True)]
        logs = drive_cases(subject, cases, threads, report)
        return [settled(log, subject.period) for log in logs]

    return last_settling(len(speeds), values, step, settles)


def margin_case(car: Vehicle, v: float, offset: float = MARGIN_OFFSET) -> Case:
    """Return the drive of the margins at a speed [m/s] from an offset [m]."""
    return Case(straight(v, MARGIN_DURATION * max(SLOW / v, 1.0), offset), car)


def last_settling(
    n: int,
    values: Sequence[float],
    step: float,
    settles: Callable[[Sequence[int], Sequence[float]], list[bool]],
) -> list[float]:
    """Return, for each of n loops, the last value before the first one that does not settle.

    All coarse values are tried, so that a loop that settles again beyond its margin does not
    mislead the bisection, which then starts between the last success and the first failure.

    Args:
        n: Number of loops.
        values: Coarse values in the order from harmless to harmful.
        step: Resolution of the bisection.
        settles: Returns whether the loops of the given numbers settle with the given values.

    Returns:
        (n,) nan where the first coarse value fails.
    """
    tried = settles(list(np.repeat(np.arange(n), len(values))), list(np.tile(values, n)))
    good, bad = np.full(n, math.nan), np.full(n, math.nan)
    for i, row in enumerate(np.reshape(tried, (n, len(values)))):
        first = len(values) if row.all() else int(np.argmin(row))
        good[i] = values[first - 1] if first else math.nan
        bad[i] = values[first] if first < len(values) else math.nan
    while (open_ := np.flatnonzero(np.abs(bad - good) > 1.5 * step)).size:
        middle = good[open_] + step * np.rint((bad[open_] - good[open_]) / (2.0 * step))
        good_ones = np.array(settles(open_.tolist(), middle.tolist()))
        good[open_[good_ones]], bad[open_[~good_ones]] = middle[good_ones], middle[~good_ones]
    return [float(value) for value in good]
