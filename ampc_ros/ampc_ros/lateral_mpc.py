"""The paper's controller: adaptive MPC with Laguerre increments towards a held set-point."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.path import NOT_CAUGHT, Path, advance, errors_at
from ampc_msgs_config.path_frame import PathFrame, path_frame, place, set_point
from ampc_msgs_config.types import (
    TRACKING,
    Command,
    Diagnosis,
    VehicleState,
    at_distance,
    wrap_angle,
)
from ampc_ros.belief import Belief, Limits, belief_row, believed
from ampc_ros.constraints import input_rows, output_rows, output_steps, row_count, running_sum
from ampc_ros.gain_table import NONE, Gains, GainTable, Table, look_up
from ampc_ros.hildreth import hildreth, hildreth_numbers
from ampc_ros.laguerre import laguerre_sequence
from ampc_ros.model import STATES, Vehicle, augment, zero_order_hold
from ampc_ros.prediction import predict, quadratic_cost
from ampc_ros.qp import SOLVED, Qp, active_set, solver_numbers
from ampc_ros.small_matrices import Scratch, dot, make_scratch, matrix, vector

Array = NDArray[np.float64]

MAX_CONDITION = 1e12
"""Condition number of E above which a gain set is refused: the solver would lose its digits."""
STEERING, KNOWN, LAST, INDEX, IN_USE, MEMORY = 0, 1, 2, 6, 7, 9
"""What the controller remembers, in a row of MEMORY numbers: angle in force, whether there was a
step before, its state (4,), index on the path, node of the table (2,)."""


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


class Answer(NamedTuple):
    """Of a tick."""

    steering: float
    """Angle to command [rad]."""
    rate: float
    """[rad/s]."""
    diagnosis: Diagnosis


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
def plan(vehicle: Vehicle, gains: Gains, limits: Limits, tick: Tick, scratch: Scratch) -> Move:
    """Pose and solve the programme of one step, and read the first move off its solution."""
    N_p, N_c, N, _, _, _ = gains
    qp = blank_programme(gains, output_steps(N_p, N_c, limits.half_width), scratch)
    pose(vehicle, gains, limits, tick, qp, scratch)
    eta, multipliers = vector(scratch, len(qp.K)), vector(scratch, len(qp.low))
    iterations, status = solve(qp, limits, eta, multipliers, scratch)
    Delta_u = dot(qp.M[0][:N], eta[:N])  # the first row is L(0)'
    bounded = min(max(Delta_u, -limits.Delta_u_max), limits.Delta_u_max)
    slack = eta[N] if len(eta) > N else 0.0
    return Move(bounded, count_active(multipliers), slack, iterations, status)


@inlined
def augmented_state(memory: Array, x: tuple[float, float, float, float], out: Array) -> None:
    """Fill x~ = [Delta x, y] of Eq. (9), (5,); no increment is known at the first step."""
    for i in range(4):
        out[i] = x[i] - memory[LAST + i] if memory[KNOWN] > 0.0 else 0.0
        memory[LAST + i] = x[i]
    out[1] = wrap_angle(out[1])
    out[4] = x[3]
    memory[KNOWN] = 1.0


@in_place
def paper_tick(
    numbers: Array,
    table: Table,
    path: Path,
    frame: PathFrame,
    state: VehicleState,
    memory: Array,
    scratch: Scratch,
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
    move = plan(belief.vehicle, gains, limits, Tick(v_x, x, memory[STEERING], r), scratch)
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


class LateralMpc:
    """Adaptive MPC of the paper; with a nominal speed set, the classic MPC it is compared with."""

    def __init__(
        self,
        chassis: ChassisParameters,
        settings: ControllerSettings,
        table: GainTable,
        base_link_to_cg: float | None = None,
    ) -> None:
        """Make a controller at rest.

        Args:
            chassis: The car as the controller believes it to be.
            settings: Limits and solver.
            table: Gains by speed and lateral reference.
            base_link_to_cg: From the point that `odom` describes forward to the centre of gravity
                [m]; by default `odom` describes the rear axle.

        Raises:
            ValueError: A gain set makes the problem numerically singular.
        """
        self.numbers = belief_row(chassis, settings, None, base_link_to_cg)
        self.belief: Belief = believed(self.numbers)
        self.period = settings.sample_time
        self.table = table.table
        for gains in table.nodes:
            check_conditioning(self.belief.vehicle, gains, self.belief.limits)
        self.scratch = make_scratch(max(scratch_numbers(*gains[:3]) for gains in table.nodes))
        self.reset()

    def reset(self) -> None:
        """Forget all earlier steps: no angle commanded, no increment known, no path."""
        self.memory: Array = new_memory()
        self.path: Path | None = None

    @property
    def steering(self) -> float:
        """Angle commanded last [rad]."""
        return float(self.memory[STEERING])

    def step(self, state: VehicleState, path: Path) -> Command:
        """Answer one state; see `paper_tick`.

        Args:
            state: At `base_link`.
            path: The reference; another object is taken as another path.

        Raises:
            ValueError: The path is no graph over its chord.
        """
        if path is not self.path:
            self._take_path(path)
        answer = paper_tick(
            self.numbers, self.table, path, self.frame, state, self.memory, self.scratch
        )
        return Command(state.stamp_ns, *answer)

    def _take_path(self, path: Path) -> None:
        """Follow a new path: new inertial frame, increments start anew, the angle is kept."""
        self.frame, self.path = path_frame(path), path
        self.memory[KNOWN], self.memory[INDEX] = 0.0, NOT_CAUGHT


def new_memory() -> Array:
    """Give the memory (MEMORY,) of a controller that has not stepped yet."""
    memory = np.zeros(MEMORY)
    memory[INDEX], memory[IN_USE:] = NOT_CAUGHT, NONE
    return memory


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
