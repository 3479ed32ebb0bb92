"""Kinematic model predictive controller with steering lag and delay, as Autoware has it.

Model, cost, weights and time constants are those of the package `autoware_mpc_lateral_controller`:
README.md and `param/lateral_controller_defaults.param.yaml` of
github.com/autowarefoundation/autoware_universe (commit 86fe050945c0), "adjusted to a Lexus RX 450h
for under 40 km/h", with its control period of 0.03 s. The code is our own. Differences:

* The steering angle is predicted from the own commands (Autoware's `use_steer_prediction`), because
  no controller here gets a measured angle. For the same reason there is no steering offset removal.
* Limits of angle and rate act on the first input only, not on the whole plan, so that the solution
  is linear and its gains depend on the speed only, which is held over the horizon.
"""

import math
from collections import deque
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.signal import butter

from ampc_msgs_config.parameters import MIN_SPEED
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import Array
from tests.workshop.leaderboard.first_move import Differences, Model, Move, first_move
from tests.workshop.leaderboard.yardstick import Seen, Yardstick, curvatures_ahead

PERIOD = 0.03
"""`ctrl_period` [s]."""
HORIZON, STEP = 50, 0.1
"""`mpc_prediction_horizon`, and `mpc_prediction_dt` [s]."""
DELAY, LAG = 0.24, 0.27
"""`input_delay` and `vehicle_model_steer_tau` [s]."""
LATERAL, HEADING, HEADING_SPEED = 1.0, 0.0, 0.3
"""`mpc_weight_lat_error`, `mpc_weight_heading_error`, `..._squared_vel`."""
STEERING, STEERING_SPEED, JERK, ACCELERATION = 1.0, 0.25, 0.1, 1.0e-6
"""`mpc_weight_steering_input`, `..._squared_vel`, `mpc_weight_lat_jerk`, `mpc_weight_steer_acc`."""
LAST_LATERAL, LAST_HEADING = 1.0, 0.1
"""`mpc_weight_terminal_lat_error` and `mpc_weight_terminal_heading_error`."""
ZERO_FEED_FORWARD = math.radians(0.5)
"""`mpc_zero_ff_steer_deg` [rad]."""
CUTOFF = 3.0
"""`steering_lpf_cutoff_hz` of a Butterworth filter of second order [Hz]."""
RATES = ((10.0, 15.0, 20.0), (60.0, 50.0, 40.0))
"""`steer_rate_lim_dps_list_by_velocity`: speeds [m/s] and rates [deg/s]."""
WAITING = round(DELAY / PERIOD)
"""Number of commands that have not reached the wheels."""
GRID = 0.5
"""Distance of the speeds for which gains are computed; they are interpolated [m/s]."""


def sampled(wheelbase: float, v: float, step: float) -> Model:
    """Return the model of [e_y, e_psi, delta] at a speed [m/s], sampled at `step` [s]."""
    A_c = np.zeros((5, 5))  # with the held input and the held curvature
    A_c[0, 1], A_c[1, 2], A_c[1, 4] = v, v / wheelbase, -v
    A_c[2, 2], A_c[2, 3] = -1 / LAG, 1 / LAG
    Phi = np.asarray(expm(step * A_c), dtype=np.float64)
    return Model(Phi[:3, :3], Phi[:3, 3], Phi[:3, 4])


class Gains(NamedTuple):
    """Gains at one speed."""

    move: Move
    delayed: Model
    """Model of one control period."""


