"""One step of the paper's formulation as a quadratic programme, Eq. (17), and its first move."""

from typing import NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.active_set import active_set, solver_numbers
from ampc_ros.mpc.constraints import input_rows, output_rows, output_steps, row_count, running_sum
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.mpc.hildreth import hildreth, hildreth_numbers
from ampc_ros.mpc.internal_model import Limits
from ampc_ros.mpc.laguerre import laguerre_sequence
from ampc_ros.mpc.model import STATES, Vehicle, augment, zero_order_hold
from ampc_ros.mpc.prediction import predict, quadratic_cost
from ampc_ros.mpc.qp import Qp
from ampc_ros.mpc.small_matrices import Scratch, dot, make_scratch, matrix, vector

MAX_CONDITION = 1e12
"""Condition number of E above which a gain set is refused: the solver would lose its digits."""


class Tick(NamedTuple):
    """What one step knows: speed of the model, augmented state (5,), angle in force, set-point."""

    v_x: float
    x: Array
    u: float
    r: float


class Move(NamedTuple):
    """What a programme says about the present step."""

    Delta_u: float
    """L(0)' eta within its bound [rad]."""
    active: int
    """Rows that hold with equality."""
    slack: float
    """[m]."""
    iterations: int
    status: int


@inlined
def blank_programme(gains: Gains, outputs: int, scratch: Scratch) -> Qp:
    """Make room for a programme with so many bounded outputs, and then a slack."""
    N = gains.laguerre_terms
    m, n = row_count(gains.control_horizon, outputs), N + 1 if outputs > 0 else N
    E, K, M = matrix(scratch, n, n), vector(scratch, n), matrix(scratch, m, n)
    return Qp(E, K, M, vector(scratch, m), vector(scratch, m))


@in_place
def pose(
    vehicle: Vehicle, gains: Gains, limits: Limits, tick: Tick, qp: Qp, scratch: Scratch
) -> None:
    """Fill the quadratic programme of Eq. (17) in eta, and the slack if outputs are bounded."""
    N_p, N_c, N, alpha, Q, R = gains
    A_k, B_k = matrix(scratch, STATES, STATES), vector(scratch, STATES)
    A, B = matrix(scratch, STATES, STATES), vector(scratch, STATES)
    zero_order_hold(vehicle, tick.v_x, 0.0, limits.T, A_k, B_k, scratch)
    augment(A_k, B_k, A, B)
    L, S = matrix(scratch, N_c, N), matrix(scratch, N_c, N)
    laguerre_sequence(alpha, L)
    running_sum(L, S)
    error, Phi = vector(scratch, N_p), matrix(scratch, N, N_p)
    predict(A, B, L, tick.x, error, Phi, scratch)
    for i in range(N_p):
        error[i] = tick.r - error[i]
    quadratic_cost(Phi, error, L, (Q, R), qp.E, qp.K)
    input_rows(qp, L, S, tick.u, (limits.Delta_u_max, limits.u_max))
    if len(qp.K) > N:
        qp.E[N, N] = 2 * limits.slack_weight
        output_rows(qp, 2 * N_c, Phi, error, limits.half_width)


@inlined
def solve(
    qp: Qp, limits: Limits, x: Array, multipliers: Array, scratch: Scratch
) -> tuple[int, int]:
    """Solve with the solver that the settings name; gives its iterations and status."""
    if limits.exact:
        return active_set(qp, x, multipliers, scratch)
    return hildreth(qp, (limits.sweeps, limits.tolerance), x, multipliers, scratch)


@in_place
def count_active(multipliers: Array) -> int:
    """Rows that hold with equality."""
    active = 0
    for multiplier in multipliers:
        active += multiplier != 0.0
    return active


@inlined
def plan(
    vehicle: Vehicle, gains: Gains, limits: Limits, tick: Tick, angles: Array, scratch: Scratch
) -> Move:
    """Pose and solve the programme of one step, and read the first move off its solution.

    Args:
        vehicle: The car as it is believed to be.
        gains: N_p, N_c, N, alpha, Q, R.
        limits: Bounds and solver.
        tick: What is known now.
        angles: Receives the angles to command at this and the following ticks, (N_c,) [rad]; may
            be empty.
        scratch: Memory for the programme.
    """
    N_p, N_c, N, _, _, _ = gains
    qp = blank_programme(gains, output_steps(N_p, N_c, limits.half_width), scratch)
    pose(vehicle, gains, limits, tick, qp, scratch)
    eta, multipliers = vector(scratch, len(qp.K)), vector(scratch, len(qp.low))
    iterations, status = solve(qp, limits, eta, multipliers, scratch)
    Delta_u = dot(qp.M[0][:N], eta[:N])  # the first row is L(0)'
    for i in range(min(N_c, len(angles))):
        angles[i] = tick.u + dot(qp.M[2 * i + 1][:N], eta[:N])  # these rows are the running sum
    bounded = min(max(Delta_u, -limits.Delta_u_max), limits.Delta_u_max)
    slack = eta[N] if len(eta) > N else 0.0
    return Move(bounded, count_active(multipliers), slack, iterations, status)


def scratch_numbers(steps: int, N_c: int, N: int) -> int:
    """Give the scratch memory of a tick.

    Args:
        steps: Of the prediction.
        N_c: Control horizon.
        N: Laguerre terms.
    """
    n, m = N + 1, 2 * N_c + 2 * steps + 1
    solver = max(solver_numbers(m, n), hildreth_numbers(m, n))
    return m * (n + 3) + (n + 8) * (steps + 10) + 2 * N_c * N + n * n + 400 + solver


def problem(vehicle: Vehicle, gains: Gains, limits: Limits, tick: Tick) -> Qp:
    """Give the quadratic programme of one step, in memory of its own; see `pose`."""
    N_p, N_c, N, _, _, _ = gains
    outputs = output_steps(N_p, N_c, limits.half_width)
    m, n = row_count(N_c, outputs), N + (outputs > 0)
    qp = Qp(np.zeros((n, n)), np.zeros(n), np.zeros((m, n)), np.zeros(m), np.zeros(m))
    pose(vehicle, gains, limits, tick, qp, make_scratch(scratch_numbers(N_p, N_c, N)))
    return qp


def check_conditioning(vehicle: Vehicle, gains: Gains, limits: Limits) -> None:
    """Refuse gains that make E of Eq. (17) numerically singular.

    Raises:
        ValueError: Names the Laguerre terms and pole, the condition number and its bound.
    """
    for v_x in (3.0, 27.0):
        E = problem(vehicle, gains, limits, Tick(v_x, np.zeros(5), 0.0, 0.0)).E
        N = gains.laguerre_terms
        condition = float(np.linalg.cond(E[:N, :N]))
        if not condition <= MAX_CONDITION:
            raise ValueError(
                f"gains: laguerre_terms = {N} with laguerre_pole = {gains.laguerre_pole:g} give "
                f"cond(E) = {condition:.1e} at {v_x:g} m/s, must be at most {MAX_CONDITION:.0e}"
            )
