"""One tick of the preview formulation in one compiled call."""

import math
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.paths.path import (
    NOT_CAUGHT,
    Path,
    advance,
    curvature_between,
    errors_at,
    point_at,
)
from ampc_msgs_config.types import (
    PATH_END,
    REVERSE,
    STANDSTILL,
    TRACKING,
    WRONG_WAY,
    Array,
    VehicleState,
)
from ampc_ros.mpc.gain_table import NONE, Table, look_up
from ampc_ros.mpc.internal_model import ROW_SIZE, InternalModel, unpack_internal_model
from ampc_ros.mpc.model import DELTA, STATES
from ampc_ros.mpc.qp import SOLVED
from ampc_ros.mpc.small_matrices import Scratch, vector
from ampc_ros.mpc.tick_result import HOLD_BELOW, REVERSE_BELOW, QpResult, TickResult, diagnose
from ampc_ros.preview.model import (
    blank_model,
    sample_model,
    steady_steering,
    unmodelled_accelerations,
)
from ampc_ros.preview.nominal_steering import Road
from ampc_ros.preview.qp_assembly import Past, preview_plan
from ampc_ros.preview.state_filter import DISTURBANCE_GAIN, MEASURED, correct, update_level

LEARN_ABOVE = 1.5
"""Speed from which the disturbance is estimated; at lower speeds the model is inaccurate [m/s]."""

MAX_DISTURBANCE = (3.0, 0.05, 1.5, 0.5, 0.0)
"""Largest disturbance; a larger residual is a skid and no wind [unit of the state / s]."""

ACCELERATION_GAIN = 0.3
"""Share of a new difference of speeds that enters the estimated acceleration in a tick."""

LARGEST_SPEED_CHANGE = 15.0
"""A larger difference of speeds is a step of the measurement, and no acceleration [m/s^2]."""

ACCELERATION_FADE = 1.0
"""Time constant with which the acceleration is predicted to fade [s]."""

INDEX, IN_USE, LAST_SPEED, ACCELERATION, EXPECTS, LEVEL, BEFORE = 0, 1, 3, 4, 5, 6, 10

DISTURBANCE, EXPECTED, STATE_DELTA, SENT = 11, 16, 20, 21
"""Positions in the controller's memory: index on the path, node of the gain table (2,), speed at
the last tick, estimated acceleration, ticks since the last measured
state (0: no state is expected), levels of the state filter
(4,), the command before the oldest one that is stored, disturbance (5,), predicted state (5,),
whose last number is the road-wheel angle, and the stored commands, the newest last (at least
n + 1,): those in the delay, and more where the delay may become longer."""


class PathPosition(NamedTuple):
    """Position of the car relative to its path."""

    s: float
    """Arc length [m]."""
    e_y: float
    """Cross-track error [m]."""
    e_psi: float
    """Heading error [rad]."""
    mode: int
    """Index in MODES."""


@in_place
def sample_road(path: Path, s: float, memory: Array, T: float, road: Road) -> None:
    """Fill speeds and mean curvatures of the horizon, and the curvatures of the road behind.

    Args:
        path: Reference path.
        s: Arc length of the car [m].
        memory: Memory of the controller: speed now, and acceleration, which fades.
        T: Step [s].
        road: Filled.
    """
    v_x, a_x = memory[LAST_SPEED], memory[ACCELERATION]
    road.speed[0], road.curvature[0] = v_x, curvature_between(path, s - v_x * T, s)
    for j in range(len(road.behind)):
        end = s - (j + 1) * v_x * T
        road.behind[j] = curvature_between(path, end - v_x * T, end)
    left, fade = math.exp(-0.5 * T / ACCELERATION_FADE), math.exp(-T / ACCELERATION_FADE)
    for j in range(1, len(road.speed)):
        road.speed[j] = max(v_x + a_x * ACCELERATION_FADE * (1.0 - left), 0.0)
        left *= fade
        road.curvature[j] = curvature_between(path, s, s + road.speed[j] * T)
        s += road.speed[j] * T


