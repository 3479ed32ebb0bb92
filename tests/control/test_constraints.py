"""Constraint rows: what they promise about the moves, and where they give way."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.types import Array
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.mpc.constraints import FIRST_OUTPUT_STEP, output_rows, output_steps, row_count
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.mpc.internal_model import limits_of
from ampc_ros.mpc.qp import Qp
from ampc_ros.paper.qp_assembly import StepInput, new_qp
from tests.filled import (
    QpSolution,
    active_set,
    augment,
    laguerre_sequence,
    predict,
    running_sum,
    zero_order_hold,
)

CHASSIS = astuple(load_section(ChassisParameters, find("vehicles", "paper"), "chassis"))
TABLE_3 = Gains(45, 15, 5, 0.75, 10.0, 0.01)
DIGITS = 1e-9
"""Tolerance of the bounds [rad], [m]."""
many = settings(max_examples=100, deadline=None, derandomize=True)
states = st.tuples(
    st.floats(-0.5, 0.5),
    st.floats(-0.1, 0.1),
    st.floats(-0.5, 0.5),
    st.floats(-1.0, 1.0),
    st.floats(-15.0, 15.0),
).map(np.array)


def qp_of(gains: Gains, tick: StepInput, **options: float) -> Qp:
    """Return the QP of one step of the paper's car."""
    return new_qp(CHASSIS, gains, limits_of(ControllerSettings(**options)), tick)  # type: ignore[arg-type]


def moves(gains: Gains, solution: QpSolution) -> Array:
    """Return the increments that a solution plans (N_c,) [rad]."""
    L = laguerre_sequence(gains.laguerre_pole, gains.laguerre_terms, gains.control_horizon)
    return np.asarray(L @ solution.x[: gains.laguerre_terms])


def outputs(gains: Gains, tick: StepInput, solution: QpSolution) -> Array:
    """Return the lateral positions that the model expects of these increments (N_p,) [m]."""
    A, B = augment(*zero_order_hold(CHASSIS, tick.v_x, 0.1))
    L = laguerre_sequence(gains.laguerre_pole, gains.laguerre_terms, gains.control_horizon)
    free, Phi = predict(A, B, L, tick.x, gains.prediction_horizon)
    return np.asarray(free + Phi @ solution.x[: gains.laguerre_terms])


@many
@given(
    x=states,
    v_x=st.floats(0.0, 40.0),
    u=st.floats(-0.6, 0.6),
    r=st.floats(-15.0, 15.0),
    N=st.integers(1, 5),
    alpha=st.floats(0.0, 0.8),
    R=st.floats(1e-2, 1e2),
    increment=st.floats(0.001, 0.5),
    angle=st.floats(0.01, 0.6),
)
def test_increments_and_angles_of_a_solution_keep_their_bounds(
    x: Array,
    v_x: float,
    u: float,
    r: float,
    N: int,
    alpha: float,
    R: float,
    increment: float,
    angle: float,
) -> None:
    gains = Gains(30, 10, N, alpha, 10.0, R)
    tick = StepInput(v_x, x, u, r)
    solution = active_set(qp_of(gains, tick, max_increment=increment, max_angle=angle))
    assert solution.converged
    Delta_u = moves(gains, solution)
    held = min(max(u, -angle), angle)  # an angle outside its bound is taken at the bound
    assert np.abs(Delta_u).max() <= increment + DIGITS
    assert np.abs(held + np.cumsum(Delta_u)).max() <= angle + DIGITS


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
def test_far_set_point_is_approached_at_the_bounds(side: float) -> None:
    tick = StepInput(9.0, np.zeros(5), 0.0, side * 10.0)
    solution = active_set(qp_of(TABLE_3, tick, max_increment=0.02))
    assert moves(TABLE_3, solution)[0] == pytest.approx(side * 0.02, abs=DIGITS)
    assert side * solution.multipliers[0] > 0  # the sign names the active bound


def test_running_sum_turns_increments_into_angles() -> None:
    L = laguerre_sequence(0.75, 5, 15)
    np.testing.assert_allclose(running_sum(L), np.cumsum(L, axis=0), rtol=1e-15)


def test_rows_bound_both_sides_of_increment_and_angle() -> None:
    qp = qp_of(TABLE_3, StepInput(9.0, np.zeros(5), 0.1, 0.0), max_increment=0.2, max_angle=0.5)
    L = laguerre_sequence(0.75, 5, 15)
    angles = np.cumsum(L, axis=0)
    np.testing.assert_allclose(qp.M, np.stack((L, angles), axis=1).reshape(30, 5))
    np.testing.assert_allclose(qp.high, np.tile([0.2, 0.5 - 0.1], 15))
    np.testing.assert_allclose(qp.low, np.tile([-0.2, -0.5 - 0.1], 15))


