"""How a target speed obeys a request to stop: down to a standstill, and up again, gently."""

import math

from ampc_msgs_config.types import NANOSECONDS, VehicleState

COMFORTABLE = 2.0
"""Deceleration that nobody in the car minds, and acceleration when the drive goes on [m/s^2]."""


class Braking:
    """Limits a planned speed: falling while a stop is requested, rising again when it is not."""

    def __init__(self) -> None:
        """Limit nothing."""
        self.most = math.inf
        """Allowed now [m/s]."""
        self.at_ns = 0

    def limited(self, planned: float, state: VehicleState, *, stop: bool) -> float:
        """Give the target speed.

        Args:
            planned: By the drive [m/s].
            state: Of the car; where a stop is new, braking begins at its speed.
            stop: Whether a stop is requested.
        """
        step = COMFORTABLE * max(state.stamp_ns - self.at_ns, 0) / NANOSECONDS
        self.at_ns = state.stamp_ns
        if stop and self.most == math.inf:
            self.most = max(state.v_x, 0.0)
        elif stop:
            self.most = max(self.most - step, 0.0)
        elif self.most < planned:
            self.most += step
        else:
            self.most = math.inf
        return min(planned, self.most)
