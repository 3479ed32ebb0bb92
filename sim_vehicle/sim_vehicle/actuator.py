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
def lag_share(time: float, steering: tuple[float, ...]) -> float:
    """Return 1 - exp(-time / lag): the share of the distance to its target covered in a time."""
    _, _, lag, _ = steering
    return 1.0 - math.exp(-time / lag) if lag > 0.0 else 1.0


@inlined
def angle_after(
    time: float, angle: float, command: float, share: float, steering: tuple[float, ...]
) -> float:
    """Return the road-wheel angle some time later [rad], exact under a constant command.

    The wheel turns at its largest rate until its distance to the target is rate times lag, then
    approaches the target exponentially. An ideal actuator is at its target after 0 s.

    Args:
        time: Duration [s].
        angle: Road-wheel angle now [rad].
        command: Demanded angle during this time [rad].
        share: `lag_share` of this time.
        steering: Largest angle and rate, lag, delay.
    """
    delta_max, rate_max, lag, _ = steering
    target = min(max(command, -delta_max), delta_max)
    distance = abs(target - angle)
    corner = rate_max * lag if lag > 0.0 else 0.0
    if distance <= corner:
        return angle + share * (target - angle)
    ramp = distance - corner
    if rate_max * time < ramp:  # false for an infinite rate and 0 s, whose product is nan
        return angle + math.copysign(rate_max * time, target - angle)
    rest = corner * math.exp((ramp / rate_max - time) / lag) if lag > 0.0 else 0.0
    return target - math.copysign(rest, target - angle)