def test_there_are_no_output_rows_without_a_finite_lane() -> None:
    tick = StepInput(9.0, np.zeros(5), 0.0, 1.0)
    assert qp_of(TABLE_3, tick, max_output_error=math.inf).M.shape == (2 * 15, 5)
    # the fifth to the fifteenth step on either side, and slack >= 0
    assert qp_of(TABLE_3, tick, max_output_error=1.0).M.shape == (2 * 15 + 2 * 11 + 1, 6)
    assert (row_count(15, 0), row_count(15, 11)) == (2 * 15, 2 * 15 + 2 * 11 + 1)


def test_rows_of_an_output_share_the_slack_and_say_nothing_else() -> None:
    rng = np.random.default_rng(0)
    Phi, error = rng.normal(0, 1, (3, 9)), rng.normal(0, 1, 9)
    rows = 2 * 5 + 1
    qp = Qp(np.eye(4), np.zeros(4), np.zeros((2 + rows, 4)), np.zeros(2 + rows), np.ones(2 + rows))
    output_rows(qp, 2, Phi, error, 0.7)
    np.testing.assert_array_equal(qp.M[:2], 0.0)  # rows before are left
    for _ in range(200):
        eta, slack = rng.normal(0, 0.5, 3), rng.normal(0.3, 0.5)
        value = qp.M @ np.append(eta, slack)
        holds = (qp.low[2:] <= value[2:]) & (value[2:] <= qp.high[2:])
        excess = np.abs(error - Phi.T @ eta)[FIRST_OUTPUT_STEP - 1 :] - 0.7
        assert holds.all() == (slack >= max(excess.max(), 0.0))


@pytest.mark.parametrize(
    ("N_p", "N_c", "half_width", "expected"),
    [(45, 15, 1.0, 11), (45, 15, math.inf, 0), (45, 4, 1.0, 0), (3, 15, 1.0, 0), (10, 15, 0.0, 6)],
)
def test_outputs_are_bounded_from_the_fifth_step_to_the_control_horizon(
    N_p: int, N_c: int, half_width: float, expected: int
) -> None:
    assert output_steps(N_p, N_c, half_width) == expected


@many
@given(x=states, v_x=st.floats(1.0, 30.0), half_width=st.floats(0.0, 2.0), r=st.floats(-5, 5))
def test_lane_is_soft_from_anywhere_and_the_slack_is_the_largest_excess(
    x: Array, v_x: float, half_width: float, r: float
) -> None:
    tick = StepInput(v_x, x, 0.0, r)
    solution = active_set(qp_of(TABLE_3, tick, max_output_error=half_width))
    assert solution.converged
    error = np.abs(outputs(TABLE_3, tick, solution) - r)[FIRST_OUTPUT_STEP - 1 : 15]
    slack = solution.x[-1]
    assert slack == pytest.approx(max(error.max() - half_width, 0.0), abs=1e-7)


def test_slack_of_a_car_that_cannot_steer_is_its_distance_from_the_lane() -> None:
    tick = StepInput(9.0, np.array([0.0, 0.0, 0.0, 0.0, 2.5]), 0.0, 0.0)  # parallel, 2.5 m beside
    solution = active_set(qp_of(TABLE_3, tick, max_increment=0.0, max_output_error=1.0))
    assert solution.converged
    assert solution.x[-1] == pytest.approx(1.5, abs=DIGITS)


def test_lane_pulls_a_car_that_would_cut_it_and_costs_the_weight_times_slack_squared() -> None:
    # Two unknowns, by hand: 1/2 2 x^2 + w s^2 with -x - s <= -1 has x = w / (1 + w), s = 1 - x.
    w, none = 3.0, np.zeros(2)
    M, low, high = np.array([[-1.0, -1.0], [0.0, 1.0]]), np.array([-np.inf, 0.0]), [-1.0, np.inf]
    solution = active_set(Qp(2 * np.diag([1.0, w]), none, M, low, np.array(high)))
    np.testing.assert_allclose(solution.x, [0.75, 0.25])
    qp = qp_of(TABLE_3, StepInput(9.0, np.zeros(5), 0.0, 1.0), max_output_error=1.0, slack_weight=w)
    np.testing.assert_array_equal(qp.E[-1], [0, 0, 0, 0, 0, 2 * w])
    np.testing.assert_array_equal(qp.E[:, -1], [0, 0, 0, 0, 0, 2 * w])
    assert qp.K[-1] == 0.0


@pytest.mark.parametrize("weight", [1.0, 1e2, 1e4, 1e6])
def test_heavier_slack_is_smaller(weight: float) -> None:
    tick = StepInput(9.0, np.array([0.0, 0.0, 0.0, 0.0, 1.2]), 0.0, 0.0)
    gains = TABLE_3._replace(increment_weight=1000.0)

    def slack(weight: float) -> float:
        qp = qp_of(gains, tick, max_output_error=0.5, slack_weight=weight)
        return float(active_set(qp).x[-1])

    assert 0.0 < slack(10 * weight) < slack(weight)
