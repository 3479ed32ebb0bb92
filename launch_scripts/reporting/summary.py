"""Summary of a report: its metrics, thresholds and verdicts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import NamedTuple

from ampc_msgs_config.metrics import Value
from ampc_msgs_config.parameters import Checked, number
from ampc_msgs_config.types import RUNGS

SUMMARY = (
    *("duration", "distance"),
    *("rms_cross_track_error", "p95_cross_track_error", "max_cross_track_error"),
    *("rms_heading_error", "max_lateral_acceleration", "max_steering", "steering_effort"),
    *("steering_reversals", "steering_reversal_rate"),
    *("time_at_limit", "time_constrained", "time_clipped", "ticks", "missed_ticks"),
    *("fall_backs", *(f"rung_{name}" for name in RUNGS), "unsolved_ticks", "stop_requests"),
    *("solve_time_median", "solve_time_p99", "solve_time_max"),
)
"""Keys of the metrics of a report, in the order of its summary."""


@dataclass(frozen=True, kw_only=True)
class Thresholds(Checked):
    """Largest values that pass, SI, with the names of the metrics; `min_`: smallest values."""

    rms_cross_track_error: float = number(0.0, math.inf, "m", math.inf)
    p95_cross_track_error: float = number(0.0, math.inf, "m", math.inf)
    max_cross_track_error: float = number(0.0, math.inf, "m", math.inf)
    rms_heading_error: float = number(0.0, math.inf, "rad", math.inf)
    max_lateral_acceleration: float = number(0.0, math.inf, "m/s^2", math.inf)
    max_steering: float = number(0.0, math.inf, "rad", math.inf)
    steering_effort: float = number(0.0, math.inf, "rad per tick", math.inf)
    steering_reversals: float = number(0.0, math.inf, "", math.inf)
    steering_reversal_rate: float = number(0.0, math.inf, "1/s", math.inf)
    time_at_limit: float = number(0.0, math.inf, "s", math.inf)
    time_constrained: float = number(0.0, math.inf, "s", math.inf)
    time_clipped: float = number(0.0, math.inf, "s", math.inf)
    missed_ticks: float = number(0.0, math.inf, "ticks", math.inf)
    fall_backs: float = number(0.0, math.inf, "ticks", math.inf)
    unsolved_ticks: float = number(0.0, math.inf, "ticks", math.inf)
    stop_requests: float = number(0.0, math.inf, "", math.inf)
    solve_time_median: float = number(0.0, math.inf, "s", math.inf)
    solve_time_p99: float = number(0.0, math.inf, "s", math.inf)
    solve_time_max: float = number(0.0, math.inf, "s", math.inf)
    min_duration: float = number(0.0, math.inf, "s", 0.0)
    min_distance: float = number(0.0, math.inf, "m", 0.0)


class Verdict(NamedTuple):
    """Result of one threshold for one drive."""

    threshold: str
    quantity: str
    limit: float
    at_least: bool
    value: Value
    """None: the bag lacks the data, which fails."""
    unit: str
    """SI."""

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit."""
        if self.value is None or not math.isfinite(self.value):
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    @property
    def measured(self) -> str:
        """The value with its unit, as text."""
        if self.value is None:
            return "not in the bag"
        return f"{self.value:.4g} {self.unit}".strip()

    @property
    def bound(self) -> str:
        """The limit with its relation and unit, as text."""
        sign = "\u2265" if self.at_least else "\u2264"
        return f"{sign} {self.limit:.6g} {self.unit}".strip()


def check_thresholds(thresholds: Thresholds, metrics: Mapping[str, Value]) -> list[Verdict]:
    """Return a verdict for each threshold that differs from its default."""
    result = []
    for item in fields(thresholds):
        limit = getattr(thresholds, item.name)
        if limit != item.default:
            at_least = item.name.startswith("min_")
            name = item.name.removeprefix("min_")
            unit = item.metadata["unit"]
            result.append(Verdict(item.name, name, limit, at_least, metrics[name], unit))
    return result
