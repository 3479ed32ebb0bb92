"""Stanley, at 20 Hz: the front axle is steered towards the path.

Hoffmann, Tomlin, Montemerlo and Thrun, "Autonomous automobile trajectory tracking for off-road
driving", American Control Conference 2007, Eqs. (5) to (9): heading error minus its value on a
steady curve, cross-track error over speed with a softening speed, and damping of the yaw rate.
"""

import math

from ampc_msgs_config.paths.path import Path, point_at
from tests.workshop.leaderboard.yardstick import Seen, Yardstick

GAIN = 2.5
"""k: gain of the cross-track error [1/s]."""
SOFTENING = 1.0
"""k_soft: speed that is added to the car's [m/s]."""
DAMPING = 0.2
"""k_d,yaw: gain of the yaw rate [s]. Of twelve triples, chosen as in `preview_lq`."""


class Stanley(Yardstick):
    """Stanley controller."""

    period = 0.05

    @property
    def guided_point(self) -> float:
        """Distance of the front axle from the rear axle [m]."""
        return self.chassis.wheelbase

    def angle(self, seen: Seen, path: Path) -> float:
        """Return the angle [rad]."""
        v, chassis = seen.state.v_x, self.chassis
        turn = v * point_at(path, seen.s).curvature
        # Slip angle of the front tyres on a steady curve
        load = chassis.mass * chassis.cg_to_rear_axle / chassis.wheelbase
        slip = load * v * turn / (2 * chassis.front_cornering_stiffness)
        angle = -(seen.heading - slip) - math.atan2(GAIN * seen.error, SOFTENING + max(v, 0.0))
        return angle - DAMPING * (seen.state.yaw_rate - turn)
