"""Slow estimation of what differs from the configured car, from commands and yaw rate.

The controller estimates the total latency of the steering, the understeer gradient and the offset
of the steering. It uses each where the estimate differs significantly from the configuration.
"""

import math
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.parameters import ASSUMED_LAG, GRAVITY, understeer_gradient
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.assumed_car import (
    AssumedCar,
    SteeringResponse,
    assumed_car,
    front_share,
    with_tyres,
)
from ampc_ros.configuration import CarDifference, Configuration
from ampc_ros.estimation.command_history import CommandHistory
from ampc_ros.estimation.state_prediction import CarModel, Motion, advance_car
from ampc_ros.mpc.internal_model import LARGEST_LAG, SHORT_LAG
from ampc_ros.mpc.model import BicycleParameters

LATERAL_SPEED, YAW_SPEED, LATENCY_CHANGE, GRADIENT, STEERING_OFFSET, STIFFNESS, YAW_ERROR, POINT = (
    range(8)
)
"""Positions in the state of the filter: lateral velocity of the centre of gravity [m/s], yaw rate
[rad/s], difference of the latency [s], difference of the understeer gradient [rad s^2/m], offset
of the road-wheel angle [rad], logarithm of the ratio of the rear cornering stiffnesses, yaw
acceleration beyond the model, as of wind [rad/s^2], distance of the measured point ahead of where
it is configured [m]."""
FILTER_SIZE = 8
PARAMETERS_AT = (LATENCY_CHANGE, GRADIENT, STEERING_OFFSET, STIFFNESS)
DIFFERENCES = slice(LATENCY_CHANGE, STIFFNESS + 1)

SHORTEST_STEP, LONGEST_PAUSE_OF_STATES = 0.09, 0.5
"""Time between two measurements of the yaw rate that are used [s]."""
UNKNOWN_DEVIATION, STATED_DEVIATION = 0.06, 0.03
"""Standard deviation of a latency that is not stated, and of one that is [s]."""
GRADIENT_DEVIATION = 0.3
"""Standard deviation of the understeer gradient, as a share of the front axle's part of it."""
OFFSET_DEVIATION = 0.015
"""Standard deviation of the offset [rad]."""
YAW_ERROR_DEVIATION, YAW_ERROR_TIME = 0.03, 3.0
"""Standard deviation of the yaw acceleration beyond the model [rad/s^2], and its correlation time
[s]: what lasts longer belongs to the offset."""
STIFFNESS_DEVIATION = 0.3
"""Standard deviation of the logarithm of the rear cornering stiffness."""
POINT_DEVIATION = 0.5
"""Standard deviation of the measured point [m]."""
MOTION_DEVIATION = (0.3, 0.1)
"""Standard deviation of lateral velocity [m/s] and yaw rate [rad/s] at a start."""
WALK = (0.02, 0.002, 0.004, 0.002, 0.0003, 0.002, 0.0, 0.0)
"""Random walk of the state in the square root of a second; that of the gradient as a share of the
front axle's part of it."""
LEAST_NOISE_LEVEL = (0.005, 0.015)
"""Least standard deviation of a residual of yaw rate [rad/s] and lateral velocity [m/s]: that of
model errors. Where the residuals are larger, their level is used."""
START_NOISE, NOISE_TIME = (0.03, 0.1), 5.0
"""Standard deviations at the start, and time over which residuals are averaged [s]."""
NOISE_SHARE = 0.05
"""Further standard deviation of the yaw rate, as a share of it, for model errors."""
MOST_LATERAL = 0.5
"""Residual of the lateral velocity from which it is not used [m/s]."""
DIFFERENCE = (0.05, 0.02, 0.02, 0.1, 0.005, 0.05, 0.1)
"""Differences for the derivatives; that of the gradient as a share of the front axle's part."""
NOT_USED, FULLY_USED = 1.0, 2.0
"""Standard deviations up to which a difference from the configured car is not used, and from which
it is used fully."""
USE_TIME = (3.0, 10.0, 10.0, 10.0)
"""Time constants with which an estimate is used: latency, gradient, offset, stiffness [s]."""
LONG_LAG = 0.2
"""Latency from which the state filter acts fully, also without noise [s]."""
LEAST_LATENCY = -0.1
"""Bound of a latency below the stated one [s]."""
LARGEST_GRADIENT = 0.5
"""Bound of the difference of the gradient, as a share of the front axle's part of it."""
LARGEST_OFFSET = 0.06
"""Bound of the offset [rad]."""
LARGEST_STIFFNESS = 0.8
"""Bound of the logarithm of the rear cornering stiffness."""
SLOWEST_CAR, SLOWEST_MODEL, PASSENGER_CAR = 3.0, 1.5, 2.7
"""Speed from which a car with the wheelbase of a passenger car [m] is observed; shorter ones by the
square root of their size, but never below the second [m/s]."""
MOST_ACCELERATION, MOST_FRICTION = 4.0, 0.45
"""Lateral acceleration up to which the tyres are linear enough [m/s^2], also as a share of that of
the friction."""
MOST_RESIDUAL = 0.3
"""Larger residuals of the yaw rate are a skid or a wrong sensor [rad/s]."""