@in_place
def locate(path: Path, car: VehicleState, memory: Array) -> PathPosition:
    """Return the car's position on its path, and the mode: whether it can be steered along it."""
    s, index = advance(path, int(memory[INDEX]), car.x, car.y, car.yaw)
    memory[INDEX] = index
    e_y, e_psi = errors_at(path, s, car.x, car.y, car.yaw)
    mode = TRACKING if path.closed or s <= (len(path.x) - 1) * path.spacing else PATH_END
    if car.v_x < HOLD_BELOW:
        mode = STANDSTILL if car.v_x > REVERSE_BELOW else REVERSE
    elif abs(e_psi) > math.pi / 2:
        mode = WRONG_WAY
    return PathPosition(s, e_y, e_psi, mode)


@in_place
def update_estimates(
    memory: Array, numbers: Array, v_x: float, x: Array, elapsed: float, T: float
) -> None:
    """Filter the measured state, and update disturbance and acceleration.

    Args:
        memory: Changed in place.
        numbers: `filter_numbers`.
        v_x: Speed [m/s].
        x: State relative to the path (5,), changed in place.
        elapsed: Time since the last step; nan if there was none [s].
        T: Step [s].
    """
    last, memory[LAST_SPEED] = memory[LAST_SPEED], v_x
    if not 0.5 * T < elapsed < 1.5 * T:
        memory[EXPECTS] = 0.0
        return
    acceleration = (v_x - last) / elapsed
    if abs(acceleration) <= LARGEST_SPEED_CHANGE:
        memory[ACCELERATION] += ACCELERATION_GAIN * (acceleration - memory[ACCELERATION])
    if memory[EXPECTS] == 0.0:
        return
    expected, disturbance = memory[EXPECTED:STATE_DELTA], memory[DISTURBANCE:EXPECTED]
    if v_x >= LEARN_ABOVE:
        level = memory[LEVEL:BEFORE]
        correct(numbers, v_x, level, memory[EXPECTS], x, expected, disturbance)
        update_level(numbers, expected, T, level)
    else:
        for i in range(MEASURED):
            disturbance[i] -= DISTURBANCE_GAIN[i] * disturbance[i]
    for i in range(STATES):
        bound = MAX_DISTURBANCE[i] * T
        disturbance[i] = min(max(disturbance[i], -bound), bound)


@in_place
def store_command(memory: Array, steering: float) -> float:
    """Append a command to those in the delay; return the change from the previous one [rad]."""
    newest = len(memory) - 1
    change, memory[BEFORE] = steering - memory[newest], memory[SENT]
    for i in range(SENT, newest):
        memory[i] = memory[i + 1]
    memory[newest] = steering
    return float(change)


@in_place
def predict_next_state(
    model: InternalModel, memory: Array, x: Array, road: Road, scratch: Scratch
) -> None:
    """Store the state that the model, without disturbance, predicts for the next tick.

    Note:
        The horizon is sampled at the mean speed of each step, this prediction at the present speed:
        the model of the first step of the horizon cannot be reused bit for bit.
    """
    sampled = blank_model(scratch)
    T, actuator = model.limits.T, model.actuator
    sample_model(model.vehicle, road.speed[0], T, actuator, sampled, scratch)
    newest = len(memory) - 1
    old, before = memory[newest - actuator.ticks], newest - actuator.ticks - 1
    older = memory[before] if before >= SENT else memory[BEFORE]
    for i in range(STATES):
        expected = sampled.B_old[i] * older + sampled.B_new[i] * old
        expected += sampled.D[i] * road.curvature[1]
        for k in range(STATES):
            expected += sampled.A[i, k] * x[k]
        memory[EXPECTED + i] = expected
    memory[EXPECTS] = 1.0


@in_place
def fill_prediction(
    path: Path, s: float, speed: Array, lateral: Array, angles: Array, T: float, out: Array
) -> None:
    """Fill the predicted position of the car at each step of the horizon, and the planned angles.

    Args:
        path: Reference path.
        s: Arc length of the car [m].
        speed: (H + 1,) [m/s].
        lateral: Predicted cross-track error (H,) [m].
        angles: Planned angles (H,) [rad].
        T: Step [s].
        out: (>= H, 3) x and y in `map` [m], angle [rad].
    """
    for j in range(len(lateral)):
        s += speed[j + 1] * T
        point = point_at(path, s)
        out[j, 0] = point.x - lateral[j] * math.sin(point.heading)
        out[j, 1] = point.y + lateral[j] * math.cos(point.heading)
        out[j, 2] = angles[j]


