"""The gate in simulated time, where nothing is late: the guard over the time between stamps."""

from ampc_msgs_config.parameters import ChassisParameters, GuardLimits
from ampc_msgs_config.types import NANOSECONDS
from ampc_ros.gate.core import CONVERSION_ERROR, GateOutput
from ampc_ros.supervision.guard import Guard


class LockStepGate:
    """Passes each command on; where the controller has the same guard, without a change."""

    def __init__(self, limits: GuardLimits, chassis: ChassisParameters, period: float) -> None:
        """Wait for the first command; arguments as those of `Guard`."""
        self.guard = Guard(limits, chassis, period)
        self.stamp_ns: int | None = None

    def step(self, stamp_ns: int, angle: float, rate: float, speed: float) -> GateOutput:
        """Return a command inside the limits; the guard starts from the first one.

        Args:
            stamp_ns: Stamp of the state that the command answers; going back starts anew [ns].
            angle: Road-wheel angle [rad].
            rate: Its rate [rad/s].
            speed: Measured speed in that state [m/s].
        """
        if self.stamp_ns is None or stamp_ns < self.stamp_ns:
            self.guard.reset(angle)
            self.stamp_ns = stamp_ns
        elapsed = (stamp_ns - self.stamp_ns) / NANOSECONDS
        self.stamp_ns = stamp_ns
        guarded = self.guard.step(angle, rate, speed, None, elapsed)
        is_command = abs(guarded.steering - angle) <= CONVERSION_ERROR
        return GateOutput(guarded.steering, guarded.steering_rate, speed, is_command)
