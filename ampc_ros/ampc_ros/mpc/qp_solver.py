"""Scratch memory for the QP of one tick, and the solver that the settings select."""

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.active_set import active_set, active_set_numbers
from ampc_ros.mpc.constraints import row_count
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.mpc.hildreth import hildreth, hildreth_numbers
from ampc_ros.mpc.internal_model import Limits
from ampc_ros.mpc.qp import Qp
from ampc_ros.mpc.small_matrices import Scratch, matrix, vector


@inlined
def blank_qp(gains: Gains, outputs: int, scratch: Scratch) -> Qp:
    """Allocate a QP in scratch memory.

    Args:
        gains: They determine the number of unknowns and of input rows.
        outputs: Number of bounded output steps; if there are any, the slack is the last unknown.
        scratch: Memory.
    """
    N = gains.laguerre_terms
    m, n = row_count(gains.control_horizon, outputs), N + 1 if outputs > 0 else N
    E, K, M = matrix(scratch, n, n), vector(scratch, n), matrix(scratch, m, n)
    return Qp(E, K, M, vector(scratch, m), vector(scratch, m))


@inlined
def solve_qp(
    qp: Qp, limits: Limits, x: Array, multipliers: Array, scratch: Scratch
) -> tuple[int, int]:
    """Solve a QP with the solver of the settings; return its iterations and status."""
    if limits.exact:
        return active_set(qp, x, multipliers, scratch)
    return hildreth(qp, (limits.sweeps, limits.tolerance), x, multipliers, scratch)


@in_place
def count_active(multipliers: Array) -> int:
    """Return the number of rows that hold with equality."""
    active = 0
    for multiplier in multipliers:
        active += multiplier != 0.0
    return active


def scratch_numbers(steps: int, N_c: int, N: int) -> int:
    """Return the size of the scratch memory of a tick.

    Args:
        steps: Prediction horizon including the whole ticks of delay.
        N_c: Control horizon.
        N: Laguerre terms.
    """
    n, m = N + 1, 2 * N_c + 2 * steps + 1
    solver = max(active_set_numbers(m, n), hildreth_numbers(m, n))
    return m * (n + 3) + (n + 13) * (steps + 10) + 2 * N_c * N + n * n + 400 + solver
