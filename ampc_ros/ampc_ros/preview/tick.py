"""One tick of the `preview` formulation in one compiled call: place, lesson, gains, road, plan."""

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
    Diagnosis,
    VehicleState,
)
from ampc_ros.mpc.gain_table import NONE, Gains, Table, look_up
from ampc_ros.mpc.internal_model import InternalModel, believed
from ampc_ros.mpc.model import DELTA, STATES
from ampc_ros.mpc.qp import SOLVED
from ampc_ros.mpc.small_matrices import Scratch, vector
from ampc_ros.paper.tick import Answer, plain
from ampc_ros.preview.model import blank_model, sample, side_acceleration, steady_steering
from ampc_ros.preview.programme import Past, Plan, Road, preview_plan

HOLD_BELOW = 0.3
"""Below this speed the steering holds [m/s]."""

REVERSE_BELOW = -0.3
"""Below this speed the car drives backwards, which this controller refuses to steer; a standing
car with noise does not [m/s]."""

LEARN_ABOVE = 1.5
"""Speed from which the disturbance is learnt: below it the model is not the car's [m/s]."""

DISTURBANCE_GAIN = (0.3, 0.05, 0.3, 0.05, 0.3)
"""Share of a new residual that enters the estimate in a tick, by state."""

MAX_DISTURBANCE = (3.0, 0.05, 1.5, 0.5, 0.0)
"""Largest disturbance: what is more is a skid, and no wind [unit of the state / s]."""

ACCELERATION_GAIN = 0.3
"""Share of a new difference of speeds that enters the estimated acceleration in a tick."""

ACCELERATION_FADE = 1.0
"""Time constant with which the acceleration is expected to fade [s]."""

INDEX, IN_USE, LAST_SPEED, ACCELERATION, EXPECTS, BEFORE = 0, 1, 3, 4, 5, 6

DISTURBANCE, EXPECTED, STATE_DELTA, SENT = 7, 12, 16, 17
"""What the controller remembers, in a row of numbers: index on the path, node of the table (2,),
speed at the last tick and estimated acceleration, whether a state is expected, the command before
the oldest one that counts, disturbance (5,), expected state (5,), whose last number is the
road-wheel angle, and the commands on their way, the newest last (n + 1,)."""


class Place(NamedTuple):
    """Where a car is on its path."""

    s: float
    """Arc length [m]."""
    e_y: float
    """Cross-track error [m]."""
    e_psi: float
    """Heading error [rad]."""
    mode: int
    """Index in MODES."""


@in_place
def look_ahead(path: Path, s: float, memory: Array, T: float, road: Road) -> None:
    """Fill speeds and mean curvatures of the horizon, from one tick back to H ticks ahead.

    Args:
        path: The reference.
        s: Arc length of the car [m].
        memory: Speed now, and acceleration now; it is expected to fade.
        T: Step [s].
        road: Filled.
    """
    v_x, a_x = memory[LAST_SPEED], memory[ACCELERATION]
    road.speed[0], road.curvature[0] = v_x, curvature_between(path, s - v_x * T, s)
    left, fade = math.exp(-0.5 * T / ACCELERATION_FADE), math.exp(-T / ACCELERATION_FADE)
    for j in range(1, len(road.speed)):
        road.speed[j] = max(v_x + a_x * ACCELERATION_FADE * (1.0 - left), 0.0)
        left *= fade
        road.curvature[j] = curvature_between(path, s, s + road.speed[j] * T)
        s += road.speed[j] * T


@in_place
def locate(path: Path, car: VehicleState, memory: Array) -> Place:
    """Find the car on its path, and say whether it can be steered along it."""
    s, index = advance(path, int(memory[INDEX]), car.x, car.y, car.yaw)
    memory[INDEX] = index
    e_y, e_psi = errors_at(path, s, car.x, car.y, car.yaw)
    mode = TRACKING if path.closed or s <= (len(path.x) - 1) * path.spacing else PATH_END
    if car.v_x < HOLD_BELOW:
        mode = STANDSTILL if car.v_x > REVERSE_BELOW else REVERSE
    elif abs(e_psi) > math.pi / 2:
        mode = WRONG_WAY
    return Place(s, e_y, e_psi, mode)


