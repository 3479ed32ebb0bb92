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
STAMP_JITTER, CLOCK_DRIFT = 0.25, 0.02
"""What a gap between stamps may lack of a missed tick, and its error that counts for nothing
[periods]."""
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
    note: str = ""
    """Definition, where the title is not enough."""
    direction: int = LOWER
    """LOWER or NEUTRAL: which values are better."""


def evaluate_drive(
    drive: Drive, path: Path, base_link_to_cg: float, period: float
) -> dict[str, float]:
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
    """Return the record of a drive along a path; for the arguments see `evaluate_drive`."""
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
    return int(missed_before(time, period).sum())


def missed_before(time: Array, period: float) -> NDArray[np.int64]:
    """Return the number of missing ticks before each stamp but the first (n - 1,).

    Args:
        time: Stamps (n,) [s].
        period: Sample time [s].

    Note:
        The stamps are those of the answered states, which jitter: a short gap after a long one
        makes up for it. Gaps up to CLOCK_DRIFT too long are those of a slow clock.
    """
    missed = np.zeros(max(len(time) - 1, 0), np.int64)
    lag = 0.0
    for i, gap in enumerate((np.diff(time) / period).tolist()):
        lag = max(lag + gap - 1.0 - CLOCK_DRIFT, 0.0)
        missed[i] = int(lag + STAMP_JITTER)
        lag -= min(float(missed[i]), lag)
    return missed


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


def reversal_rate(record: DriveRecord) -> Value:
    """Return the reversals per second [1/s]; the duration counts as one period at least."""
    if len(record.steering) < 2:
        return None
    return reversals(record.steering) / max(float(np.ptp(record.time)), record.period)


def time_at_limit(record: DriveRecord) -> Value:
    """Return the duration of commands within `AT_LIMIT` of the angle bound [s]."""
    if record.angle_bound is None or len(record.steering) < 2:
        return None
    return time_where(record.time, np.abs(record.steering) >= record.angle_bound - AT_LIMIT)


def count_of(name: str, index: int) -> Function:
    """Return the metric function of the number of ticks at which a quantity has a value."""
    return of_tick(name, lambda _, values: int((values == index).sum()))


def in_displayed_unit(metric: Metric, key: str) -> Metric:
    """Return a metric under another key, with values in its displayed unit."""

    def function(record: DriveRecord) -> Value:
        value = metric.function(record)
        return None if value is None else value * metric.scale

    return metric._replace(key=key, function=function, scale=1.0)


