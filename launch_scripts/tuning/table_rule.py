"""Rule that decides whether a table or a single gain set is written: `doc/table_rule.md`."""

import math
from collections.abc import Sequence

from launch_scripts.tuning.task import geometric_mean

MIN_SAVING = 0.10
"""Share of the single set's fitness that a table must save between the nodes."""
MAX_LOSS = 0.02
"""Share of the hand-set gains' fitness by which a table may be worse at one speed."""


def saving(table: Sequence[float], single: Sequence[float]) -> float:
    """Return the share of the single set's fitness that the table saves, in the geometric mean.

    Args:
        table: Fitness of the table at some speeds; infinite where a car is lost.
        single: Fitness of the single set at the same speeds.
    """
    ours, other = float(geometric_mean(table)), float(geometric_mean(single))
    if math.isinf(ours):
        return -math.inf
    return 1.0 - ours / other


def worst_ratio(gains: Sequence[float], reference: Sequence[float]) -> float:
    """Return the largest ratio of the fitness of some gains to a reference, over the speeds.

    Speeds at which the reference loses a car are left out; losing one elsewhere is infinite.
    """
    pairs = zip(gains, reference, strict=True)
    return max((a / b for a, b in pairs if math.isfinite(b)), default=0.0)
