"""One tick of the paper's controller in one compiled call."""

from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.paths.path import NOT_CAUGHT, Path, advance, errors_at
from ampc_msgs_config.paths.path_frame import PathFrame, place, set_point
from ampc_msgs_config.types import TRACKING, Array, Diagnosis, VehicleState
from ampc_ros.mpc.gain_table import NONE, Gains, Table, look_up
from ampc_ros.mpc.internal_model import believed
from ampc_ros.mpc.model import STATES
from ampc_ros.mpc.programme import Move, Tick, plan
from ampc_ros.mpc.qp import SOLVED
from ampc_ros.mpc.small_matrices import Scratch, vector

STEERING, KNOWN, LAST, INDEX, IN_USE, MEMORY = 0, 1, 2, 6, 7, 9
"""What the controller remembers, in a row of MEMORY numbers: angle in force, whether there was a
step before, its state (4,), index on the path, node of the table (2,)."""


class Answer(NamedTuple):
    """Of a tick."""

    steering: float
    """Angle to command [rad]."""
    rate: float
    """[rad/s]."""
    diagnosis: Diagnosis


@inlined
def augmented_state(memory: Array, x: tuple[float, float, float, float], out: Array) -> None:
    """Fill x~ = [Delta x, y] of Eq. (9), (5,); no increment is known at the first step."""
    for i in range(4):
        out[i] = x[i] - memory[LAST + i] if memory[KNOWN] > 0.0 else 0.0
        memory[LAST + i] = x[i]
    out[1] = wrap_angle(out[1])
    out[4] = x[3]
    memory[KNOWN] = 1.0


@inlined
def paper_tick(
    numbers: Array,
    table: Table,
    path: Path,
    frame: PathFrame,
    state: VehicleState,
    memory: Array,
    scratch: Scratch,
    angles: Array,
) -> Answer:
    """Answer one state: set-point, gains, model, prediction, bounds, QP, first move.

    Args:
        numbers: Belief (20,).
        table: Gains.
        path: The reference.
        frame: The same as Y_ref(X).
        state: At `base_link`.
        memory: (MEMORY,) of this controller, changed in place.
        scratch: At least `scratch_numbers(...)`.
        angles: Receives the planned angles (N_c,) [rad]; may be empty.
    """
    scratch.used[0] = 0
    belief = believed(numbers)
    limits = belief.limits
    car = at_distance(state, belief.to_cg)
    X, Y, yaw = place(frame, car.x, car.y, car.yaw)
    r = set_point(frame, X)
    gains, outside = look_up(table, memory[IN_USE:], car.v_x, r)
    x = vector(scratch, STATES)
    augmented_state(memory, (car.v_y, yaw, car.yaw_rate, Y), x)
    v_x = belief.nominal_speed if belief.nominal_speed > 0.0 else car.v_x
    tick = Tick(v_x, x, memory[STEERING], r)
    move = plan(belief.vehicle, gains, limits, tick, angles, scratch)
    before, Delta_u = memory[STEERING], move.Delta_u if move.status == SOLVED else 0.0
    memory[STEERING] = min(max(before + Delta_u, -limits.u_max), limits.u_max)
    s, index = advance(path, int(memory[INDEX]), car.x, car.y, car.yaw)
    memory[INDEX] = index
    errors = errors_at(path, s, car.x, car.y, car.yaw)
    diagnosis = diagnose(errors, move, gains, outside)
    return Answer(memory[STEERING], (memory[STEERING] - before) / limits.T, diagnosis)


@inlined
def diagnose(errors: tuple[float, float], move: Move, gains: Gains, outside: bool) -> Diagnosis:
    """Say what can be said about a step."""
    N_p, N_c, N, alpha, Q, R = gains
    converged = 1.0 if move.status == SOLVED else 0.0
    outside_table = 1.0 if outside else 0.0
    return Diagnosis(
        cross_track_error=errors[0],
        heading_error=errors[1],
        curvature=np.nan,
        feed_forward=np.nan,
        disturbance=0.0,
        mode=float(TRACKING),
        active_constraints=float(move.active),
        slack=move.slack,
        solver_iterations=float(move.iterations),
        converged=converged,
        prediction_horizon=float(N_p),
        control_horizon=float(N_c),
        laguerre_terms=float(N),
        laguerre_pole=alpha,
        output_weight=Q,
        increment_weight=R,
        outside_table=outside_table,
    )


def new_memory() -> Array:
    """Give the memory (MEMORY,) of a controller that has not stepped yet."""
    memory = np.zeros(MEMORY)
    memory[INDEX], memory[IN_USE:] = NOT_CAUGHT, NONE
    return memory


@in_place
def paper_answer(
    numbers: Array,
    table: tuple[Any, ...],
    road: tuple[Any, Any],
    state: tuple[Any, ...],
    memory: Array,
    scratch: tuple[Any, ...],
    angles: Array,
) -> tuple[float, float, tuple[float, ...]]:
    """Call `paper_tick` from Python: plain tuples in place of named ones, both ways.

    A named tuple takes numba a microsecond at the border, a plain one a tenth of it.
    """
    path, frame = road
    answer = paper_tick(
        numbers,
        Table(*table),
        Path(*path),
        PathFrame(*frame),
        VehicleState(*state),
        memory,
        Scratch(*scratch),
        angles,
    )
    return answer.steering, answer.rate, plain(answer.diagnosis)


@inlined
def plain(diagnosis: Diagnosis) -> tuple[float, ...]:
    """Give the fields as a plain tuple."""
    return diagnosis[:]
