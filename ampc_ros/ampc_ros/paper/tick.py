"""One tick of the paper's controller in one compiled call."""

import math
from typing import Any

import numpy as np

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.paths.path import NOT_CAUGHT, Path, advance, errors_at
from ampc_msgs_config.paths.path_frame import PathFrame, place, set_point
from ampc_msgs_config.types import TRACKING, Array, VehicleState
from ampc_ros.mpc.gain_table import NONE, Table, look_up
from ampc_ros.mpc.internal_model import unpack_internal_model
from ampc_ros.mpc.model import STATES
from ampc_ros.mpc.small_matrices import Scratch, vector
from ampc_ros.mpc.tick_result import TickResult, diagnose
from ampc_ros.paper.qp_assembly import StepInput, paper_plan

STEERING, HAS_LAST, LAST, INDEX, IN_USE, MEMORY = 0, 1, 2, 6, 7, 9
"""Positions in the controller's memory (MEMORY,): angle in force, whether a last state exists, last
state (4,), index on the path, node of the gain table (2,)."""


@inlined
def augmented_state(memory: Array, x: tuple[float, float, float, float], out: Array) -> None:
    """Fill the augmented state [Delta x, y] of Eq. (9), (5,); Delta x is zero at the first step."""
    for i in range(4):
        out[i] = x[i] - memory[LAST + i] if memory[HAS_LAST] > 0.0 else 0.0
        memory[LAST + i] = x[i]
    out[1] = wrap_angle(out[1])
    out[4] = x[3]
    memory[HAS_LAST] = 1.0


@inlined
def paper_tick(
    model_row: Array,
    table: Table,
    path: Path,
    frame: PathFrame,
    state: VehicleState,
    memory: Array,
    scratch: Scratch,
    angles: Array,
) -> TickResult:
    """Compute the command for one state.

    Args:
        model_row: `pack_internal_model` of the controller.
        table: Gains.
        path: Reference path.
        frame: The same path as Y_ref(X).
        state: State at `base_link`.
        memory: Memory of this controller, see `new_memory`; changed in place.
        scratch: At least `scratch_numbers(...)`.
        angles: Receives the planned angles (N_c,) [rad]; may be empty.
    """
    scratch.used[0] = 0
    model = unpack_internal_model(model_row)
    # State and set-point in the inertial frame of the path
    car = at_distance(state, model.to_cg)
    X, Y, yaw = place(frame, car.x, car.y, car.yaw)
    r = set_point(frame, X)
    # Gains at this speed and set-point
    gains, outside = look_up(table, memory[IN_USE:], car.v_x, r)
    # Augmented state, QP and first move
    x = vector(scratch, STATES)
    augmented_state(memory, (car.v_y, yaw, car.yaw_rate, Y), x)
    v_x = model.nominal_speed if model.nominal_speed > 0.0 else car.v_x
    before = memory[STEERING]
    step = StepInput(v_x, x, before, r)
    plan = paper_plan(model.vehicle, gains, model.limits, step, angles, scratch)
    memory[STEERING] = plan.steering
    # Diagnosis relative to the path; the controller itself uses only the set-point
    s, index = advance(path, int(memory[INDEX]), car.x, car.y, car.yaw)
    memory[INDEX] = index
    errors = errors_at(path, s, car.x, car.y, car.yaw)
    road_values = math.nan, math.nan, 0.0
    diagnosis = diagnose(errors, road_values, TRACKING, plan, gains, True, outside)
    return TickResult(plan.steering, (plan.steering - before) / model.limits.T, diagnosis)


def new_memory() -> Array:
    """Return the memory (MEMORY,) of a controller before its first step."""
    memory = np.zeros(MEMORY)
    memory[INDEX], memory[IN_USE:] = NOT_CAUGHT, NONE
    return memory


@in_place
def call_paper_tick(
    model_row: Array,
    table: tuple[Any, ...],
    road: tuple[Any, Any],
    state: tuple[Any, ...],
    memory: Array,
    scratch: tuple[Any, ...],
    angles: Array,
) -> tuple[float, float, tuple[float, ...]]:
    """Call `paper_tick` from Python with plain tuples; see doc/compiled_code.md."""
    path, frame = road
    result = paper_tick(
        model_row,
        Table(*table),
        Path(*path),
        PathFrame(*frame),
        VehicleState(*state),
        memory,
        Scratch(*scratch),
        angles,
    )
    return result.steering, result.rate, result.diagnosis[:]
