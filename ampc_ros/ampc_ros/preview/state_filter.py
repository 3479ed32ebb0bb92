"""Steady-state Kalman filter of state and disturbance, in path coordinates.

The filter corrects the prediction of the internal model with the measured state. Its gains are
computed once for a grid of speeds: noise and model decide, no tuning by hand.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.types import Array
from ampc_ros.mpc.internal_model import Actuator
from ampc_ros.mpc.model import STATES, BicycleParameters
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.model import SampledModel, sample_model

SPEEDS = (1.5, 3.0, 5.0, 8.0, 12.0, 17.0, 23.0, 30.0, 40.0)
"""Speeds of the gains [m/s]."""
MEASURED = 4
"""Measured states: v_y, e_psi, r, e_y."""
GAINS_SIZE = len(SPEEDS) * 2 * MEASURED * MEASURED
"""Numbers of all gains."""
LEAST_NOISE = 1e-4
"""Least standard deviation, with which the filter believes a measurement [unit of the state]."""
MODEL_NOISE = (1.0, 0.02, 0.6, 0.1)
"""Rate of change that the model does not explain, white, in a second [unit of the state / s^0.5]."""
DISTURBANCE_NOISE = (1.5, 0.01, 0.8, 0.05)
"""Random walk of the disturbance in a second [unit of the state / s^1.5]."""
STEERING_NOISE = 0.0
"""Error of the road-wheel angle, white from tick to tick [rad]."""


class Noise(NamedTuple):
    """Standard deviations of a measured state."""

    lateral_velocity: float
    heading: float
    yaw_rate: float
    position: float


@lru_cache
def filter_gains(vehicle: BicycleParameters, actuator: Actuator, T: float, noise: Noise) -> Array:
    """Return the gains (GAINS_SIZE,) of state and disturbance for each of SPEEDS."""
    return np.concatenate([gains_at(vehicle, actuator, T, noise, v).ravel() for v in SPEEDS])


def gains_at(
    vehicle: BicycleParameters, actuator: Actuator, T: float, noise: Noise, v_x: float
) -> Array:
    """Return the gain (8, 4) of [v_y, e_psi, r, e_y] and their disturbances at a speed."""
    n = MEASURED
    sampled = SampledModel(np.zeros((STATES, STATES)), *np.zeros((3, STATES)))
    sample_model(vehicle, v_x, T, actuator, sampled, make_scratch(400))
    A, B = np.eye(2 * n), sampled.B_old[:n] + sampled.B_new[:n]
    A[:n, :n], A[:n, n:] = sampled.A[:n, :n], np.eye(n)
    Q = np.zeros((2 * n, 2 * n))
    Q[:n, :n] = np.diag(np.square(MODEL_NOISE) * T) + STEERING_NOISE**2 * np.outer(B, B)
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
def correct(gains: Array, v_x: float, x: Array, expected: Array, disturbance: Array) -> None:
    """Replace a measured state by its estimate, and update the estimated disturbance.

    Args:
        gains: `filter_gains`.
        v_x: Speed [m/s].
        x: Measured state (>= 4,), changed in place.
        expected: State that the model predicts without disturbance (>= 4,).
        disturbance: Estimated change of the state in a tick (>= 4,), changed in place.
    """
    k, size = 0, 2 * MEASURED * MEASURED
    while k < len(SPEEDS) - 2 and v_x >= SPEEDS[k + 1]:
        k += 1
    share = min(max((v_x - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k]), 0.0), 1.0)
    slow, fast = gains[k * size :], gains[(k + 1) * size :]
    for i in range(MEASURED):
        expected[i] += disturbance[i]
        x[i] -= expected[i]  # the innovation
    for i in range(2 * MEASURED):
        change = 0.0
        for j in range(MEASURED):
            place = i * MEASURED + j
            change += (slow[place] + share * (fast[place] - slow[place])) * x[j]
        if i < MEASURED:
            expected[i] += change
        else:
            disturbance[i - MEASURED] += change
    for i in range(MEASURED):
        x[i] = expected[i]