class Sent(NamedTuple):
    """Steering of a step for one latency."""

    lag: float
    """[s]."""
    wheel: float
    """Road-wheel angle at its begin, without offset [rad]."""
    commands: Array
    """(n, 2) angle [rad] and time for which it acts [s]."""


@in_place
def advance_joint(
    vehicle: BicycleParameters, friction: float, v_x: float, x: Array, sent: Sent
) -> tuple[float, float]:
    """Return lateral velocity and yaw rate after a step.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r as configured.
        friction: Coefficient of friction.
        v_x: Speed [m/s].
        x: State of the filter (FILTER_SIZE,).
        sent: Commands of the step.
    """
    changed = with_tyres(vehicle, x[GRADIENT], x[STIFFNESS])
    model = CarModel(changed, friction, sent.lag, 0.0, x[YAW_ERROR])
    motion = Motion(
        0.0, 0.0, 0.0, v_x, x[LATERAL_SPEED], x[YAW_SPEED], sent.wheel + x[STEERING_OFFSET]
    )
    for i in range(len(sent.commands)):
        command = sent.commands[i, 0] + x[STEERING_OFFSET]
        after = advance_car(model, motion, command, sent.commands[i, 1])
        motion = Motion(after[0], after[1], after[2], after[3], after[4], after[5], after[6])
    return motion.v_y, motion.yaw_rate


@in_place
def linearize(
    vehicle: BicycleParameters,
    friction: float,
    v_x: float,
    x: Array,
    sent: tuple[float, float, Array],
    later: tuple[float, float, Array],
    F: Array,
) -> tuple[float, float]:
    """Fill the derivatives of lateral velocity and yaw rate (2, n); return both after the step.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r as configured.
        friction: Coefficient of friction.
        v_x: Speed [m/s].
        x: State of the filter (FILTER_SIZE,).
        sent: `Sent` at this latency.
        later: `Sent` at a latency that is longer by DIFFERENCE.
        F: Receives the derivatives.
    """
    base = advance_joint(vehicle, friction, v_x, x, Sent(*sent))
    m, _, l_f, l_r, C_f, _ = vehicle
    for i in range(len(DIFFERENCE)):
        step = DIFFERENCE[i] * (m * l_r / (2 * C_f * (l_f + l_r)) if i == GRADIENT else 1.0)
        kept = x[i]
        if i == LATENCY_CHANGE:
            after = advance_joint(vehicle, friction, v_x, x, Sent(*later))
        else:
            x[i] = kept + step
            after = advance_joint(vehicle, friction, v_x, x, Sent(*sent))
            x[i] = kept
        F[0, i], F[1, i] = (after[0] - base[0]) / step, (after[1] - base[1]) / step
    return base


