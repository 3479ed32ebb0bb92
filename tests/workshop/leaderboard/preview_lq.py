"""Preview LQ: optimal state feedback and feed-forward of the curvature ahead, at 20 Hz.

Sharp and Valtetsiotis, "Optimal preview car steering control", Vehicle System Dynamics 35 (2001),
101-117, with the bicycle model in path coordinates and the steady-state steering of Rajamani,
"Vehicle Dynamics and Control", 2nd ed., ch. 2.5 and 3.3. Delay and lag are not modelled.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from ampc_msgs_config.parameters import MIN_SPEED, ChassisParameters
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import Array
from tests.workshop.leaderboard.yardstick import Seen, Yardstick, curvatures_ahead

PERIOD = 0.05
"""Sample time [s]."""
PREVIEW = 30
"""Number of previewed samples: 1.5 s."""
GRID = 1.0
"""Distance of the speeds for which gains are computed; they are interpolated [m/s]."""
ERROR, HEADING, CORRECTION = 0.2, 0.03, 0.03
"""Deviations of equal cost (Bryson's rule): cross-track error [m], heading error [rad], and
correction of the steady-state steering [rad]. Of twelve triples, this one has the smallest
geometric mean of the largest errors on sc1_falcone and lane_change, with two cars."""
Q = np.diag([0.0, 1 / HEADING**2, 0.0, 1 / ERROR**2])
R = 1 / CORRECTION**2


class Model(NamedTuple):
    """Sampled model of [v_y, e_psi, r, e_y], and its steady state per unit of curvature."""

    A: Array
    """(4, 4)."""
    B: Array
    """(4,) for the steering angle."""
    X: Array
    """(4,) state of a steady circle of curvature 1."""
    U: float
    """Steering angle of this circle [rad m]."""


def model(chassis: ChassisParameters, v: float) -> Model:
    """Return the model at a speed [m/s]; Rajamani Eq. (2.45), here with one-tyre stiffness."""
    m, I_z = chassis.mass, chassis.yaw_inertia
    l_f, l_r = chassis.cg_to_front_axle, chassis.cg_to_rear_axle
    C_f, C_r = 2 * chassis.front_cornering_stiffness, 2 * chassis.rear_cornering_stiffness
    coupling = l_r * C_r - l_f * C_f
    A_c = np.zeros((6, 6))  # with the held input and the held curvature
    A_c[0, :3] = -(C_f + C_r) / (m * v), 0.0, coupling / (m * v) - v
    A_c[2, :3] = coupling / (I_z * v), 0.0, -(l_f**2 * C_f + l_r**2 * C_r) / (I_z * v)
    A_c[0, 4], A_c[2, 4] = C_f / m, l_f * C_f / I_z
    A_c[1, 2], A_c[1, 5] = 1.0, -v
    A_c[3, 0], A_c[3, 1] = 1.0, v
    Phi = np.asarray(expm(PERIOD * A_c), dtype=np.float64)
    v_y = v * (l_r - m * v**2 * l_f / (C_r * chassis.wheelbase))
    X = np.array([v_y, -v_y / v, v, 0.0])
    return Model(Phi[:4, :4], Phi[:4, 4], X, chassis.wheelbase + chassis.understeer_gradient * v**2)


class Gains(NamedTuple):
    """Angle = -state @ x + curvature @ kappa."""

    state: Array
    """(4,)."""
    curvature: Array
    """(PREVIEW + 1,)."""


@cache
def gains(chassis: ChassisParameters, index: int) -> Gains:
    """Return the gains at the speed `index` times GRID.

    With the deviation from the steady circle of the present curvature, x(k+1) = A x(k) + B u(k)
    - X (kappa(k+1) - kappa(k)). The optimal input is -K x plus a sum over the changes ahead.
    """
    A, B, X, U = model(chassis, max(index * GRID, MIN_SPEED))
    P = solve_discrete_are(A, B[:, None], Q, np.array([[R]]))
    share = B / (R + B @ P @ B)
    K = share @ P @ A
    closed, ahead = A - np.outer(B, K), P @ X
    curvature = np.zeros(PREVIEW + 1)
    curvature[0] = U + K @ X
    for i in range(PREVIEW):
        change = share @ ahead
        curvature[i + 1] += change
        curvature[i] -= change
        ahead = closed.T @ ahead
    return Gains(K, curvature)


class PreviewLq(Yardstick):
    """Preview LQ with gains for the measured speed."""

    period = PERIOD

    def angle(self, seen: Seen, path: Path) -> float:
        """Return the optimal angle [rad]."""
        v = max(seen.state.v_x, MIN_SPEED)
        index = int(v / GRID)
        share = v / GRID - index
        low, high = gains(self.chassis, index), gains(self.chassis, index + 1)
        x = np.array([seen.state.v_y, seen.heading, seen.state.yaw_rate, seen.error])
        kappa = curvatures_ahead(path, seen.s, v * PERIOD, PREVIEW + 1)
        angles = [-(g.state @ x) + g.curvature @ kappa for g in (low, high)]
        return float((1 - share) * angles[0] + share * angles[1])
