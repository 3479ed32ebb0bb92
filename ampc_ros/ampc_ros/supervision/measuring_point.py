"""Point of the car that odometry describes, estimated from the course of the car in turns."""

import math
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.types import Array, VehicleState
from ampc_ros.supervision.plausibility import CHECK_WINDOW, time_between

SAMPLE_TIME = 1.0
"""Time over which lateral velocity and yaw rate are averaged [s]."""
TURNING = 0.08
"""Yaw rate from which a sample counts as turning [rad/s]."""
STRAIGHT = 0.03
"""Yaw rate below which a sample counts as straight on [rad/s]."""
FASTEST_TURN, FASTEST_PEAK = 3.0, 3.75
"""Largest lateral acceleration of a sample, and of one state: beyond it tyres are not linear
[m/s^2]."""
SLOWEST = 2.0
"""Smallest speed of a sample [m/s]."""
MEMORY = 60.0
"""Time after which a sample counts e times less [s]."""
TURNING_TIME = 5.0
"""Least time of turning before the point is judged [s]."""
NOISE = 0.15
"""Standard deviation of the lateral velocity of a sample [m/s]."""
MISALIGNMENT = math.radians(0.5)
"""Standard deviation of a constant angle between heading and body, or course in wind [rad]."""
SLIP_SHARE, SLIP_DEVIATION = 0.8, 0.4
"""Rear slip angle as a share of that of the vehicle file: mean, and standard deviation. Two
deviations reach from a kinematic car without slip to tyres of 60 % of their stiffness."""
MOST_OMISSION = 0.3
"""Largest mean lateral velocity that the twist may omit [m/s]."""
MOST_DISTANCE = 0.3
"""Largest distance between the measured and the configured point [m]..."""
DEVIATIONS = 2.0
"""... plus this number of standard deviations of the estimate."""


class MeasuringPoint(NamedTuple):
    """Estimate of the point that odometry describes."""

    ahead_of_axle: float
    """Distance from the rear axle forward to the point [m]."""
    deviation: float
    """Standard deviation [m]."""

    def contradicts(self, ahead_of_axle: float) -> bool:
        """Return whether the configured point cannot be the measured one.

        Args:
            ahead_of_axle: Distance from the rear axle forward to the configured point [m].
        """
        most = MOST_DISTANCE + DEVIATIONS * self.deviation
        return abs(self.ahead_of_axle - ahead_of_axle) > most


class MeasuringPointEstimate:
    """Least squares over the lateral velocity of the measured position, with three unknowns.

    The lateral velocity of a point at the distance d ahead of the rear axle is

        v_y = d r - s K v^2 r + e v,    K = m l_f / (2 C_r L),

    with the steady-state slip angle of the rear tyres, of which s = 1 is that of the vehicle file,
    and a constant angle e between measured heading and body. At one speed, d and s cannot be told
    apart: s and e have a normal prior, and the deviation of d includes what is unknown of them.
    Only poses are used, because the twist may be wrong. Where the residual is larger than NOISE, so
    is the deviation.
    """

    def __init__(self) -> None:
        """Start without states."""
        self.reset()

    def reset(self) -> None:
        """Forget all states."""
        self.last: VehicleState | None = None
        self.normal: Array = np.zeros((3, 3))  # of r, -v^2 r, v
        self.right: Array = np.zeros(3)
        self.squares = self.samples = self.turning = 0.0
        """Time of the turning samples, of an age below MEMORY [s]."""
        self.omitted = self.omission = 0.0
        """Time of turning in which the twist has no lateral velocity [s], and the way to the inside
        of the turn that the position moved in this time [m]."""
        self.was_fast = False
        self._begin_sample()

    def _begin_sample(self) -> None:
        self.time = self.turned = self.forward = self.left = 0.0
        self.has_lateral = self.is_fast = False

    def observe(self, state: VehicleState) -> None:
        """Add an accepted state."""
        last, self.last = self.last, state
        dt = time_between(last, state) if last else math.inf
        if last is None or dt > CHECK_WINDOW:
            self._begin_sample()
            return
        turned = wrap_angle(state.yaw - last.yaw)
        dx, dy, yaw = state.x - last.x, state.y - last.y, last.yaw + turned / 2
        cos, sin = math.cos(yaw), math.sin(yaw)
        self.time += dt
        self.turned += turned
        self.forward += dx * cos + dy * sin
        self.left += dy * cos - dx * sin
        self.has_lateral |= state.v_y != 0.0
        self.is_fast |= abs(state.v_x * state.yaw_rate) > FASTEST_PEAK
        if self.time >= SAMPLE_TIME:
            self._end_sample()
            self._begin_sample()

    def _end_sample(self) -> None:
        time = self.time
        v_x, v_y, r = self.forward / time, self.left / time, self.turned / time
        is_turning = abs(r) >= TURNING and v_x >= SLOWEST
        forgetting = math.exp(-time / MEMORY)
        self.omitted, self.omission = forgetting * self.omitted, forgetting * self.omission
        if self.has_lateral:
            self.omitted = self.omission = 0.0
        elif is_turning:
            self.omitted += time
            self.omission += self.left * math.copysign(1.0, r)
        is_straight = abs(r) < STRAIGHT and v_x >= SLOWEST
        is_fast = self.is_fast or abs(v_x * r) > FASTEST_TURN
        was_fast, self.was_fast = self.was_fast, is_fast
        if is_fast or was_fast or not (is_turning or is_straight):
            return
        row: Array = np.array([r, -(v_x**2) * r, v_x])
        self.normal = forgetting * self.normal + np.outer(row, row)
        self.right = forgetting * self.right + v_y * row
        self.squares = forgetting * self.squares + v_y**2
        self.samples = forgetting * self.samples + 1.0
        self.turning = forgetting * self.turning + time * is_turning

    def estimate(self, chassis: ChassisParameters) -> MeasuringPoint | None:
        """Return the measured point; None before TURNING_TIME."""
        if self.turning < TURNING_TIME:
            return None
        slip = rear_slip(chassis)
        deviations: Array = np.array([math.inf, SLIP_DEVIATION * slip, MISALIGNMENT])
        weights = deviations**-2.0
        normal = self.normal / NOISE**2 + np.diag(weights)
        right = self.right / NOISE**2 + weights * (0.0, SLIP_SHARE * slip, 0.0)
        covariance = np.linalg.inv(normal)
        solution = covariance @ right
        left = self.squares + solution @ (self.normal @ solution - 2 * self.right)
        residual = math.sqrt(max(float(left), 0.0) / self.samples)
        unexplained = max(residual / NOISE, 1.0)
        return MeasuringPoint(float(solution[0]), unexplained * math.sqrt(covariance[0, 0]))

    @property
    def omitted_velocity(self) -> float:
        """Mean lateral velocity to the inside of turns that the twist does not contain [m/s]."""
        return self.omission / self.omitted if self.omitted >= TURNING_TIME else 0.0


def rear_slip(chassis: ChassisParameters) -> float:
    """Return K, the lateral velocity of the rear axle over -v^2 r in steady state [s^2/m]."""
    m, l_f, C_r = chassis.mass, chassis.cg_to_front_axle, chassis.rear_cornering_stiffness
    return m * l_f / (2 * C_r * chassis.wheelbase)