class Adaptation:
    """Extended Kalman filter of the single-track model with its parameters as further states.

    Ljung, "Asymptotic behavior of the extended Kalman filter as a parameter estimator for linear
    systems", 1979. The yaw rate does not depend on the point that odometry describes. The rear
    cornering stiffness is corrected by the lateral velocity only: in closed loop, noise of the yaw
    rate reaches the commands, and would be read as a stiffer tyre.
    """

    def __init__(self, config: Configuration) -> None:
        """Start with the configured car, or with the differences of the configuration."""
        self.car = assumed_car(config)
        self.friction = config.settings.friction
        self.is_stated = config.steering.is_lag_configured
        share = front_share(self.car.vehicle)
        latency = STATED_DEVIATION if self.is_stated else UNKNOWN_DEVIATION
        spread = latency, GRADIENT_DEVIATION * share, OFFSET_DEVIATION, STIFFNESS_DEVIATION
        others = YAW_ERROR_DEVIATION, POINT_DEVIATION
        self.deviation: Array = np.array([*MOTION_DEVIATION, *spread, *others])
        """Standard deviations at the start (FILTER_SIZE,)."""
        self.walk: Array = np.array(WALK)
        self.walk[GRADIENT] *= share
        # Bounds: the latency stays positive, and the car never oversteers more than configured
        longest = LARGEST_LAG if self.is_stated else LARGEST_LAG - ASSUMED_LAG
        upper = longest, LARGEST_GRADIENT * share, LARGEST_OFFSET, LARGEST_STIFFNESS
        self.upper: Array = np.array(upper)
        total, gradient = sum(self.car.response), understeer_gradient(self.car.vehicle)
        least = max(LEAST_LATENCY, -total), max(-self.upper[1], -max(gradient, 0.0))
        self.lower: Array = np.array([*least, -LARGEST_OFFSET, -LARGEST_STIFFNESS])
        l_f, l_r = self.car.vehicle[2:4]
        self.slowest = max(
            SLOWEST_CAR * math.sqrt(min((l_f + l_r) / PASSENGER_CAR, 1.0)), SLOWEST_MODEL
        )
        self.most_acceleration = min(MOST_ACCELERATION, MOST_FRICTION * self.friction * GRAVITY)
        self.to_cg = config.base_link_to_cg
        start = config.difference or CarDifference()
        self.start: Array = np.clip(start, self.lower, self.upper)
        """Differences from the configured car at the start."""
        self.reset()

    def reset(self) -> None:
        """Forget what was learnt since the start."""
        self.x: Array = np.zeros(FILTER_SIZE)
        """State of the filter."""
        self.x[DIFFERENCES] = self.start
        self.P: Array = np.diag(self.deviation**2)
        """Its covariance (FILTER_SIZE, FILTER_SIZE)."""
        self.noise: Array = np.square(START_NOISE)
        """Mean squares of the residuals of yaw rate and lateral velocity."""
        self.anchor: VehicleState | None = None
        self.used: Array = self.start.copy()
        """Differences from the configured car in use."""

    @property
    def difference(self) -> CarDifference:
        """Estimated differences from the configured car."""
        return CarDifference(*(float(value) for value in self.x[DIFFERENCES]))

    @property
    def is_latency_known(self) -> bool:
        """Whether the car was driven enough for an estimate of its latency."""
        return bool(
            self.P[LATENCY_CHANGE, LATENCY_CHANGE] < 0.5 * self.deviation[LATENCY_CHANGE] ** 2
        )

    @property
    def adapted_car(self) -> AssumedCar:
        """The configured car with the differences that are significant."""
        latency, gradient, offset, stiffness = (float(value) for value in self.used)
        vehicle = self.car.vehicle
        if gradient or stiffness:
            vehicle = with_tyres(vehicle, gradient, stiffness)
        response = lengthened(self.car.response, latency)
        return AssumedCar(vehicle, response, offset, self._caution(sum(response)))

    def _significant(self, i: int) -> float:
        """Return an estimate as far as it is significant.

        An insignificant one is zero, so that a car that is as configured is driven as configured.
        """
        value, deviation = float(self.x[i]), math.sqrt(self.P[i, i])
        share = (abs(value) / deviation - NOT_USED) / (FULLY_USED - NOT_USED)
        return value * min(max(share, 0.0), 1.0)

    def _caution(self, latency: float) -> float:
        """Return the share of the state filter for a latency in use [s]."""
        if self.is_stated and latency == sum(self.car.response):
            return 0.0
        uncertain = float(self.P[LATENCY_CHANGE, LATENCY_CHANGE]) / UNKNOWN_DEVIATION**2
        long = (latency - self.car.response.delay - SHORT_LAG) / (LONG_LAG - SHORT_LAG)
        return min(max(uncertain, long), 1.0)

    def freeze(self) -> None:
        """Keep the estimates: what happens now says nothing about the car."""
        self.anchor = None

    def observe(self, state: VehicleState, commands: CommandHistory) -> None:
        """Correct the estimates by another measured state.

        Args:
            state: Measured state at `base_link`.
            commands: Commands sent.
        """
        if self.anchor is None:
            self._start(state)
            return
        elapsed = (state.stamp_ns - self.anchor.stamp_ns) / NANOSECONDS
        if 0.0 <= elapsed < SHORTEST_STEP:
            return
        fast = state.v_x * abs(state.yaw_rate) > self.most_acceleration
        if not 0.0 < elapsed <= LONGEST_PAUSE_OF_STATES or state.v_x < self.slowest or fast:
            self._start(state)
            return
        anchor, self.anchor = self.anchor, state
        if state.yaw_rate == anchor.yaw_rate:  # a sensor that is stuck, or a straight road
            self._start(state)
            return
        self._update(anchor, state, commands, elapsed)

    def _start(self, state: VehicleState) -> None:
        """Start from the steady-state lateral velocity of a yaw rate."""
        m, _, l_f, l_r, _, C_r = self.car.vehicle
        v, r = state.v_x, state.yaw_rate
        self.x[LATERAL_SPEED] = (l_r - m * v * v * l_f / (2 * C_r * (l_f + l_r))) * r
        self.x[YAW_SPEED], self.x[YAW_ERROR] = r, 0.0
        for i in (LATERAL_SPEED, YAW_SPEED, YAW_ERROR):
            self.P[i, :] = self.P[:, i] = 0.0
            self.P[i, i] = self.deviation[i] ** 2
        self.anchor = state

    def _update(
        self, anchor: VehicleState, state: VehicleState, commands: CommandHistory, elapsed: float
    ) -> None:
        """Predict the filter's state over a step, and correct it by the residual."""
        # Prediction
        F, v_x = np.eye(FILTER_SIZE), 0.5 * (anchor.v_x + state.v_x)
        times = anchor.stamp_ns, state.stamp_ns
        now, later = (
            sent_between(
                commands, *times, lengthened(self.car.response, self.x[LATENCY_CHANGE] + more)
            )
            for more in (0.0, DIFFERENCE[LATENCY_CHANGE])
        )
        motion = linearize(self.car.vehicle, self.friction, v_x, self.x, now, later, F)
        keep = F[YAW_ERROR, YAW_ERROR] = math.exp(-elapsed / YAW_ERROR_TIME)
        Q = self.walk**2 * elapsed
        Q[YAW_ERROR] = (1.0 - keep * keep) * self.deviation[YAW_ERROR] ** 2
        P = F @ self.P @ F.T + np.diag(Q)
        for i in PARAMETERS_AT:  # no estimate is less certain than at the start
            scale = min(self.deviation[i] / math.sqrt(P[i, i]), 1.0)
            P[i, :] *= scale
            P[:, i] *= scale
        x = np.array([*motion, *self.x[2:]])
        x[YAW_ERROR] *= keep

        # Correction by the yaw rate, and by the lateral velocity where it is plausible
        residual = state.yaw_rate - x[YAW_SPEED]
        if not abs(residual) <= MOST_RESIDUAL:
            self._start(state)
            return
        H = np.zeros(FILTER_SIZE)
        H[YAW_SPEED] = 1.0
        share = min(elapsed / NOISE_TIME, 1.0)
        self.noise[0] += share * (residual**2 - self.noise[0])
        variance = (
            max(self.noise[0], LEAST_NOISE_LEVEL[0] ** 2) + (NOISE_SHARE * state.yaw_rate) ** 2
        )
        x, P = corrected(x, P, H, residual, variance, kept=(STIFFNESS,))
        # v_y at the measured point = v_y - (to_cg - point) r
        H[LATERAL_SPEED], H[YAW_SPEED], H[POINT] = 1.0, x[POINT] - self.to_cg, x[YAW_SPEED]
        residual = state.v_y - (x[LATERAL_SPEED] + (x[POINT] - self.to_cg) * x[YAW_SPEED])
        is_stuck = state.v_y == anchor.v_y
        if not is_stuck and abs(residual) <= MOST_LATERAL:
            self.noise[1] += share * (residual**2 - self.noise[1])
            x, P = corrected(x, P, H, residual, max(self.noise[1], LEAST_NOISE_LEVEL[1] ** 2))
        if not (np.isfinite(x).all() and np.isfinite(P).all()):
            self._start(state)
            return
        x[DIFFERENCES] = np.clip(x[DIFFERENCES], self.lower, self.upper)
        self.x, self.P = x, 0.5 * (P + P.T)

        # Slow use; an unknown latency is used at once, because it decides about stability
        wanted = np.array([self._significant(i) for i in PARAMETERS_AT])
        self.used += np.minimum(elapsed / np.array(USE_TIME), 1.0) * (wanted - self.used)
        if not self.is_stated:
            self.used[0] = x[LATENCY_CHANGE]


