"""The paper's controller: its step against the same step written down in numpy."""

import math
from dataclasses import astuple, replace

import daqp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.paths.path_frame import path_frame, place, set_point
from ampc_msgs_config.types import Array, VehicleState
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.configuration import CLASSIC_SPEED, CONTROLLERS, Choices, configuration
from ampc_ros.controller import make_controller
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.paper.tick import STEERING
from ampc_ros.supervision.warm_up import warm_up
from tests.filled import laguerre_sequence, lateral_dynamics

CHASSIS = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
SETTINGS = load(ControllerSettings, find("controllers", "table3"))
ROAD = make_path([(0.0, 0.0), (200.0, 0.0)])
BEND = make_path([(x, 3.0 * math.sin(x / 20.0)) for x in range(0, 200, 2)])
GENTLE = Gains(45, 15, 5, 0.5, 10.0, 50.0)
"""Well conditioned, so that all digits can be compared."""
many = settings(max_examples=60, deadline=None, derandomize=True)
gain_sets = st.builds(
    Gains,
    st.integers(20, 60),
    st.integers(6, 15),
    st.integers(1, 5),
    st.floats(0.0, 0.8),
    st.floats(0.1, 100.0),
    st.floats(0.01, 100.0),
)


def controller(gains: Gains = GENTLE, **options: float | str) -> LateralMpc:
    """Return the controller of the paper's car with one gain set and these settings."""
    table = GainTable([9.0], [0.0], [gains])
    return LateralMpc(CHASSIS, replace(SETTINGS, **options), table)  # type: ignore[arg-type]


def state(tick: int, left: float = 0.0, yaw: float = 0.0, v_x: float = 9.0) -> VehicleState:
    """Return a state of the rear axle on its way along ROAD."""
    return VehicleState(tick * 100_000_000, 0.1 * v_x * tick, left, yaw, v_x, 0.02, 0.01)


def textbook_move(x: Array, r: float, u: float, v_x: float, gains: Gains) -> float:
    """Return the first increment by Eqs. (7)-(17) in dense numpy and a library's solver [rad]."""
    N_p, N_c, N, alpha, Q, R = gains
    A_c, B_c = lateral_dynamics(astuple(CHASSIS), v_x)
    block = np.zeros((5, 5))
    block[:4, :4], block[:4, 4] = A_c, B_c
    discrete = expm(0.1 * block)
    A, B = discrete[:4, :4], discrete[:4, 4]
    A_augmented = np.block([[A, np.zeros((4, 1))], [A[3:], np.ones((1, 1))]])
    B_augmented = np.append(B, B[3])
    powers = [np.linalg.matrix_power(A_augmented, i) for i in range(N_p + 1)]
    F = np.array([power[4] for power in powers[1:]])
    Phi = np.array(
        [
            [powers[i - j][4] @ B_augmented if i >= j else 0.0 for j in range(N_c)]
            for i in range(N_p)
        ]
    )
    L = laguerre_sequence(alpha, N, N_c)
    E = 2 * L.T @ (Q * Phi.T @ Phi + R * np.eye(N_c)) @ L
    K = -2 * Q * L.T @ Phi.T @ (r - F @ x)
    M = np.vstack((L, np.cumsum(L, axis=0)))
    step, angle = np.full(N_c, SETTINGS.max_increment), np.full(N_c, SETTINGS.max_angle)
    upper, lower = np.append(step, angle - u), np.append(-step, -angle - u)
    eta, _, flag, _ = daqp.solve(E, K, np.ascontiguousarray(M), upper, lower)
    assert flag == 1
    return float(L[0] @ eta)


@pytest.mark.parametrize("left", [0.3, -0.3, 6.0, -6.0])
def test_commands_are_those_of_a_textbook_implementation(left: float) -> None:
    mpc, u, before = controller(), 0.0, None
    rng = np.random.default_rng(0)
    for tick in range(30):
        noise = rng.normal(0, 0.05, 2)
        rear = state(tick, left + noise[0], 0.2 * noise[1], v_x=9.0 + 0.1 * tick)
        car = at_distance(rear, CHASSIS.cg_to_rear_axle)
        x = np.array([car.v_y, car.yaw, car.yaw_rate, car.y])
        augmented = np.append(x - (x if before is None else before), car.y)
        u, before = u + textbook_move(augmented, 0.0, u, car.v_x, GENTLE), x
        assert mpc.step(rear, ROAD).steering == pytest.approx(u, abs=1e-7)


def test_car_that_spins_through_the_opposite_heading_has_turned_by_a_little() -> None:
    mpc = controller()
    rears = [state(tick, 0.3, yaw) for tick, yaw in enumerate((math.pi - 0.01, 0.01 - math.pi))]
    u = mpc.step(rears[0], ROAD).steering
    one, other = (at_distance(rear, CHASSIS.cg_to_rear_axle) for rear in rears)
    x = np.array([0.0, 0.02, 0.0, other.y - one.y, other.y])
    expected = u + textbook_move(x, 0.0, u, 9.0, GENTLE)
    assert mpc.step(rears[1], ROAD).steering == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("name", ["paper", "classic"])
