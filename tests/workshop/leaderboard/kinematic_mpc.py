"""Kinematic model predictive controller on the points ahead, at 20 Hz.

Kong, Pfeiffer, Schildbach and Borrelli, "Kinematic and dynamic vehicle models for autonomous
driving control design", IEEE Intelligent Vehicles Symposium 2015: the bicycle without tyre slip at
the centre of gravity, here linearised about the path, with a horizon of 1 s. Deviations from the
path and increments of the angle are penalised.
"""

from functools import cache

import numpy as np

from ampc_msgs_config.parameters import MIN_SPEED, ChassisParameters
from ampc_msgs_config.paths.path import Path
from tests.workshop.leaderboard.first_move import (
    Differences,
    Model,
    Move,
    first_differences,
    first_move,
)
from tests.workshop.leaderboard.yardstick import Seen, Yardstick, curvatures_ahead

PERIOD = 0.05
"""Sample time [s]."""
HORIZON = 20
"""Number of predicted samples: 1 s."""
GRID = 0.5
"""Distance of the speeds for which gains are computed; they are interpolated [m/s]."""
ERROR, HEADING, RATE = 0.3, 0.03, 0.5
"""Deviations of equal cost (Bryson's rule): cross-track error [m], heading error [rad] and
steering rate [rad/s]. Of thirteen triples, chosen as in `preview_lq`."""


@cache
def gains(chassis: ChassisParameters, index: int) -> Move:
    """Return the gains at the speed `index` times GRID for the state [e_y, e_psi, u(-1)]."""
    v, T, L = max(index * GRID, MIN_SPEED), PERIOD, chassis.wheelbase
    l_r = chassis.cg_to_rear_axle
    A = np.array([[1.0, v * T], [0.0, 1.0]])
    B = np.array([v * T * l_r / L + (v * T) ** 2 / (2 * L), v * T / L])
    E = np.array([-((v * T) ** 2) / 2, -v * T])
    Q = np.tile([1 / ERROR**2, 1 / HEADING**2], (HORIZON, 1))
    rate = Differences(1 / RATE**2, *first_differences(HORIZON, T))
    return first_move(Model(A, B, E), Q, np.array([0.0, -l_r]), 0.0, (rate,))


class KinematicMpc(Yardstick):
    """Kinematic MPC with gains for the measured speed."""

    period = PERIOD

    def angle(self, seen: Seen, path: Path) -> float:
        """Return the first angle of the plan [rad]."""
        v = max(seen.state.v_x, MIN_SPEED)
        index = int(v / GRID)
        share = v / GRID - index
        x, before = np.array([seen.error, seen.heading]), self.steering
        kappa = curvatures_ahead(path, seen.s, v * PERIOD, HORIZON + 1)
        angles = [
            move.state @ x + move.curvature @ kappa + move.before[0] * before
            for move in (gains(self.chassis, index), gains(self.chassis, index + 1))
        ]
        return float((1 - share) * angles[0] + share * angles[1])
