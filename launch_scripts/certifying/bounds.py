"""Acceptance bounds of a certificate with their reasons: the only place where they are defined.

The bounds were fixed before any shipped table had been measured. A table that misses one is not
certified in this point; the bound stays.
"""

from typing import NamedTuple


class Bound(NamedTuple):
    """Bound of a quantity, which holds at every speed of the grid."""

    key: str
    """Name in the JSON file."""
    title: str
    """Name on the page."""
    unit: str
    limit: float
    at_least: bool
    """Whether the limit is a lower bound."""
    reason: str

    def holds(self, value: float) -> bool:
        """Check a value against the limit; NaN fails."""
        return value >= self.limit if self.at_least else value <= self.limit


def most(key: str, title: str, unit: str, limit: float, reason: str) -> Bound:
    """Return an upper bound."""
    return Bound(key, title, unit, limit, False, reason)


def least(key: str, title: str, unit: str, limit: float, reason: str) -> Bound:
    """Return a lower bound."""
    return Bound(key, title, unit, limit, True, reason)


LANE_REASON = (
    "half of what a lane of 3.5 m leaves beside a car of 1.8 m (0.85 m), less 0.35 m for map and "
    "localisation; target of `make acceptance` for cars that differ from the model"
)
SETTLED_REASON = "target of `make acceptance` for joining a road from 3 m"

ACCEPTANCE_BOUNDS = (
    most(
        "loop_time_constant",
        "slowest mode of the loop, estimator held: time constant",
        "s",
        2.0,
        "4 time constants (2 % left) pass before the 9 s after which the tuner expects a settled "
        "car",
    ),
    most(
        "estimator_time_constant",
        "slowest mode with the disturbance estimator: time constant",
        "s",
        3.3,
        "the spectral radius of 0.97 per 0.1 s that `make acceptance` demands",
    ),
    least(
        "delay_margin",
        "delay margin",
        "s",
        0.065,
        "`make acceptance` demands 80 ms of the linear loop, which is optimistic by up to 15 ms",
    ),
    least(
        "gain_margin",
        "gain margin, steering too effective: factor",
        "",
        2.0,
        "6 dB, the least usual gain margin (Astrom and Murray, Feedback Systems: 2 to 5)",
    ),
    most(
        "gain_reduction_margin",
        "gain margin, steering too weak: factor",
        "",
        0.5,
        "the gain reduction that an LQ regulator tolerates (Safonov and Athans, 1977)",
    ),
    most(
        "gain_step",
        "step of the lateral acceleration due to a change of the gains",
        "m/s^2",
        0.315,
        "`not uncomfortable` in ISO 2631-1, annex C",
    ),
    most(
        "joining_rest",
        "joining from 0.5 to 5 m: largest error in the last 3 s",
        "m",
        0.05,
        SETTLED_REASON,
    ),
    most("joining_overshoot", "joining from 0.5 to 5 m: overshoot", "m", 0.5, LANE_REASON),
    most(
        "lane_change",
        "lane change at 2.5 m/s^2: largest error",
        "m",
        0.15,
        "target of `make acceptance` for a lane change of an independent car at 15 m/s",
    ),
    most("gust", "gust of 15 m/s from the side, 2 s: largest error", "m", 0.5, LANE_REASON),
    most("friction", "lane change, friction 0.5: largest error", "m", 0.5, LANE_REASON),
    most(
        "friction_rest",
        "joining from 3 m, friction 0.3: error in the last 3 s",
        "m",
        0.05,
        SETTLED_REASON,
    ),
    most("friction_overshoot", "joining from 3 m, friction 0.3: overshoot", "m", 0.5, LANE_REASON),
    most("noise", "lane change with noise x1: largest measured error", "m", 0.5, LANE_REASON),
    most(
        "noise_steering_rate",
        "lane change with noise x1: RMS steering rate",
        "deg/s",
        30.0,
        "3 deg per tick of 0.1 s, target of `make acceptance` with noise",
    ),
    most("spread", "lane change, car within its spread: largest error", "m", 0.5, LANE_REASON),
    most(
        "spread_rest",
        "joining from 3 m, car within its spread: error in the last 3 s",
        "m",
        0.05,
        SETTLED_REASON,
    ),
    most(
        "spread_overshoot",
        "joining from 3 m, car within its spread: overshoot",
        "m",
        0.5,
        LANE_REASON,
    ),
)
"""All bounds, in the order of the page."""
