"""Bisection and linear interpolation for compiled code."""

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.types import Array


@compiled
def section(place: float, at: Array) -> int:
    """Return the i with at[i] <= place < at[i + 1] by bisection; first or last beyond the ends.

    Args:
        place: Value on the axis.
        at: (n,) axis, increasing.
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
    """Return values (n,) at increasing places (n,), interpolated bit for bit as np.interp."""
    last = len(at) - 1
    if last == 0 or place <= at[0]:
        return float(values[0])
    if place >= at[last]:
        return float(values[last])
    i = section(place, at)
    slope = (values[i + 1] - values[i]) / (at[i + 1] - at[i])
    return float(slope * (place - at[i]) + values[i])
