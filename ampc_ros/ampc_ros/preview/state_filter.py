"""Steady-state Kalman filter of state and disturbance, in path coordinates.

The filter corrects the prediction of the internal model by a share of its innovation, the
difference between measurement and prediction. The gains are computed once for a grid of speeds from
the noise of the settings. They are used as far as the innovations show noise: a clean measurement
is used as it is, without delay. An innovation that stays the same is no noise but the error of
another state: the filter would integrate it. Where the lag of the steering is not configured, the
filter also acts as long as the lag is uncertain, or long, because the unfiltered loop has less
margin of delay.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.types import Array
from ampc_ros.mpc.internal_model import Actuator
from ampc_ros.mpc.model import STATES, YAW_RATE, BicycleParameters
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.model import E_PSI, E_Y, SampledModel, sample_model

SPEEDS = (1.5, 3.0, 5.0, 8.0, 12.0, 17.0, 23.0, 30.0, 40.0)
"""Speeds of the gains [m/s]."""
MEASURED = 4
"""Measured states: v_y, e_psi, r, e_y."""
LEAST_SHARE, GAINS = MEASURED, MEASURED + 1
"""Positions in `filter_numbers`, after the noise levels: least share, gains."""
LEAST_NOISE = 1e-4
"""Least standard deviation of a measurement [unit of the state]."""
MODEL_NOISE = (0.05, 0.004, 0.05, 0.08)
"""Rate of change that the model does not explain, white [unit of the state / s^0.5]."""
DISTURBANCE_NOISE = (1.0, 0.0015, 1.5, 0.03)
"""Random walk of the rate that the model does not explain [unit of the state / s^1.5]. Heading and
cross-track error are integrals of the other states: more here would read a late steering actuator
as a disturbance."""
DISTURBANCE_GAIN = (0.3, 0.05, 0.3, 0.05)
"""Share of an innovation that enters the disturbance in a tick without filter, by state."""
LEAST_LEVEL, FULL_LEVEL = 0.15, 0.75
"""Half the squared change of the pose's innovation from step to step, relative to the configured
noise, from which the filter acts, and acts fully. White noise of that level causes 1.2 to 3."""
LEAST_BIAS, FULL_BIAS = 0.3, 0.9
"""Product of successive innovations from which the filter acts less, and not at all."""
LEVEL_TIME, MAX_LEVEL, MAX_BIAS = 1.0, 8.0, 4.0
"""Time constant of both levels [s], and the largest noise and bias of a single step."""
NOISE, BIAS, LEVEL_SIZE = 2, 3, 4
"""Positions in the levels, after the innovations of heading and cross-track error."""
OUTLIER_LEVEL = 16.0
"""Squared innovation that is no noise but a jump: the measured state is used."""
OUTLIER_SHARE = 0.25
"""Share with which such an innovation counts as noise."""
LASTING_LEVEL = 3.0
"""Level of noise from which such an innovation is no jump but an error of the model: the
disturbance is estimated as without filter."""
LARGEST_YAW_CHANGE = 0.15
"""Innovation of the yaw rate above which the filter does not act: the yaw rate may be wrong, and
would be integrated into the estimated heading [rad/s]."""


class Noise(NamedTuple):
    """Standard deviations of a measured state."""

    lateral_velocity: float
    heading: float
    yaw_rate: float
    position: float


def noise_of(settings: ControllerSettings) -> Noise:
    """Return the noise of the settings."""
    return Noise(
        settings.lateral_velocity_noise,
        settings.heading_noise,
        settings.yaw_rate_noise,
        settings.position_noise,
    )


NO_FILTER = Noise(math.inf, math.inf, math.inf, math.inf)
"""Noise with which the level is always 0."""


@lru_cache
def filter_numbers(
    vehicle: BicycleParameters, actuator: Actuator, T: float, noise: Noise, least_share: float
) -> Array:
    """Return noise levels (4,), least share, and gains (8, 4) at each of SPEEDS as a row.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        actuator: Steering actuator of the internal model.
        T: Step [s].
        noise: Standard deviations; without noise of the pose there is no filter.
        least_share: Share of the gains that is used without noise, 0 to 1.
    """
    if noise.heading == noise.position == 0.0:
        noise, least_share = NO_FILTER, 0.0
    if noise == NO_FILTER:
        return np.array([*noise, 0.0, *np.zeros(len(SPEEDS) * 2 * MEASURED * MEASURED)])
    gains = [gains_at(vehicle, actuator, T, noise, v).ravel() for v in SPEEDS]
    return np.concatenate((np.maximum(noise, LEAST_NOISE), [least_share], *gains))


def gains_at(
    vehicle: BicycleParameters, actuator: Actuator, T: float, noise: Noise, v_x: float
) -> Array:
    """Return the gain (8, 4) of [v_y, e_psi, r, e_y] and their disturbances at a speed."""
    n = MEASURED
    sampled = SampledModel(np.zeros((STATES, STATES)), *np.zeros((3, STATES)))
    sample_model(vehicle, v_x, T, actuator, sampled, make_scratch(400))
    A = np.eye(2 * n)
    A[:n, :n], A[:n, n:] = sampled.A[:n, :n], np.eye(n)
    Q = np.zeros((2 * n, 2 * n))
    Q[:n, :n] = np.diag(np.square(MODEL_NOISE) * T)
    Q[n:, n:] = np.diag(np.square(DISTURBANCE_NOISE) * T * T * T)
    R = np.diag(np.square(np.maximum(noise, LEAST_NOISE)))
    P = prediction_covariance(A, Q, R)
    return np.asarray(P[:, :n] @ np.linalg.inv(P[:n, :n] + R))


def prediction_covariance(A: Array, Q: Array, R: Array) -> Array:
    """Solve P = A (P - P C' (C P C' + R)^-1 C P) A' + Q with C = [I 0], by doubling.

    Chu, Fan, Lin, Wang, "Structure-preserving algorithms for periodic discrete-time algebraic
    Riccati equations", 2004: each step squares the closed-loop map.

    Args:
        A: (n, n) transition.
        Q: (n, n) covariance of the process.
        R: (m, m) covariance of the measurement of the first m states.
    """
    F, G, P, one = A.T.copy(), np.zeros_like(A), Q.copy(), np.eye(len(A))
    G[: len(R), : len(R)] = np.linalg.inv(R)
    for _ in range(60):
        W = np.linalg.inv(one + G @ P)
        step = F.T @ P @ W @ F
        F, G, P = F @ W @ F, G + F @ W @ G @ F.T, P + step
        if np.abs(step).max() <= 1e-12 * np.abs(P).max():
            break
    return P


@in_place
def filter_share(numbers: Array, level: Array) -> float:
    """Return the share of the filter's gains, 0 to 1.

    Args:
        numbers: `filter_numbers`.
        level: Innovations of the last step, levels of noise and of bias (LEVEL_SIZE,).
    """
    noise = (level[NOISE] - LEAST_LEVEL) / (FULL_LEVEL - LEAST_LEVEL)
    bias = (level[BIAS] - LEAST_BIAS) / (FULL_BIAS - LEAST_BIAS)
    share = min(max(noise, numbers[LEAST_SHARE]), 1.0)
    return float(share * (1.0 - min(max(bias, 0.0), 1.0)))


@in_place
def update_level(numbers: Array, innovation: Array, T: float, level: Array) -> None:
    """Update the levels of noise and bias by the innovations of the pose.

    White noise changes from step to step. An innovation that stays the same is an error of another
    state, such as a wrong yaw rate, which the filter would integrate.

    Args:
        numbers: `filter_numbers`.
        innovation: (>= 4,).
        T: Step [s].
        level: Innovations of the last step, levels of noise and of bias; changed in place.
    """
    noise, bias, gain, squared = 0.0, 0.0, min(T / LEVEL_TIME, 1.0), 0.0
    for i in (E_PSI, E_Y):
        squared += 0.5 * (innovation[i] / numbers[i]) ** 2
    if squared > OUTLIER_LEVEL * max(level[NOISE], 1.0):  # a jump is no noise; lasting ones are
        level[NOISE] += OUTLIER_SHARE * gain * max(MAX_BIAS - level[NOISE], 0.0)
        return
    for k in range(2):
        i = E_PSI if k == 0 else E_Y
        now, last = innovation[i] / numbers[i], level[k]
        noise += 0.25 * (now - last) ** 2
        bias += 0.5 * now * last
        level[k] = now
    level[NOISE] += gain * (min(noise, MAX_LEVEL) - level[NOISE])
    if abs(innovation[YAW_RATE]) > LARGEST_YAW_CHANGE:
        level[NOISE] = 0.0
    level[BIAS] += gain * (min(bias, MAX_BIAS) - level[BIAS])


@in_place
def correct(
    numbers: Array,
    v_x: float,
    level: Array,
    ticks: float,
    x: Array,
    expected: Array,
    disturbance: Array,
) -> None:
    """Replace a measured state by its estimate, and update the estimated disturbance.

    Args:
        numbers: `filter_numbers`.
        v_x: Speed [m/s].
        level: Levels, see `filter_share`; without noise the measured state is kept.
        ticks: Number of ticks since the last measured state.
        x: Measured state (>= 4,), changed in place.
        expected: State that the model predicts without disturbance (>= 4,); receives the
            innovation.
        disturbance: Estimated change of the state in a tick (>= 4,), changed in place.
    """
    k, size, squared = 0, 2 * MEASURED * MEASURED, 0.0
    share = filter_share(numbers, level)
    while k < len(SPEEDS) - 2 and v_x >= SPEEDS[k + 1]:
        k += 1
    place = min(max((v_x - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k]), 0.0), 1.0)
    slow, fast = numbers[GAINS + k * size :], numbers[GAINS + (k + 1) * size :]
    for i in range(MEASURED):
        expected[i] += disturbance[i]
        expected[i] = x[i] - expected[i]
    for i in (E_PSI, E_Y):
        squared += 0.5 * (expected[i] / numbers[i]) ** 2
    if abs(expected[YAW_RATE]) > LARGEST_YAW_CHANGE:
        share = 0.0
    elif squared > OUTLIER_LEVEL * max(level[NOISE], 1.0):
        if share > 0.0 and level[NOISE] < LASTING_LEVEL:
            return
        share = 0.0
    for i in range(MEASURED):
        learnt, change = 0.0, 0.0
        for j in range(MEASURED):
            at, below = i * MEASURED + j, (i + MEASURED) * MEASURED + j
            change += (slow[at] + place * (fast[at] - slow[at])) * expected[j]
            learnt += (slow[below] + place * (fast[below] - slow[below])) * expected[j]
        x[i] += share * (change - expected[i])
        unfiltered = DISTURBANCE_GAIN[i] * expected[i]
        disturbance[i] += (unfiltered + share * (learnt - unfiltered)) / ticks