@in_place
def learn(memory: Array, v_x: float, x: Array, elapsed: float, T: float) -> None:
    """Update disturbance and acceleration by what the last tick should have brought.

    Args:
        memory: Changed in place.
        v_x: Speed [m/s].
        x: State relative to the path (5,).
        elapsed: Since the last step; nan if there was none [s].
        T: Step [s].
    """
    last, memory[LAST_SPEED] = memory[LAST_SPEED], v_x
    if not 0.5 * T < elapsed < 1.5 * T:
        memory[EXPECTS] = 0.0
        return
    memory[ACCELERATION] += ACCELERATION_GAIN * ((v_x - last) / elapsed - memory[ACCELERATION])
    if memory[EXPECTS] == 0.0:
        return
    for i in range(STATES):
        residual = x[i] - memory[EXPECTED + i] if v_x >= LEARN_ABOVE else 0.0
        estimate = memory[DISTURBANCE + i]
        estimate += DISTURBANCE_GAIN[i] * (residual - estimate)
        bound = MAX_DISTURBANCE[i] * T
        memory[DISTURBANCE + i] = min(max(estimate, -bound), bound)


@in_place
def send(memory: Array, steering: float) -> float:
    """Remember a command; gives the change to the one before [rad]."""
    newest = len(memory) - 1
    change, memory[BEFORE] = steering - memory[newest], memory[SENT]
    for i in range(SENT, newest):
        memory[i] = memory[i + 1]
    memory[newest] = steering
    return float(change)


@in_place
def expect(belief: InternalModel, memory: Array, x: Array, road: Road, scratch: Scratch) -> None:
    """Note the state that the model, without disturbance, expects at the next tick."""
    model = blank_model(scratch)
    sample(belief.vehicle, road.speed[0], belief.limits.T, belief.actuator, model, scratch)
    older, old = memory[BEFORE], memory[len(memory) - 1 - belief.actuator.ticks]
    for i in range(STATES):
        expected = model.B_old[i] * older + model.B_new[i] * old + model.D[i] * road.curvature[1]
        for k in range(STATES):
            expected += model.A[i, k] * x[k]
        memory[EXPECTED + i] = expected
    memory[EXPECTS] = 1.0


