"""Results of one tick that both formulations share: QP result, command and diagnosis."""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import inlined
from ampc_msgs_config.types import Diagnosis
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.mpc.qp import SOLVED

HOLD_BELOW = 0.3
"""Speed below which the steering is held [m/s]."""

REVERSE_BELOW = -0.3
"""Speed below which the car drives backwards, which the controller does not support [m/s].

It lies below zero so that a standing car with measurement noise does not count as reversing.
"""


class QpResult(NamedTuple):
    """Solution of the QP of one tick, reduced to what the tick needs."""

    steering: float
    """Angle to command now [rad]."""
    active: int
    """Number of rows that hold with equality."""
    slack: float
    """Violation of the softened output rows [m]."""
    iterations: int
    """Steps of the active-set method, or sweeps of Hildreth's procedure."""
    status: int
    """SOLVED, INFEASIBLE, UNFINISHED or NOT_CONVEX."""


class TickResult(NamedTuple):
    """Command and diagnosis of one tick."""

    steering: float
    """Angle to command [rad]."""
    rate: float
    """Rate at which this angle is to be reached [rad/s]."""
    diagnosis: Diagnosis


@inlined
def diagnose(
    errors: tuple[float, float],
    road_values: tuple[float, float, float],
    mode: int,
    plan: QpResult,
    gains: Gains,
    steers: bool,
    outside: bool,
) -> Diagnosis:
    """Return the diagnosis of a tick.

    Args:
        errors: Cross-track error [m] and heading error [rad].
        road_values: Curvature [1/m], its steady-state angle [rad], lateral disturbance [m/s^2].
        mode: Index in MODES.
        plan: Solution of the QP.
        gains: Gains of the tick.
        steers: Whether the QP was solved for this tick; otherwise the gains are reported as nan.
        outside: Whether speed or reference lie outside the gain table.
    """
    in_use = 1.0 if steers else math.nan
    # numba accepts no conditional expression in a call with that many keywords
    converged = 1.0 if plan.status == SOLVED else 0.0
    outside_table = 1.0 if steers and outside else 0.0
    return Diagnosis(
        cross_track_error=errors[0],
        heading_error=errors[1],
        curvature=road_values[0],
        feed_forward=road_values[1],
        disturbance=road_values[2],
        mode=float(mode),
        active_constraints=float(plan.active),
        slack=plan.slack,
        solver_iterations=float(plan.iterations),
        converged=converged,
        prediction_horizon=in_use * gains.prediction_horizon,
        control_horizon=in_use * gains.control_horizon,
        laguerre_terms=in_use * gains.laguerre_terms,
        laguerre_pole=in_use * gains.laguerre_pole,
        output_weight=in_use * gains.output_weight,
        increment_weight=in_use * gains.increment_weight,
        outside_table=outside_table,
    )