def test_car_on_its_set_point_is_not_steered(name: str) -> None:
    mpc = make_controller(Choices(name))
    for tick in range(20):
        on_road = state(tick)._replace(v_y=0.0, yaw_rate=0.0)
        assert mpc.step(on_road, ROAD).steering == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("left", [0.2, 5.0])
def test_car_to_the_left_is_steered_to_the_right_and_the_other_way_round(left: float) -> None:
    commands = [controller().step(state(0, side * left), ROAD).steering for side in (1, -1)]
    assert commands[0] < 0.0 < commands[1]


@many
@given(
    gains=gain_sets,
    seed=st.integers(0, 2**32 - 1),
    increment=st.floats(0.001, 0.3),
    angle=st.floats(0.01, 0.6),
)
def test_commands_keep_their_bounds_for_any_gains_and_states(
    gains: Gains, seed: int, increment: float, angle: float
) -> None:
    mpc = controller(gains, max_increment=increment, max_angle=angle)
    rng, before = np.random.default_rng(seed), 0.0
    for tick in range(10):
        x, y, yaw, v_x, v_y, yaw_rate = rng.normal(0, 1, 6) * (30, 5, 1, 20, 1, 1)
        rear = VehicleState(tick * 100_000_000, x, y, yaw, abs(v_x), v_y, yaw_rate)
        command = mpc.step(rear, BEND)
        assert command.diagnosis.converged
        assert abs(command.steering) <= angle
        assert abs(command.steering - before) <= increment + 1e-15
        assert command.steering_rate == pytest.approx((command.steering - before) / 0.1)
        before = command.steering


@many
@given(gains=gain_sets, seed=st.integers(0, 2**32 - 1))
def test_standing_car_gets_finite_commands(gains: Gains, seed: int) -> None:
    mpc, rng = controller(gains), np.random.default_rng(seed)
    rear = VehicleState(0, 10.0, rng.normal(), rng.normal(), 0.0, 0.0, 0.0)
    for _ in range(5):
        assert math.isfinite(mpc.step(rear, BEND).steering)


def test_plan_continues_from_the_angle_in_force_and_begins_with_the_command() -> None:
    mpc = controller()
    mpc.memory[STEERING] = 0.12
    command = mpc.step(state(0, left=-1.0), ROAD)
    assert command.angles is not None
    assert len(command.angles) == GENTLE.control_horizon
    assert command.angles[0] == pytest.approx(command.steering, abs=1e-12)
    increments = np.diff(command.angles, prepend=0.12)
    assert np.abs(increments).max() <= SETTINGS.max_increment + 1e-9
    assert np.abs(increments).max() > 1e-3


def test_conditioning_is_checked_at_the_highest_speed_too() -> None:
    singular_at_27 = Gains(45, 15, 7, 0.75, 10.0, 0.01)  # cond(E) = 7e10 at 3 m/s
    with pytest.raises(ValueError, match=r"laguerre_terms = 7 .*cond\(E\) = 6.0e\+12 at 27 m/s"):
        controller(singular_at_27)


def test_angle_is_held_and_reported_where_the_solver_did_not_finish() -> None:
    mpc = controller(load_gain_table("table3").nodes[0], solver="hildreth", hildreth_sweeps=1.0)
    mpc.memory[STEERING] = 0.1
    command = mpc.step(state(0, left=8.0), ROAD)
    assert not command.diagnosis.converged
    assert (command.steering, command.steering_rate) == (0.1, 0.0)


def test_hildreth_with_enough_sweeps_commands_what_the_exact_solver_does() -> None:
    exact, own = controller(), controller(solver="hildreth", hildreth_sweeps=1e5)
    for tick in range(20):
        rear = state(tick, left=6.0 - 0.2 * tick)
        command = own.step(rear, ROAD)
        assert command.diagnosis.converged
        assert command.steering == pytest.approx(exact.step(rear, ROAD).steering, abs=1e-6)


def test_both_conventions_of_base_link_command_the_same() -> None:
    table = GainTable([9.0], [0.0], [GENTLE])
    at_axle = LateralMpc(CHASSIS, SETTINGS, table)
    at_cg = LateralMpc(CHASSIS, SETTINGS, table, base_link_to_cg=0.0)
    for tick in range(20):
        rear = state(tick, left=0.5, yaw=0.05)
        cg = at_distance(rear, CHASSIS.cg_to_rear_axle)
        assert at_axle.step(rear, BEND).steering == at_cg.step(cg, BEND).steering