@in_place
def put_predicted(
    path: Path, s: float, speed: Array, lateral: Array, angles: Array, T: float, out: Array
) -> None:
    """Fill where the car is expected at each step of the horizon, and the angles that bring it.

    Args:
        path: The reference.
        s: Arc length of the car [m].
        speed: (H + 1,) [m/s].
        lateral: Cross-track error expected (H,) [m].
        angles: To command (H,) [rad].
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
    numbers: Array,
    table: Table,
    path: Path,
    state: VehicleState,
    elapsed: float,
    memory: Array,
    scratch: Scratch,
    predicted: Array,
) -> Answer:
    """Answer one state: place on the path, what the last tick taught, gains, road, plan.

    Args:
        numbers: Belief (20,).
        table: Gains.
        path: The reference.
        state: At `base_link`.
        elapsed: Since the last step; nan if there was none [s].
        memory: Of this controller, see `new_memory`; changed in place.
        scratch: At least `scratch_numbers(...)`.
        predicted: Receives points and angles of the horizon (>= H, 3), see `put_predicted`; may
            have no row.
    """
    scratch.used[0] = 0
    belief = believed(numbers)
    T, car, x = belief.limits.T, at_distance(state, belief.to_cg), vector(scratch, STATES)
    place = locate(path, car, memory)
    x[0], x[1], x[2], x[3] = car.v_y, math.sin(place.e_psi), car.yaw_rate, place.e_y
    x[DELTA] = memory[STATE_DELTA]
    learn(memory, car.v_x, x, elapsed, T)
    gains, outside = look_up(table, memory[IN_USE : IN_USE + 2], car.v_x, 0.0)
    steers = place.mode == TRACKING or place.mode == PATH_END
    plan, change = Plan(memory[len(memory) - 1], 0, 0.0, 0, SOLVED), 0.0
    if steers:
        H = gains.prediction_horizon + belief.actuator.ticks
        road = Road(vector(scratch, H + 1), vector(scratch, H + 1))
        lateral, angles = vector(scratch, H), vector(scratch, H)
        look_ahead(path, place.s, memory, T, road)
        past = Past(x, memory[SENT:], memory[DISTURBANCE : DISTURBANCE + STATES])
        plan = preview_plan(belief, gains, past, road, lateral, angles, scratch)
        change = send(memory, plan.steering)
        expect(belief, memory, x, road, scratch)
        if len(predicted) > 0:
            put_predicted(path, place.s, road.speed, lateral, angles, T, predicted)
    else:
        send(memory, plan.steering)
        memory[EXPECTS] = 0.0
    curvature = point_at(path, place.s).curvature
    disturbance = memory[DISTURBANCE : DISTURBANCE + STATES]
    unexplained = side_acceleration(belief.vehicle, car.v_x, T, disturbance, scratch)
    feed_forward = steady_steering(belief.vehicle, car.v_x, curvature)
    road_values = curvature, feed_forward, unexplained
    diagnosis = diagnose(place, road_values, plan, gains, steers, outside)
    return Answer(plan.steering, change / T, diagnosis)


@inlined
def diagnose(
    place: Place,
    road_values: tuple[float, float, float],
    plan: Plan,
    gains: Gains,
    steers: bool,
    outside: bool,
) -> Diagnosis:
    """Say what can be said about a step; gains that steer nothing are nan."""
    known = 1.0 if steers else np.nan
    converged = 1.0 if plan.status == SOLVED else 0.0
    outside_table = 1.0 if steers and outside else 0.0
    return Diagnosis(
        cross_track_error=place.e_y,
        heading_error=place.e_psi,
        curvature=road_values[0],
        feed_forward=road_values[1],
        disturbance=road_values[2],
        mode=float(place.mode),
        active_constraints=float(plan.active),
        slack=plan.slack,
        solver_iterations=float(plan.iterations),
        converged=converged,
        prediction_horizon=known * gains.prediction_horizon,
        control_horizon=known * gains.control_horizon,
        laguerre_terms=known * gains.laguerre_terms,
        laguerre_pole=known * gains.laguerre_pole,
        output_weight=known * gains.output_weight,
        increment_weight=known * gains.increment_weight,
        outside_table=outside_table,
    )


def new_memory(ticks: int) -> Array:
    """Give the memory of a controller that has not stepped yet.

    Args:
        ticks: Whole ticks of delay of its steering.
    """
    memory = np.zeros(SENT + ticks + 1)
    memory[INDEX], memory[IN_USE : IN_USE + 2] = NOT_CAUGHT, NONE
    return memory


@in_place
def preview_answer(
    numbers: Array,
    table: tuple[Any, ...],
    path: tuple[Any, ...],
    state: tuple[Any, ...],
    elapsed: float,
    memory: Array,
    scratch: tuple[Any, ...],
    predicted: Array,
) -> tuple[float, float, tuple[float, ...]]:
    """Call `preview_tick` from Python, with plain tuples; see `paper_answer`."""
    answer = preview_tick(
        numbers,
        Table(*table),
        Path(*path),
        VehicleState(*state),
        elapsed,
        memory,
        Scratch(*scratch),
        predicted,
    )
    return answer.steering, answer.rate, plain(answer.diagnosis)