@cache
def gains(wheelbase: float, index: int) -> Gains:
    """Return the gains at the speed `index` times GRID."""
    v = max(index * GRID, MIN_SPEED)
    Q = np.tile([LATERAL, HEADING + HEADING_SPEED * v**2, 0.0], (HORIZON, 1))
    Q[-1, :2] = LAST_LATERAL, LAST_HEADING + HEADING_SPEED * v**2
    # Second differences; the first two span control periods, too.
    now = np.eye(HORIZON) - 2 * np.eye(HORIZON, k=-1) + np.eye(HORIZON, k=-2)
    now, before = now / STEP**2, np.zeros((HORIZON, 2))
    now[0, 0], before[0] = 1 / PERIOD**2, (-2 / PERIOD**2, 1 / PERIOD**2)
    now[1, :2] = -(1 / STEP + 1 / PERIOD) / STEP, 1 / STEP**2
    before[1, 0] = 1 / (PERIOD * STEP)
    jerk = (np.eye(HORIZON - 1, HORIZON, k=1) - np.eye(HORIZON - 1, HORIZON)) / STEP
    costs = (
        Differences(ACCELERATION, now, before),
        Differences(JERK * v**2, jerk, np.zeros((HORIZON - 1, 2))),
    )
    R = STEERING + STEERING_SPEED * v**2
    move = first_move(sampled(wheelbase, v, STEP), Q, np.zeros(3), R, costs)
    return Gains(move, sampled(wheelbase, v, PERIOD))


class LagMpc(Yardstick):
    """Kinematic MPC with lag and delay, gains for the measured speed."""

    period = PERIOD
    guided_point = 0.0  # Autoware guides the centre of the rear axle

    def reset(self) -> None:
        """Forget path and earlier commands."""
        super().reset()
        self.waiting = deque([0.0] * WAITING, maxlen=WAITING)
        self.delta, self.before = 0.0, np.zeros(2)
        b, a = butter(2, 2 * CUTOFF * PERIOD)
        self.filter = tuple(b), tuple(a)
        self.inputs = self.outputs = (0.0, 0.0)

    def angle(self, seen: Seen, path: Path) -> float:
        """Return the filtered first angle of the plan [rad]."""
        v = max(seen.state.v_x, MIN_SPEED)
        index = round(v / GRID)
        L = self.chassis.wheelbase
        state = np.array([seen.error, seen.heading, self.delta])
        # State at the time at which the next command reaches the wheels
        A, B, E = gains(L, index).delayed
        bends = curvatures_ahead(path, seen.s, v * PERIOD, WAITING)
        for angle, kappa in zip(self.waiting, bends, strict=True):
            state = A @ state + B * angle + E * kappa
        # Plan from there
        kappa = curvatures_ahead(path, seen.s + v * DELAY, v * STEP, HORIZON + 1)
        wanted = np.arctan(L * kappa[:-1])
        wanted[np.abs(wanted) < ZERO_FEED_FORWARD] = 0.0
        share = v / GRID - int(v / GRID)
        low, high = (
            self._first(gains(L, int(v / GRID) + i).move, state, kappa, wanted) for i in (0, 1)
        )
        first = (1 - share) * low + share * high
        # Limits and filter
        most = math.radians(float(np.interp(v, *RATES))) * PERIOD
        first = min(max(first, self.before[0] - most), self.before[0] + most)
        self.before = np.array([first, self.before[0]])
        angle = self._filtered(min(max(first, -self.bound(v)), self.bound(v)))
        self.delta += (1 - math.exp(-PERIOD / LAG)) * (self.waiting[0] - self.delta)
        self.waiting.append(angle)
        return angle

    def _first(self, move: Move, state: Array, kappa: Array, wanted: Array) -> float:
        """Return the first angle with the gains of one speed [rad]."""
        angle = move.state @ state + move.curvature @ kappa
        return float(angle + move.reference @ wanted + move.before @ self.before)

    def _filtered(self, value: float) -> float:
        """Return a command after the low-pass filter."""
        (b0, b1, b2), (_, a1, a2) = self.filter
        (x1, x2), (y1, y2) = self.inputs, self.outputs
        result = b0 * value + b1 * x1 + b2 * x2 - a1 * y1 - a2 * y2
        self.inputs, self.outputs = (value, x1), (result, y1)
        return float(result)
