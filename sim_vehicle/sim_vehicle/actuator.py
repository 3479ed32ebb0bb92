"""The steering actuator: pure delay, first-order lag, rate limit, angle limit, in this order."""

import math

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array


@inlined
def delayed_command(waiting: Array, command: float, steps_since_command: int) -> float:
    """Return the command after the pure delay [rad].

    Args:
        waiting: (D,) commands of the last D integration steps, oldest first [rad]; the delay is D
            steps, so it is rounded to the step.
        command: The newest command, issued at step 0 [rad].
        steps_since_command: Number of the integration step.
    """
    if steps_since_command < len(waiting):
        return float(waiting[steps_since_command])
    return command


@inlined
def shift_queue(waiting: Array, command: float, steps: int) -> None:
    """Advance the queue of the delay in place by `steps` integration steps with one command."""
    delay = len(waiting)
    for i in range(delay):
        waiting[i] = waiting[i + steps] if i + steps < delay else command


@in_place
def lag_share(step: float, steering: tuple[float, ...]) -> float:
    """Return 1 - exp(-step / lag): the share of the distance to its target covered in one step."""
    _, _, lag, _ = steering
    return 1.0 - math.exp(-step / lag) if lag > 0.0 else 1.0


@inlined
def next_angle(
    angle: float, command: float, share: float, step: float, steering: tuple[float, ...]
) -> float:
    """Return the road-wheel angle one step later [rad].

    Args:
        angle: Road-wheel angle now [rad].
        command: Demanded angle during the whole step [rad].
        share: `lag_share` of the step.
        step: Duration [s].
        steering: Largest angle and rate, lag, delay.
    """
    delta_max, rate_max, _, _ = steering
    target = min(max(command, -delta_max), delta_max)
    turn = min(max(share * (target - angle), -rate_max * step), rate_max * step)
    return angle + turn
