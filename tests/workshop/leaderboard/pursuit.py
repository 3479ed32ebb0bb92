"""Regulated pure pursuit, at 20 Hz: pure pursuit with a look-ahead distance that grows with speed.

Macenski, Singh, Martin and Gines, "Regulated pure pursuit for robot path tracking", Autonomous
Robots 47 (2023), 685-694. The geometry is that of `ampc_ros.pure_pursuit`, which is used here. The
regulation of the speed has no counterpart, because the speed is that of the road. Published
defaults are those of a slow robot: a look-ahead of 1.5 s within 0.3 to 0.9 m. On a car, 1.5 s cut
a lane change by metres, so the look-ahead is that of the product, 0.6 s and at least 4 m.
"""

from dataclasses import replace

from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import VehicleState
from ampc_ros.pure_pursuit import PurePursuit
from tests.workshop.leaderboard.yardstick import Seen, Yardstick


class RegulatedPurePursuit(Yardstick):
    """Pure pursuit of the product at 20 Hz."""

    period = 0.05
    guided_point = 0.0

    def __init__(self, chassis: ChassisParameters, settings: ControllerSettings) -> None:
        """Create a controller at rest."""
        self.pursuit = PurePursuit(chassis, replace(settings, sample_time=self.period))
        super().__init__(chassis, settings)

    def reset(self) -> None:
        """Forget path and earlier commands."""
        super().reset()
        self.pursuit.reset()

    def angle(self, seen: Seen, path: Path) -> float:
        """Return the angle [rad]."""
        state: VehicleState = seen.state
        return self.pursuit.step(state, path).steering
