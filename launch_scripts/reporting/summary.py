"""The numbers of a report, and the thresholds that they are held against."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, NamedTuple

import numpy as np

from ampc_msgs_config import ros
from ampc_msgs_config.metrics import (
    REVERSAL_BAND,
    distance_driven,
    missed_ticks,
    reversals,
    rms,
    time_where,
)
from ampc_msgs_config.types import RUNGS, SHIFTED_PLAN, Array
from ampc_msgs_config.validation import Checked, number, units_of
from launch_scripts.bags.bag_columns import BagColumns
from launch_scripts.reporting.context import RunContext

Summary = dict[str, float | None]
"""By name of the quantity, SI; None where the bag does not tell."""
AT_LIMIT = 1e-3
"""An angle this near to its bound is at it [rad]."""
NONE = np.empty((0, 2))


class Quantity(NamedTuple):
    """How a number of the summary is shown."""

    label: str
    unit: str = ""
    scale: float = 1.0
    """Shown = scale x SI."""
    how: str = ""
    """How it is worked out, in words."""


DEG, MICRO = math.degrees(1.0), 1e6
BAND = f"direction changes by more than {math.degrees(REVERSAL_BAND):g} deg of the road wheel"
QUANTITIES = {
    "duration": Quantity("Duration", "s", 1.0, "from the first to the last command"),
    "distance": Quantity("Distance", "m", 1.0, "integral of the measured speed"),
    "rms_cross_track_error": Quantity("RMS cross-track error", "m"),
    "p95_cross_track_error": Quantity("95 % cross-track error", "m", 1.0, "of the absolute value"),
    "max_cross_track_error": Quantity("Largest cross-track error", "m"),
    "rms_heading_error": Quantity("RMS heading error", "deg", DEG),
    "max_lateral_acceleration": Quantity("Largest lateral acceleration", "m/s\u00b2", 1.0, "v r"),
    "max_steering": Quantity("Largest steering angle", "deg", DEG),
    "steering_effort": Quantity("Steering effort", "deg/tick", DEG, "RMS increment of the command"),
    "steering_reversals": Quantity("Steering reversals", "", 1.0, BAND),
    "steering_reversal_rate": Quantity("Steering reversals per second", "1/s", 1.0, "the same"),
    "time_at_limit": Quantity("Time at the angle bound", "s", 1.0, "command within 1 mrad of it"),
    "time_constrained": Quantity("Time with active constraints", "s", 1.0, "of the controller"),
    "time_clipped": Quantity("Time clipped by the guard", "s"),
    "ticks": Quantity("Ticks"),
    "missed_ticks": Quantity("Missed ticks", "", 1.0, "gaps between the stamps of commands"),
    "fall_backs": Quantity("Fall-backs", "ticks", 1.0, "ticks below the rung 'slack'"),
    **{f"rung_{name}": Quantity(f"Rung {name.replace('_', ' ')}", "ticks") for name in RUNGS},
    "unsolved_ticks": Quantity("Programmes not solved", "ticks"),
    "stop_requests": Quantity("Stop requests", "", 1.0, "times that one begins"),
    "solve_time_median": Quantity("Solve time, median", "\u00b5s", MICRO),
    "solve_time_p99": Quantity("Solve time, 99 %", "\u00b5s", MICRO),
    "solve_time_max": Quantity("Solve time, largest", "\u00b5s", MICRO),
}


class SupervisionSummary(NamedTuple):
    """What the numbers are worked out from; see `report_drive.Judged`."""

    time: Array
    states: Array
    steering: Array
    errors: Array
    period: float
    columns: BagColumns
    known: RunContext


def summarize(told: SupervisionSummary) -> Summary:
    """Give the numbers of a drive; None where the bag does not tell."""
    found = dict.fromkeys(QUANTITIES, None) | motion(told) | steering(told) | controller(told)
    return {key: found[key] for key in QUANTITIES}


def motion(told: SupervisionSummary) -> Summary:
    """Judge how the car moved."""
    time, speed, yaw_rate = told.time, told.states[:, 3], told.states[:, 5]
    result: Summary = {
        "duration": float(time[-1] - time[0]),
        "distance": distance_driven(time, speed),
        "max_lateral_acceleration": float(np.abs(speed * yaw_rate).max()),
        "ticks": len(time),
        "missed_ticks": missed_ticks(time, told.period),
    }
    error, heading = told.errors[np.isfinite(told.errors[:, 0])].T
    if len(error):
        result |= {
            "rms_cross_track_error": rms(error),
            "p95_cross_track_error": float(np.percentile(np.abs(error), 95)),
            "max_cross_track_error": float(np.abs(error).max()),
            "rms_heading_error": rms(heading),
        }
    return result


def steering(told: SupervisionSummary) -> Summary:
    """Judge how it was steered."""
    angle, time = told.steering, told.time
    if len(angle) < 2:
        return {}
    turns = reversals(angle)
    result: Summary = {
        "max_steering": float(np.abs(angle).max()),
        "steering_effort": rms(np.diff(angle)),
        "steering_reversals": turns,
        "steering_reversal_rate": turns / max(float(time[-1] - time[0]), told.period),
    }
    bound = told.known.angle_bound(told.states[:, 3])
    if bound is not None:
        result["time_at_limit"] = time_where(time, np.abs(angle) >= bound - AT_LIMIT)
    return result


def controller(told: SupervisionSummary) -> Summary:
    """Judge what the controller said about itself."""
    tick, result = told.columns.tick, Summary()

    def spent(name: str) -> float | None:
        values = tick.get(name, NONE)
        return time_where(values[:, 0], values[:, 1] != 0) if len(values) else None

    result["time_constrained"], result["time_clipped"] = (
        spent("active_constraints"),
        spent("clipped"),
    )
    if "converged" in tick:
        result["unsolved_ticks"] = int((tick["converged"][:, 1] == 0).sum())
    if "rung" in tick:
        rung = tick["rung"][:, 1]
        result["fall_backs"] = int((rung >= SHIFTED_PLAN).sum())
        result |= {f"rung_{name}": int((rung == k).sum()) for k, name in enumerate(RUNGS)}
    stops = tick.get("stop_requested", told.columns.values.get(ros.STOP_REQUEST, NONE))
    if len(stops):
        result["stop_requests"] = int((np.diff(stops[:, 1] > 0, prepend=0) > 0).sum())
    if "solve_time" in tick:
        times = tick["solve_time"][:, 1]
        for name, share in (("median", 50), ("p99", 99), ("max", 100)):
            result[f"solve_time_{name}"] = float(np.percentile(times, share))
    return result


@dataclass(frozen=True, kw_only=True)
class Thresholds(Checked):
    """Largest values that pass, SI, named as in the summary; `min_` are smallest ones."""

    rms_cross_track_error: Annotated[float, number(0.0, math.inf, "m")] = math.inf
    p95_cross_track_error: Annotated[float, number(0.0, math.inf, "m")] = math.inf
    max_cross_track_error: Annotated[float, number(0.0, math.inf, "m")] = math.inf
    rms_heading_error: Annotated[float, number(0.0, math.inf, "rad")] = math.inf
    max_lateral_acceleration: Annotated[float, number(0.0, math.inf, "m/s^2")] = math.inf
    max_steering: Annotated[float, number(0.0, math.inf, "rad")] = math.inf
    steering_effort: Annotated[float, number(0.0, math.inf, "rad per tick")] = math.inf
    steering_reversals: Annotated[float, number(0.0, math.inf, "")] = math.inf
    steering_reversal_rate: Annotated[float, number(0.0, math.inf, "1/s")] = math.inf
    time_at_limit: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    time_constrained: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    time_clipped: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    missed_ticks: Annotated[float, number(0.0, math.inf, "ticks")] = math.inf
    fall_backs: Annotated[float, number(0.0, math.inf, "ticks")] = math.inf
    unsolved_ticks: Annotated[float, number(0.0, math.inf, "ticks")] = math.inf
    stop_requests: Annotated[float, number(0.0, math.inf, "")] = math.inf
    solve_time_median: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    solve_time_p99: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    solve_time_max: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    min_duration: Annotated[float, number(0.0, math.inf, "s")] = 0.0
    min_distance: Annotated[float, number(0.0, math.inf, "m")] = 0.0


class Verdict(NamedTuple):
    """One threshold, held against one drive."""

    threshold: str
    quantity: str
    limit: float
    at_least: bool
    value: float | None
    """None: the bag does not tell, which fails."""
    unit: str
    """SI."""

    @property
    def passed(self) -> bool:
        """Whether it is held."""
        if self.value is None or not math.isfinite(self.value):
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit


def verdicts(thresholds: Thresholds, summary: Mapping[str, float | None]) -> list[Verdict]:
    """Hold a summary against the thresholds that were set."""
    result, units = [], units_of(Thresholds)
    for item in fields(thresholds):
        limit = getattr(thresholds, item.name)
        if limit != item.default:
            at_least = item.name.startswith("min_")
            name = item.name.removeprefix("min_")
            unit = units[item.name]
            result.append(Verdict(item.name, name, limit, at_least, summary[name], unit))
    return result
