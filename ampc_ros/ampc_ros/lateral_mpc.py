"""The paper's controller: adaptive MPC with Laguerre increments towards a held set-point."""

from dataclasses import astuple
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings, SteeringParameters
from ampc_msgs_config.path import Path, Progress
from ampc_msgs_config.path_frame import path_frame, place, set_point
from ampc_msgs_config.types import Command, Diagnosis, VehicleState, at_distance, wrap_angle
from ampc_ros.constraints import input_rows, output_rows, output_steps, with_slack
from ampc_ros.gain_table import Gains, GainTable
from ampc_ros.hildreth import hildreth
from ampc_ros.laguerre import laguerre_sequence, network
from ampc_ros.model import Vehicle, augment, lateral_dynamics, zero_order_hold
from ampc_ros.prediction import predict, quadratic_cost
from ampc_ros.qp import Qp, QpSolution, active_set
from ampc_ros.small_matrices import apply, dot

Array = NDArray[np.float64]

GRAVITY = 9.81
"""[m/s^2]"""
MAX_CONDITION = 1e12
"""Condition number of E above which a gain set is refused: the solver would lose its digits."""


class Limits(NamedTuple):
    """Bounds and solver of one step, for compiled code."""

    T: float
    Delta_u_max: float
    u_max: float
    half_width: float
    slack_weight: float
    exact: bool
    sweeps: int
    tolerance: float
    mu_g: float


class Tick(NamedTuple):
    """What one step knows: speed of the model, augmented state (5,), angle in force, set-point."""

    v_x: float
    x: Array
    u: float
    r: float


@compiled
def problem(vehicle: Vehicle, gains: Gains, limits: Limits, tick: Tick) -> Qp:
    """Pose the quadratic programme of Eq. (17) in eta, and the slack if outputs are bounded."""
    N_p, N_c, N, alpha, Q, R = gains
    A_k, B_k = zero_order_hold(*lateral_dynamics(vehicle, tick.v_x), limits.T)
    A, B = augment(A_k, B_k)
    L = laguerre_sequence(alpha, N, N_c)
    F, Phi = predict(A, B, L, N_p)
    error = apply(F, tick.x)
    for i in range(N_p):
        error[i] = tick.r - error[i]
    E, K = quadratic_cost(Phi, error, L, Q, R)
    h, s = 4 * N_c, output_steps(N_p, N_c, limits.half_width)
    if s > 0:
        E, K = with_slack(E, K, limits.slack_weight)
    m = h + 2 * s + 1 if s > 0 else h
    M, gamma = np.zeros((m, len(K))), np.zeros(m)
    input_rows(M, gamma, L, tick.u, (limits.Delta_u_max, limits.u_max))
    if s > 0:
        output_rows(M[h:], gamma[h:], Phi, error, limits.half_width)
    return Qp(E, K, M, gamma)


@compiled
def solve(qp: Qp, limits: Limits) -> QpSolution:
    """Solve with the solver that the settings name."""
    if limits.exact:
        return active_set(qp)
    return hildreth(qp, limits.sweeps, limits.tolerance)


@compiled
def plan(
    vehicle: Vehicle, gains: Gains, limits: Limits, tick: Tick
) -> tuple[float, int, float, QpSolution]:
    """First move of one step.

    Returns:
        L(0)' eta clipped to its bound [rad], the number of active rows, the slack [m], and the
        solution they come from.
    """
    solution = solve(problem(vehicle, gains, limits, tick), limits)
    N = gains.laguerre_terms
    _, L_0 = network(gains.laguerre_pole, N)
    Delta_u = dot(L_0, solution.x[:N])
    slack = solution.x[N] if len(solution.x) > N else 0.0
    bounded = min(max(Delta_u, -limits.Delta_u_max), limits.Delta_u_max)
    active = 0
    for multiplier in solution.multipliers:
        active += multiplier > 0.0
    return bounded, active, slack, solution


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
        self.vehicle: Vehicle = astuple(chassis)
        self.to_cg = chassis.cg_to_rear_axle if base_link_to_cg is None else base_link_to_cg
        self.nominal_speed, self.period = settings.nominal_speed, settings.sample_time
        self.limits = limits_of(settings)
        self.table = table
        for gains in table.nodes:
            check_conditioning(self.vehicle, gains, self.limits)
        self.reset()

    def reset(self) -> None:
        """Forget all earlier steps: no angle commanded, no increment known, no path."""
        self.steering = 0.0
        self.last: Array | None = None
        self.path: Path | None = None
        self.table.reset()

    def step(self, state: VehicleState, path: Path) -> Command:
        """Answer one state: set-point, gains, model, prediction, bounds, QP, first move.

        Args:
            state: At `base_link`.
            path: The reference; another object is taken as another path.

        Raises:
            ValueError: The path is no graph over its chord.
        """
        if path is not self.path:
            self._take_path(path)
        car = at_distance(state, self.to_cg)
        X, Y, yaw = place(self.frame, car.x, car.y, car.yaw)
        r = set_point(self.frame, X)
        gains, outside = self.table.lookup(car.v_x, r)
        x = self._augmented_state(np.array([car.v_y, yaw, car.yaw_rate, Y]))
        v_x = self.nominal_speed or car.v_x
        tick = Tick(v_x, x, self.steering, r)
        Delta_u, active, slack, solution = plan(self.vehicle, gains, self.limits, tick)
        rate = self._steer(Delta_u if solution.converged else 0.0)
        e_y, e_psi = self.progress.errors(car)
        diagnosis = Diagnosis(
            cross_track_error=e_y,
            heading_error=e_psi,
            active_constraints=active,
            slack=slack,
            solver_iterations=solution.iterations,
            converged=solution.converged,
            outside_table=outside,
            **gains._asdict(),
        )
        return Command(car.stamp_ns, self.steering, rate, diagnosis)

    def _take_path(self, path: Path) -> None:
        """Follow a new path: new inertial frame, increments start anew, the angle is kept."""
        self.frame, self.progress = path_frame(path), Progress(path)
        self.path, self.last = path, None

    def _augmented_state(self, x: Array) -> Array:
        """x~ = [Delta x, y] of Eq. (9); no increment is known at the first step."""
        Delta_x = x - (x if self.last is None else self.last)
        Delta_x[1] = wrap_angle(Delta_x[1])
        self.last = x
        return np.append(Delta_x, x[3])

    def _steer(self, Delta_u: float) -> float:
        """Move the commanded angle by an increment, within its bound; gives the rate [rad/s]."""
        before, bound = self.steering, self.limits.u_max
        self.steering = min(max(before + Delta_u, -bound), bound)
        return (self.steering - before) / self.limits.T


def limits_of(settings: ControllerSettings, steering: SteeringParameters | None = None) -> Limits:
    """Give the settings as compiled code takes them, within what the steering can do."""
    step, angle = settings.max_increment, settings.max_angle
    if steering is not None:
        step = min(step, steering.max_rate * settings.sample_time)
        angle = min(angle, steering.max_angle)
    return Limits(
        settings.sample_time,
        step,
        angle,
        settings.max_output_error,
        settings.slack_weight,
        settings.solver == "active_set",
        int(settings.hildreth_sweeps),
        settings.hildreth_tolerance,
        settings.friction * GRAVITY,
    )


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
