"""Weights of a swarm by the number of the generation, Eqs. (32)-(34)."""

import math

from ampc_ros.pso.settings import PsoSettings
from ampc_ros.pso.swarm import Weights

INCREMENTS = ((0.2, 0.05), (0.35, 0.02), (0.75, -0.035), (math.inf, -0.0015))
"""alpha of Eq. (34), where g/G is below the first number."""


def scheduled(settings: PsoSettings, g: int) -> Weights:
    """Weights of the move that follows generation g, of all variants but `adaptive`.

    Note:
        Past the end of the schedule its last values stay, but for c_1 and c_2, which Eq. (34)
        moves on. The increments of Eq. (34) are absolute: how far c_1 and c_2 go depends on G. Its
        overlapping branches are read as half-open intervals. The authors' code compares the
        number of particles instead of the generation: always the same branch.
    """
    G = settings.schedule
    c_1, c_2 = settings.initial_cognitive, settings.initial_social
    if settings.variant in ("proposed", "authors_code"):
        authors = settings.variant == "authors_code"
        times = ((settings.particles - 1 if authors else k) / G for k in range(g))
        change = sum(_increment(time) for time in times)
        c_1, c_2 = c_1 + change, c_2 - change
    return Weights(_inertia(settings, min(g / G, 1.0), g), c_1, c_2)


def _inertia(settings: PsoSettings, time: float, g: int) -> float:
    """Give omega of Eq. (32), (33), or of the damped or classic swarm; time is g/G."""
    high, low = settings.max_inertia, settings.min_inertia
    if settings.variant == "linear":
        return high - (high - low) * time
    if settings.variant == "damped":
        return high * settings.inertia_damping**g
    if settings.variant == "classic":
        return high
    lambda_1, lambda_2 = settings.inertia_decay, settings.inertia_divisor
    return low + math.exp(high - lambda_1 * (high + low) * time) / lambda_2


def _increment(time: float) -> float:
    return next(alpha for end, alpha in INCREMENTS if time < end)