def corrected(
    x: Array, P: Array, H: Array, residual: float, variance: float, kept: tuple[int, ...] = ()
) -> tuple[Array, Array]:
    """Return state and covariance of a Kalman filter after a scalar measurement.

    Args:
        x: State (n,).
        P: Its covariance (n, n).
        H: Derivative of the measurement (n,).
        residual: Measurement less its prediction.
        variance: Of the measurement.
        kept: Positions of the state that are not corrected: Schmidt-Kalman filter.
    """
    covariance = P @ H
    total = H @ covariance + variance
    gain = covariance / total
    for i in kept:
        gain[i] = 0.0
    cross = np.outer(gain, covariance)
    return x + gain * residual, P - cross - cross.T + total * np.outer(gain, gain)


def sent_between(
    commands: CommandHistory, begin_ns: int, end_ns: int, response: SteeringResponse
) -> tuple[float, float, Array]:
    """Return the fields of `Sent` for a step between two times [ns]."""
    acting = np.array(commands.between(begin_ns, end_ns, response.delay)).reshape(-1, 2)
    return response.lag, commands.wheel(begin_ns, response), acting


def lengthened(response: SteeringResponse, change: float) -> SteeringResponse:
    """Return a response whose latency is changed [s]; a lag above SHORT_LAG becomes a delay."""
    delay, lag = response
    changed = min(lag + change, max(lag, SHORT_LAG))
    delay += lag + change - changed
    if changed < 0.0:
        changed, delay = 0.0, delay + changed
    return SteeringResponse(max(delay, 0.0), changed)
