"""Target speed under a request to stop: gentle braking to a standstill, and acceleration after."""

import math

from ampc_msgs_config.types import NANOSECONDS, VehicleState

COMFORTABLE = 2.0
"""Comfortable deceleration, and acceleration after the request is taken back [m/s^2]."""


class Braking:
    """Limits a planned speed: falling while a stop is requested, rising again afterwards."""

    def __init__(self) -> None:
        """Start without a limit."""
        self.most = math.inf
        """Largest speed now [m/s]."""
        self.at_ns = 0

    def limited(self, planned: float, state: VehicleState, *, stop: bool) -> float:
        """Return the target speed [m/s].

        Args:
            planned: Speed of the drive [m/s].
            state: State of the car; braking begins at its speed.
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
