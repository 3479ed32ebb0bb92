"""Metrics of a finished drive: one table, from which every result, report and comparison selects.

A metric is a function of a `DriveRecord`, which `record_of` builds from a drive and its path.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.paths.path import Path, Progress
from ampc_msgs_config.types import NANOSECONDS, RUNGS, SHIFTED_PLAN, Array, VehicleState

REVERSAL_BAND = math.radians(0.2)
"""Smallest movement of the road wheel that counts as a reversal; 3 deg at a steering wheel with a
ratio of 16 to 1."""
LOST = 10.0
"""Cross-track error beyond which a car counts as lost [m]."""
AT_LIMIT = 1e-3
"""Largest distance from the bound at which an angle counts as bounded [rad]."""
DEG, MICRO = math.degrees(1.0), 1e6
EMPTY = np.empty(0)
LOWER, NEUTRAL = -1, 0
"""Directions of improvement: small values are better, or neither."""


class Drive(NamedTuple):
    """Measured states and commands of a drive, aligned by control tick."""

    states: list[VehicleState]
    """State for each command, at `base_link`."""
    steering: Array
    """Commanded angle (n,) [rad]."""
    solve_time: Array
    """Computation time of the controller, (m,) [s]."""


class DriveRecord(NamedTuple):
    """Input of all metrics. An empty array or None means that the quantity was not recorded."""

    time: Array
    """Time of each tick (n,) [s]."""
    period: float
    """Sample time of the controller [s]."""
    error: Array = EMPTY
    """Cross-track error of the centre of gravity at the ticks with a reference path (k,) [m]."""
    heading: Array = EMPTY
    """Heading error at these ticks (k,) [rad]."""
    lateral: Array = EMPTY
    """Y - Y_ref(X) (n,) [m]; nan where the path is not a graph over X."""
    speed: Array = EMPTY
    """Measured longitudinal speed (n,) [m/s]."""
    yaw_rate: Array = EMPTY
    """Measured yaw rate (n,) [rad/s]."""
    steering: Array = EMPTY
    """Commanded angle (n,) [rad]."""
    angle_bound: Array | None = None
    """Bound of the controller on the angle (n,) [rad]."""
    solve_time: Array = EMPTY
    """Computation time of the controller (m,) [s]."""
    tick: Mapping[str, Array] = {}
    """Published quantities of the controller by name, (m, 2): time [s] and value."""


Value = float | None
"""Value of a metric; None where the record does not contain the required quantities."""
Function = Callable[[DriveRecord], Value]


class Metric(NamedTuple):
    """One number that describes a drive."""

    key: str
    """Name in JSON files; it contains the unit where this is not SI."""
    title: str
    unit: str
    """Unit for display."""
    function: Function
    scale: float = 1.0
    """Factor from the value to the displayed number."""
    direction: int = LOWER
    """LOWER or NEUTRAL: which values are better."""


def evaluate(drive: Drive, path: Path, base_link_to_cg: float, period: float) -> dict[str, float]:
    """Return the metrics of the result table by key.

    Args:
        drive: At least two ticks.
        path: Reference path.
        base_link_to_cg: Distance from the reference point of the states to the centre of gravity
            [m].
        period: Sample time of the controller [s].
    """
    record = record_of(drive, path, base_link_to_cg, period)
    values = measure(RESULT, record)
    return {key: math.nan if value is None else value for key, value in values.items()}


def measure(keys: Iterable[str], record: DriveRecord) -> dict[str, Value]:
    """Return the values of the metrics with the given keys."""
    return {key: METRICS[key].function(record) for key in keys}


def record_of(drive: Drive, path: Path, base_link_to_cg: float, period: float) -> DriveRecord:
    """Return the record of a drive along a path; for the arguments see `evaluate`."""
    error, heading = errors(drive, path, base_link_to_cg).T
    return DriveRecord(
        ticks(drive),
        period,
        error,
        heading,
        lateral_errors(drive, path, base_link_to_cg),
        np.array([state.v_x for state in drive.states]),
        np.array([state.yaw_rate for state in drive.states]),
        drive.steering,
        solve_time=drive.solve_time,
    )


def errors(drive: Drive, path: Path, base_link_to_cg: float) -> Array:
    """Return cross-track [m] and heading error [rad] of the centre of gravity (n, 2)."""
    progress = Progress(path)
    return np.array([progress.errors(at_distance(s, base_link_to_cg)) for s in drive.states])


def lateral_errors(drive: Drive, path: Path, base_link_to_cg: float) -> Array:
    """Return Y - Y_ref(X) (n,) [m], the error of the paper.

    All values are nan where the path is not a graph over X.
    """
    from ampc_msgs_config.paths.path_frame import path_frame, place, set_point  # not for a report

    try:
        frame = path_frame(path)
    except ValueError:
        return np.full(len(drive.states), np.nan)
    centres = [at_distance(s, base_link_to_cg) for s in drive.states]
    places = [place(frame, centre.x, centre.y, centre.yaw) for centre in centres]
    return np.array([Y - set_point(frame, X) for X, Y, _ in places], dtype=float)


def ticks(drive: Drive) -> Array:
    """Return the time of each tick since the first (n,) [s]."""
    stamps = np.array([state.stamp_ns for state in drive.states])
    return np.asarray((stamps - stamps[0]) / NANOSECONDS)


def rms(values: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def missed_ticks(time: Array, period: float) -> int:
    """Return the number of missing ticks between stamps (n,) [s] for a sample time [s]."""
    gaps = np.rint(np.diff(time) / period).astype(int)
    return int(np.maximum(gaps - 1, 0).sum())


def reversals(angle: Array, band: float = REVERSAL_BAND) -> int:
    """Count the direction changes of a wheel angle (n,) [rad] that exceed `band` [rad]."""
    count, direction, low, high = 0, 0, math.inf, -math.inf
    for value in angle.tolist():
        low, high = min(low, value), max(high, value)
        turned = -1 if value < high - band else 1 if value > low + band else 0
        if turned and turned != direction:
            count += direction != 0
            direction = turned
        if turned:
            low = high = value
    return count


def time_where(time: Array, active: NDArray[np.bool_]) -> float:
    """Return the duration of an active state [s]; each tick (n,) [s] lasts until the next one."""
    lasting = np.diff(time)
    return float(lasting[active[:-1]].sum())


def distance_driven(time: Array, speed: Array) -> float:
    """Return the integral of the speed (n,) [m/s] over time (n,) [s], in [m]."""
    return float(np.sum(np.diff(time) * (np.abs(speed[1:]) + np.abs(speed[:-1])) / 2))


def of(field: str, function: Callable[[Array], float], least: int = 1) -> Function:
    """Return the metric function of one field; it needs at least `least` values."""

    def value(record: DriveRecord) -> Value:
        values: Array = getattr(record, field)
        return function(values) if len(values) >= least else None

    return value


def of_tick(name: str, function: Callable[[Array, Array], float]) -> Function:
    """Return the metric function of time (m,) [s] and values (m,) of one published quantity."""

    def value(record: DriveRecord) -> Value:
        rows = record.tick.get(name, EMPTY)
        return function(*rows.T) if len(rows) else None

    return value


def largest(values: Array) -> float:
    """Return the largest absolute value."""
    return float(np.abs(values).max())


def percentile(share: float, scale: float = 1.0) -> Callable[[Array], float]:
    """Return the function for a percentile of the absolute values, each times `scale`."""
    return lambda values: float(np.percentile(np.abs(values) * scale, share))


def last_rms(seconds: float) -> Function:
    """Return the metric function of the RMS cross-track error of the last seconds [m]."""

    def value(record: DriveRecord) -> Value:
        last = record.error[-round(seconds / record.period) :]
        return rms(last) if len(last) else None

    return value


def distance(record: DriveRecord) -> Value:
    """Return the distance driven [m]."""
    return distance_driven(record.time, record.speed) if len(record.speed) else None


def max_lateral_acceleration(record: DriveRecord) -> Value:
    """Return the largest product of speed and yaw rate [m/s^2]."""
    return largest(record.speed * record.yaw_rate) if len(record.yaw_rate) else None


def reversal_rate(record: DriveRecord) -> Value:
    """Return the reversals per second [1/s]; the duration counts as one period at least."""
    if len(record.steering) < 2:
        return None
    return reversals(record.steering) / max(duration(record.time), record.period)


def time_at_limit(record: DriveRecord) -> Value:
    """Return the duration of commands within `AT_LIMIT` of the angle bound [s]."""
    if record.angle_bound is None or len(record.steering) < 2:
        return None
    return time_where(record.time, np.abs(record.steering) >= record.angle_bound - AT_LIMIT)


def count_begins(_: Array, flag: Array) -> int:
    """Return the number of times that a flag is set."""
    return int((np.diff(flag > 0, prepend=0) > 0).sum())


def mean_square(values: Array) -> float:
    """Return the mean of the squares."""
    return float(np.mean(values**2))


def diverged(error: Array) -> float:
    """Return 1 where the car is lost at the end of the drive, else 0."""
    return float(not abs(error[-1]) < LOST)


def duration(time: Array) -> float:
    """Return the time from the first to the last tick [s]."""
    return float(time[-1] - time[0])


def rms_deg(angle: Array) -> float:
    """Return the RMS of an angle (n,) [rad] in [deg]."""
    return math.degrees(rms(angle))


def rms_step(angle: Array) -> float:
    """Return the RMS increment of an angle (n,) [rad]."""
    return rms(np.diff(angle))


def rms_increment_deg(angle: Array) -> float:
    """Return the RMS increment of an angle (n,) [rad] in [deg]."""
    return rms(np.degrees(np.diff(angle)))


def largest_deg(angle: Array) -> float:
    """Return the largest absolute value of an angle (n,) [rad] in [deg]."""
    return float(np.degrees(largest(angle)))


def range_deg(angle: Array) -> float:
    """Return largest minus smallest value of an angle (n,) [rad] in [deg]."""
    return math.degrees(np.ptp(angle))


def time_of(name: str) -> Function:
    """Return the metric function of the duration in which a quantity is not zero [s]."""
    return of_tick(name, lambda time, values: time_where(time, values != 0))


def count_of(name: str, index: int) -> Function:
    """Return the metric function of the number of ticks at which a quantity has a value."""
    return of_tick(name, lambda _, values: int((values == index).sum()))


def count_fallback(_: Array, rung: Array) -> int:
    """Return the number of ticks at which a fallback steered."""
    return int((rung >= SHIFTED_PLAN).sum())


def solve_time_metrics(key: str, key_us: str, title: str, share: float) -> tuple[Metric, Metric]:
    """Return a percentile of the solve time [s], and the same [us]."""
    title, unit = f"Solve time, {title}", "\u00b5s"
    in_us = of("solve_time", percentile(share, MICRO))
    return (
        Metric(f"solve_time_{key}", title, unit, of("solve_time", percentile(share)), MICRO),
        Metric(f"solve_time_{key_us}_us", title, unit, in_us),
    )


# Title, unit and function of metrics that JSON files contain under two keys.
RMS = "RMS cross-track error", "m", of("error", rms)
P95 = "95th percentile of the cross-track error", "m", of("error", percentile(95.0))
MAX = "Largest cross-track error", "m", of("error", largest)
ALL_METRICS: tuple[Metric, ...] = (
    # Drive
    Metric("ticks", "Ticks", "", of("time", len), direction=NEUTRAL),
    Metric("missed_ticks", "Missed ticks", "", lambda r: missed_ticks(r.time, r.period)),
    Metric("duration", "Duration", "s", of("time", duration), direction=NEUTRAL),
    Metric("distance", "Distance", "m", distance, direction=NEUTRAL),
    # Tracking error
    Metric("mse_m2", "MSE of the cross-track error", "m\u00b2", of("error", mean_square)),
    Metric("mse_lateral_m2", "MSE of Y - Y_ref(X)", "m\u00b2", of("lateral", mean_square)),
    Metric("rms_error_m", *RMS),
    Metric("p95_error_m", *P95),
    Metric("max_error_m", *MAX),
    Metric("rms_cross_track_error", *RMS),
    Metric("p95_cross_track_error", *P95),
    Metric("max_cross_track_error", *MAX),
    Metric("last_3_s_rms_m", "RMS error of the last 3 s", "m", last_rms(3.0)),
    Metric("last_5_s_rms_m", "RMS error of the last 5 s", "m", last_rms(5.0)),
    Metric("diverged", "Lost at the end", "", of("error", diverged)),
    Metric("rms_heading_error", "RMS heading error", "deg", of("heading", rms), DEG),
    Metric("rms_heading_error_deg", "RMS heading error", "deg", of("heading", rms_deg)),
    # Car and steering
    Metric(
        "max_lateral_acceleration",
        "Largest lateral acceleration",
        "m/s\u00b2",
        max_lateral_acceleration,
    ),
    Metric("steering_max_deg", "Largest steering angle", "deg", of("steering", largest_deg)),
    Metric("max_steering", "Largest steering angle", "deg", of("steering", largest, 2), DEG),
    Metric("steering_range_deg", "Range of the steering angle", "deg", of("steering", range_deg)),
    Metric(
        "steering_rms_increment_deg",
        "Steering effort",
        "deg/tick",
        of("steering", rms_increment_deg, 2),
    ),
    Metric("steering_effort", "Steering effort", "deg/tick", of("steering", rms_step, 2), DEG),
    Metric("steering_reversals", "Steering reversals", "", of("steering", reversals, 2)),
    Metric("steering_reversal_rate", "Steering reversals per second", "1/s", reversal_rate),
    Metric("time_at_limit", "Time at the angle bound", "s", time_at_limit),
    # Controller
    Metric("time_constrained", "Time with active constraints", "s", time_of("active_constraints")),
    Metric("time_clipped", "Time clipped by the guard", "s", time_of("clipped")),
    Metric("fall_backs", "Fallback", "ticks", of_tick("rung", count_fallback)),
    *(
        Metric(f"rung_{name}", f"Rung {name.replace('_', ' ')}", "ticks", count_of("rung", k))
        for k, name in enumerate(RUNGS)
    ),
    Metric("unsolved_ticks", "Unsolved QPs", "ticks", count_of("converged", 0)),
    Metric("stop_requests", "Stop requests", "", of_tick("stop_requested", count_begins)),
    *solve_time_metrics("median", "p50", "median", 50.0),
    *solve_time_metrics("p99", "p99", "99th percentile", 99.0),
    *solve_time_metrics("max", "max", "largest", 100.0),
)
METRICS = {metric.key: metric for metric in ALL_METRICS}
BAND = f"direction changes by more than {math.degrees(REVERSAL_BAND):g} deg of the road wheel"
NOTES = {
    "missed_ticks": "gaps between the stamps of commands",
    "duration": "from the first to the last command",
    "distance": "integral of the measured speed",
    "p95_cross_track_error": "of the absolute value",
    "max_lateral_acceleration": "speed times yaw rate",
    "steering_effort": "RMS increment of the command",
    "steering_reversals": BAND,
    "steering_reversal_rate": BAND,
    "time_at_limit": "command within 1 mrad of the bound",
    "time_constrained": "of the controller",
    "fall_backs": "ticks below the rung 'slack'",
    "stop_requests": "number of times that a request begins",
}
"""Definition of metrics whose title is not enough, by key."""
RESULT = (
    *("ticks", "missed_ticks", "mse_m2", "mse_lateral_m2", "rms_error_m", "p95_error_m"),
    *("max_error_m", "rms_heading_error_deg", "steering_rms_increment_deg"),
    *("steering_reversals", "steering_max_deg"),
    *("solve_time_p50_us", "solve_time_p99_us", "solve_time_max_us"),
)
"""Keys of the result of a run."""
