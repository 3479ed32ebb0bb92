"""Defects of odometry that last: the car can be steered, but a publisher has to be corrected."""

from ampc_msgs_config.types import VehicleState
from ampc_ros.supervision.yaw_rate import YawRateCheck


class OdometryMonitor:
    """Checks of accepted states over seconds."""

    def __init__(self) -> None:
        """Start without states."""
        self.yaw_rate = YawRateCheck()

    def reset(self) -> None:
        """Begin a new history."""
        self.yaw_rate.reset()

    def correct(self, state: VehicleState) -> VehicleState:
        """Add an accepted state; return the state for the controller."""
        return self.yaw_rate.correct(state)