BAND = f"direction changes by more than {math.degrees(REVERSAL_BAND):g} deg of the road wheel"
SOLVE_TIMES = (
    ("median", "p50", "median", 50.0),
    ("p99", "p99", "99th percentile", 99.0),
    ("max", "max", "largest", 100.0),
)
"""Percentiles of the solve time: end of the key in SI, middle of the key in us, title, share."""
# fmt: off
TABLE: tuple[Metric, ...] = (
    # Drive
    Metric("ticks", "Ticks", "", of("time", len), direction=NEUTRAL),
    Metric("missed_ticks", "Missed ticks", "", lambda r: missed_ticks(r.time, r.period),
           note="gaps between the stamps of commands"),
    Metric("duration", "Duration", "s", of("time", lambda t: float(t[-1] - t[0])),
           note="from the first to the last command", direction=NEUTRAL),
    Metric("distance", "Distance", "m",
           lambda r: distance_driven(r.time, r.speed) if len(r.speed) else None,
           note="integral of the measured speed", direction=NEUTRAL),
    # Tracking error
    Metric("mse_m2", "MSE of the cross-track error", "m\u00b2",
           of("error", lambda e: float(np.mean(e**2)))),
    Metric("mse_lateral_m2", "MSE of Y - Y_ref(X)", "m\u00b2",
           of("lateral", lambda e: float(np.mean(e**2)))),
    Metric("rms_cross_track_error", "RMS cross-track error", "m", of("error", rms)),
    Metric("p95_cross_track_error", "95th percentile of the cross-track error", "m",
           of("error", percentile(95.0)), note="of the absolute value"),
    Metric("max_cross_track_error", "Largest cross-track error", "m", of("error", largest)),
    Metric("last_3_s_rms_m", "RMS error of the last 3 s", "m", last_rms(3.0)),
    Metric("last_5_s_rms_m", "RMS error of the last 5 s", "m", last_rms(5.0)),
    Metric("diverged", "Lost at the end", "", of("error", lambda e: float(not abs(e[-1]) < LOST))),
    Metric("rms_heading_error", "RMS heading error", "deg", of("heading", rms), DEG),
    # Car and steering
    Metric("max_lateral_acceleration", "Largest lateral acceleration", "m/s\u00b2",
           lambda r: largest(r.speed * r.yaw_rate) if len(r.yaw_rate) else None,
           note="speed times yaw rate"),
    Metric("max_steering", "Largest steering angle", "deg", of("steering", largest, 2), DEG),
    Metric("steering_range_deg", "Range of the steering angle", "deg",
           of("steering", lambda u: math.degrees(np.ptp(u)))),
    Metric("steering_rms_increment_deg", "Steering effort", "deg/tick",
           of("steering", lambda u: rms(np.degrees(np.diff(u))), 2)),
    Metric("steering_effort", "Steering effort", "deg/tick",
           of("steering", lambda u: rms(np.diff(u)), 2), DEG, "RMS increment of the command"),
    Metric("steering_reversals", "Steering reversals", "", of("steering", reversals, 2),
           note=BAND),
    Metric("steering_reversal_rate", "Steering reversals per second", "1/s", reversal_rate,
           note=BAND),
    Metric("time_at_limit", "Time at the angle bound", "s", time_at_limit,
           note="command within 1 mrad of the bound"),
    # Controller
    Metric("time_constrained", "Time with active constraints", "s",
           of_tick("active_constraints", lambda t, n: time_where(t, n != 0)),
           note="of the controller"),
    Metric("time_clipped", "Time clipped by the guard", "s",
           of_tick("clipped", lambda t, limit: time_where(t, limit != 0))),
    Metric("fall_backs", "Fallback", "ticks",
           of_tick("rung", lambda _, rung: int((rung >= SHIFTED_PLAN).sum())),
           note="ticks below the rung 'slack'"),
    *(Metric(f"rung_{name}", f"Rung {name.replace('_', ' ')}", "ticks", count_of("rung", k))
      for k, name in enumerate(RUNGS)),
    Metric("unsolved_ticks", "Unsolved QPs", "ticks", count_of("converged", 0)),
    Metric("stop_requests", "Stop requests", "",
           of_tick("stop_requested", lambda _, on: int((np.diff(on > 0, prepend=0) > 0).sum())),
           note="number of times that a request begins"),
    *(Metric(f"solve_time_{si}", f"Solve time, {title}", "\u00b5s",
             of("solve_time", percentile(share)), MICRO) for si, _, title, share in SOLVE_TIMES),
    *(Metric(f"solve_time_{us}_us", f"Solve time, {title}", "\u00b5s",
             of("solve_time", percentile(share, MICRO))) for _, us, title, share in SOLVE_TIMES),
)
# fmt: on
ALIASES = {
    "rms_error_m": "rms_cross_track_error",
    "p95_error_m": "p95_cross_track_error",
    "max_error_m": "max_cross_track_error",
    "rms_heading_error_deg": "rms_heading_error",
    "steering_max_deg": "max_steering",
}
"""Keys of results and comparisons: the same metric in its displayed unit."""
METRICS = {metric.key: metric for metric in TABLE}
METRICS |= {alias: in_displayed_unit(METRICS[key], alias) for alias, key in ALIASES.items()}
RESULT = (
    *("ticks", "missed_ticks", "mse_m2", "mse_lateral_m2", "rms_error_m", "p95_error_m"),
    *("max_error_m", "rms_heading_error_deg", "steering_rms_increment_deg"),
    *("steering_reversals", "steering_max_deg"),
    *("solve_time_p50_us", "solve_time_p99_us", "solve_time_max_us"),
)
"""Keys of the result of a run."""
