"""The steering actuator: pure delay, first-order lag, rate limit, angle limit, in this order."""

import math

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import in_place, inlined


@inlined
def command_in_force(
    waiting: NDArray[np.float64], command: float, steps_since_command: int
) -> float:
    """Give the angle that has passed the pure delay [rad].

    Args:
        waiting: (D,) angles of the last D integration steps, oldest first [rad]; the delay is D
            steps, so it is quantised to the step.
        command: The newest angle, given at step 0 [rad].
        steps_since_command: Number of the integration step.
    """
    if steps_since_command < len(waiting):
        return float(waiting[steps_since_command])
    return command


@inlined
def queue_up(waiting: NDArray[np.float64], command: float, steps: int) -> None:
    """Let `steps` integration steps with one command pass through the queue, in place."""
    delay = len(waiting)
    for i in range(delay):
        waiting[i] = waiting[i + steps] if i + steps < delay else command


@in_place
def approach(step: float, steering: tuple[float, ...]) -> float:
    """Give the share of the way to its target that the lagging angle goes in one step, exactly."""
    _, _, lag, _ = steering
    return 1.0 - math.exp(-step / lag) if lag > 0.0 else 1.0


@inlined
def turned(
    angle: float, command: float, share: float, step: float, steering: tuple[float, ...]
) -> float:
    """Give the road-wheel angle one step later [rad].

    Args:
        angle: Road-wheel angle now [rad].
        command: Angle asked for during the whole step [rad].
        share: `approach` of the step.
        step: Duration [s].
        steering: `astuple` of SteeringParameters.
    """
    delta_max, rate_max, _, _ = steering
    target = min(max(command, -delta_max), delta_max)
    turn = min(max(share * (target - angle), -rate_max * step), rate_max * step)
    return angle + turn
