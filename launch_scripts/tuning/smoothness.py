"""Choice of one gain set for each node so that neighbouring nodes are similar.

Between two nodes the pole is interpolated. Where the best gains of two nodes lie in different
valleys of the fitness, the interpolation crosses the ridge between them. A penalty on the jumps
between neighbours keeps all nodes in the same valley unless the gain is larger than the penalty.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ampc_ros.mpc.gain_table import Gains

POLE_JUMP = 0.25
"""Jump of the pole whose penalty is the factor e of the fitness. The penalty grows with the fourth
power: 3 % for 0.1, 50 % for 0.2."""
RATIO_WEIGHT = 0.02
"""Penalty for a jump of R/Q by a decade, squared: 2 % of the fitness."""


def jump_penalty(one: Gains, other: Gains) -> float:
    """Return the penalty for two neighbouring nodes, added to the logarithm of the fitness."""
    pole = one.laguerre_pole - other.laguerre_pole
    ratios = [each.increment_weight / each.output_weight for each in (one, other)]
    return (pole / POLE_JUMP) ** 4 + RATIO_WEIGHT * math.log10(ratios[0] / ratios[1]) ** 2


def smoothest(candidates: Sequence[Sequence[tuple[Gains, float]]]) -> list[Gains]:
    """Choose one candidate for each node so that fitness and penalties together are least.

    The choice is exact: dynamic programming along the nodes (Viterbi).

    Args:
        candidates: Gains and their fitness for each node; those with infinite fitness are not
            chosen unless a node has no other.
    """
    sets = [[gains for gains, _ in node] for node in candidates]
    total = np.log([value for _, value in candidates[0]])
    before: list[npt.NDArray[np.intp]] = []
    for i, node in enumerate(candidates[1:], start=1):
        penalty = [[jump_penalty(a, b) for a in sets[i - 1]] for b in sets[i]]
        sums = np.array(penalty) + total
        before.append(np.argmin(sums, axis=1))
        total = sums.min(axis=1) + np.log([value for _, value in node])
    chosen = [int(np.argmin(total))]
    for step in reversed(before):
        chosen.append(int(step[chosen[-1]]))
    return [node[k] for node, k in zip(sets, reversed(chosen), strict=True)]
