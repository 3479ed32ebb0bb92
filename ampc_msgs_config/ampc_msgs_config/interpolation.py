"""Tables that compiled code reads."""

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.paths.path import Array


@compiled
def section(place: float, at: Array) -> int:
    """Give the i with at[i] <= place < at[i + 1] by bisection; the first or last beyond the ends.

    Args:
        place: Where to look.
        at: (n,) increasing.
    """
    low, high = 0, len(at) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if at[middle] <= place:
            low = middle
        else:
            high = middle
    return low


@compiled
def interpolate(place: float, at: Array, values: Array) -> float:
    """Join values (n,) at increasing places (n,) by straight lines, bit for bit as np.interp."""
    last = len(at) - 1
    if last == 0 or place <= at[0]:
        return float(values[0])
    if place >= at[last]:
        return float(values[last])
    i = section(place, at)
    slope = (values[i + 1] - values[i]) / (at[i + 1] - at[i])
    return float(slope * (place - at[i]) + values[i])