@inlined
def preview_tick(
    model_row: Array,
    table: Table,
    path: Path,
    state: VehicleState,
    elapsed: float,
    memory: Array,
    scratch: Scratch,
    predicted: Array,
) -> TickResult:
    """Compute the command for one state.

    Args:
        model_row: `pack_internal_model` of the controller.
        table: Gains.
        path: Reference path.
        state: State at `base_link`.
        elapsed: Time since the last step; nan if there was none [s].
        memory: Memory of this controller, see `new_memory`; changed in place.
        scratch: At least `scratch_numbers(...)`.
        predicted: Receives points and angles of the horizon (>= H, 3), see `fill_prediction`; may
            have no row.
    """
    scratch.used[0] = 0
    model = unpack_internal_model(model_row)
    # State relative to the path
    T, car, x = model.limits.T, at_distance(state, model.to_cg), vector(scratch, STATES)
    position = locate(path, car, memory)
    x[0], x[1], x[2], x[3] = car.v_y, math.sin(position.e_psi), car.yaw_rate, position.e_y
    x[DELTA] = memory[STATE_DELTA]
    # Disturbance and acceleration, from the residual of the last prediction
    update_estimates(memory, model_row[ROW_SIZE:], car.v_x, x, elapsed, T)
    # Gains at this speed
    gains, outside = look_up(table, memory[IN_USE : IN_USE + 2], car.v_x, 0.0)
    steers = position.mode == TRACKING or position.mode == PATH_END
    plan, change = QpResult(memory[len(memory) - 1], 0, 0.0, 0, SOLVED), 0.0
    disturbance = memory[DISTURBANCE : DISTURBANCE + STATES]
    if steers:
        # Horizon along the path, QP and first move
        H = gains.prediction_horizon + model.actuator.ticks
        road = Road(vector(scratch, H + 1), vector(scratch, H + 1), vector(scratch, H))
        lateral, angles = vector(scratch, H), vector(scratch, H)
        sample_road(path, position.s, memory, T, road)
        past = Past(x, memory[SENT:], disturbance)
        plan = preview_plan(model, gains, past, road, lateral, angles, scratch)
        # Memory for the next tick, and the prediction for viewers
        change = store_command(memory, plan.steering)
        predict_next_state(model, memory, x, road, scratch)
        if len(predicted) > 0:
            fill_prediction(path, position.s, road.speed, lateral, angles, T, predicted)
    else:
        # Standstill, reverse or wrong way: hold the angle
        store_command(memory, plan.steering)
        memory[EXPECTS] = 0.0
    # Diagnosis
    curvature = point_at(path, position.s).curvature
    unexplained, _ = unmodelled_accelerations(model.vehicle, car.v_x, T, disturbance, scratch)
    feed_forward = steady_steering(model.vehicle, car.v_x, curvature)
    errors, road_values = (position.e_y, position.e_psi), (curvature, feed_forward, unexplained)
    diagnosis = diagnose(errors, road_values, position.mode, plan, gains, steers, outside)
    return TickResult(plan.steering, change / T, diagnosis)


def new_memory(ticks: int) -> Array:
    """Return the memory of a controller before its first step.

    Args:
        ticks: Largest number of whole ticks of delay of its steering.
    """
    memory = np.zeros(SENT + ticks + 1)
    memory[INDEX], memory[IN_USE : IN_USE + 2] = NOT_CAUGHT, NONE
    return memory


@in_place
def call_preview_tick(
    model_row: Array,
    table: tuple[Any, ...],
    path: tuple[Any, ...],
    state: tuple[Any, ...],
    elapsed: float,
    memory: Array,
    scratch: tuple[Any, ...],
    predicted: Array,
) -> tuple[float, float, tuple[float, ...]]:
    """Call `preview_tick` from Python with plain tuples; see doc/compiled_code.md."""
    result = preview_tick(
        model_row,
        Table(*table),
        Path(*path),
        VehicleState(*state),
        elapsed,
        memory,
        Scratch(*scratch),
        predicted,
    )
    return result.steering, result.rate, result.diagnosis[:]
