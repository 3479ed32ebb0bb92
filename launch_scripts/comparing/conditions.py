"""Conditions and metrics of a comparison, without the code that drives."""

from typing import NamedTuple

COMPARED_METRICS = {
    "rms": "rms_error_m",
    "p95": "p95_error_m",
    "max": "max_error_m",
    "mse": "mse_m2",
    "effort": "steering_rms_increment_deg",
    "acceleration": "max_lateral_acceleration",
    "solve_time": "solve_time_p50_us",
}
"""Keys of the compared metrics by command-line name; small values are better for all of them."""


class Conditions(NamedTuple):
    """Common conditions of all cells; the controllers do not know friction, delay and noise."""

    vehicle: str = "paper"
    settings: str = "table3"
    friction: float | None = None
    """Friction of the road; None: that of the tyres."""
    delay: float = 0.0
    """Additional delay of the real steering [s]."""
    noise: str = ""
    seed: int = 0