def test_classic_controller_is_the_adaptive_one_with_its_model_at_one_speed() -> None:
    adaptive, fixed = controller(), controller(nominal_speed=9.0)
    at_nine, faster = state(1, left=0.4), state(2, left=0.4, v_x=20.0)
    assert fixed.step(at_nine, ROAD).steering == adaptive.step(at_nine, ROAD).steering
    assert fixed.step(faster, ROAD).steering != adaptive.step(faster, ROAD).steering
    classic = make_controller(Choices("classic"))
    assert isinstance(classic, LateralMpc)
    assert classic.model.nominal_speed == CLASSIC_SPEED


def test_new_path_keeps_the_angle_and_forgets_the_last_increment() -> None:
    mpc, fresh = controller(), controller()
    for tick in range(5):
        mpc.step(state(tick, left=0.1), ROAD)
    fresh.memory[STEERING] = mpc.steering
    elsewhere = make_path([(0.0, -0.1), (200.0, -0.1)])
    expected = fresh.step(state(5, left=0.1), elsewhere).steering
    assert mpc.step(state(5, left=0.1), elsewhere).steering == expected
    assert abs(mpc.steering) < SETTINGS.max_angle  # no bound hides the difference


def test_reset_controller_is_as_a_new_one() -> None:
    mpc = controller()
    for tick in range(5):
        mpc.step(state(tick, left=1.0), BEND)
    mpc.reset()
    fresh = controller()
    for tick in range(5):
        rear = state(tick, left=-0.5)
        assert mpc.step(rear, BEND).steering == fresh.step(rear, BEND).steering


def test_diagnosis_contains_errors_gains_rows_and_table() -> None:
    table = GainTable([9.0, 10.0], [0.0], [GENTLE, GENTLE])
    mpc = LateralMpc(CHASSIS, replace(SETTINGS, max_output_error=0.5), table)
    far = VehicleState(7, 10.0, 4.0, 0.1, 20.0, 0.0, 0.0)
    command = mpc.step(far, ROAD)
    diagnosis = command.diagnosis
    assert command.stamp_ns == 7
    assert diagnosis.cross_track_error == pytest.approx(4.0 + 1.6 * math.sin(0.1))
    assert diagnosis.heading_error == pytest.approx(0.1)
    assert diagnosis.slack > 0.0
    assert diagnosis.active_constraints >= 1
    assert diagnosis.solver_iterations >= 1
    assert diagnosis.outside_table
    for name, value in GENTLE._asdict().items():
        assert getattr(diagnosis, name) == pytest.approx(value)


@pytest.mark.parametrize(("v_x", "x"), [(5.0, 10.0), (12.0, 10.0), (9.0, 75.0)])
def test_gains_are_those_of_the_speed_and_the_set_point(v_x: float, x: float) -> None:
    nodes = [GENTLE._replace(increment_weight=R) for R in (10.0, 20.0, 40.0, 80.0)]
    axes = [5.0, 15.0], [-3.0, 3.0]
    mpc = LateralMpc(CHASSIS, SETTINGS, GainTable(*axes, nodes), base_link_to_cg=0.0)
    car = VehicleState(0, x, 0.0, 0.0, v_x, 0.0, 0.0)
    frame = path_frame(BEND)
    r = set_point(frame, place(frame, car.x, car.y, car.yaw)[0])
    expected = GainTable(*axes, nodes).lookup(v_x, r).gains
    assert mpc.step(car, BEND).diagnosis.increment_weight == expected.increment_weight


def test_path_against_its_chord_is_refused_and_the_old_one_goes_on() -> None:
    mpc = controller()
    mpc.step(state(0), ROAD)
    circle = make_path([(20 * math.sin(a / 10), 20 - 20 * math.cos(a / 10)) for a in range(45)])
    with pytest.raises(ValueError, match=r"reference_path: turns by \d+ degrees"):
        mpc.step(state(1), circle)
    assert math.isfinite(mpc.step(state(1), ROAD).steering)


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("vehicle", ["paper", "ordinary"])
def test_every_controller_warms_up_and_starts_afresh(name: str, vehicle: str) -> None:
    first = state(0, left=0.3)
    one = make_controller(Choices(name, vehicle))
    warm_up(configuration(Choices(name, vehicle)))
    assert one.steering == 0.0
    other = make_controller(Choices(name, vehicle))
    assert one.step(first, ROAD).steering == other.step(first, ROAD).steering


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        (Choices("pid"), "controller = 'pid' must be one of preview, paper, classic, pure_pursuit"),
        (Choices(vehicle="tank"), "'tank' is neither a file nor one of the shipped vehicles"),
        (Choices(settings="none"), "'none' is neither a file nor one of the shipped controllers"),
        (Choices(gain_table="none"), "'none' is neither a file nor one of the shipped gains"),
    ],
)
def test_wrong_choice_is_rejected_by_name(choices: Choices, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_controller(choices)
