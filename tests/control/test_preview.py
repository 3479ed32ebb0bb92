"""The preview controller in closed loop: how well, how robustly, and what must not matter."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.paths.path import Path, Progress
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import SpeedProfile, load_scenario
from ampc_msgs_config.scenarios.wind import Wind
from ampc_msgs_config.types import (
    NANOSECONDS,
    PATH_END,
    REVERSE,
    STANDSTILL,
    TRACKING,
    WRONG_WAY,
    Array,
    Plan,
    VehicleState,
)
from ampc_ros.mpc.gain_table import load_gain_table
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.certifying.linear_loop import delay_margin, spectral_radius
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import MeasurementNoise, Vehicle, load_vehicle_file
from tests.workshop.acceptance.cases import Case, all_cases
from tests.workshop.acceptance.loop_margins import LOOP_RADIUS, LOOP_SPEEDS
from tests.workshop.acceptance.trials import Trial, overlap, run

CAR = load_vehicle_file(find("vehicles", "paper"))
ORDINARY = load_vehicle_file(find("vehicles", "ordinary"))
TO_CG = CAR.chassis.cg_to_rear_axle
STRAIGHT = make_path([(0.0, 0.0), (1000.0, 0.0)])
NOISE = load(MeasurementNoise, find("noise", "x1"))
FAST = ("scenarios", "actuator", "noise", "iso3888")
"""Groups of the result table that are driven here; the whole table takes a minute."""
SLOW = ("iso3888_1", "iso3888_2")
"""Searches for the highest speed."""


def preview(base_link_to_cg: float | None = None) -> PreviewMpc:
    """Return the shipped controller for the paper's car."""
    limits = load(ControllerSettings, find("controllers", "table3"))
    table = load_gain_table("preview")
    return PreviewMpc(CAR.chassis, CAR.steering, limits, table, base_link_to_cg)


def state_at(x: float, y: float, yaw: float = 0.0, v_x: float = 9.0, k: int = 0) -> VehicleState:
    """Return a car that rolls without sliding, at tick k."""
    return VehicleState(k * NANOSECONDS // 10, x, y, yaw, v_x, 0.0, 0.0)


@cache
def sc1() -> tuple[Drive, Path]:
    """Return the drive of sc1 that others are compared with, with noise to excite everything."""
    scenario = load_scenario("sc1", CAR.size)
    simulation = Simulation(CAR, scenario, noise=NOISE, rng=np.random.default_rng(3))
    return drive(simulation, preview()), make_path(scenario.points)


def open_loop_steering(controller: PreviewMpc, states: list[VehicleState], path: Path) -> Array:
    """Return the steering for recorded states, open loop [rad]."""
    return np.array([controller.step(state, path).steering for state in states])


CASES = [case for case in all_cases() if case.group in FAST and case.name not in SLOW]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_result_table_holds(case: Case) -> None:
    measured = case.measure("preview")
    for bar in case.thresholds:
        assert bar.holds(measured[bar.quantity]), bar


@pytest.mark.parametrize("v", [5.0, 15.0, 27.0])
@pytest.mark.parametrize("friction", [0.3, 0.9])
def test_a_car_that_joins_from_three_metres_settles(v: float, friction: float) -> None:
    error = run(Trial("straight", speed=v, offset=3.0, friction=friction), "preview").error
    assert np.abs(error[-30:]).max() < 0.01


@pytest.mark.parametrize("trial", [
    Trial("sc1_falcone", "independent", speed=11.0),
    Trial("straight", "independent", speed=15.0, offset=3.0),
], ids=["lane change", "joining"])  # fmt: skip
def test_the_same_gains_drive_an_independent_plant(trial: Trial) -> None:
    pytest.importorskip("vehiclemodels")
    error = run(trial, "preview").error
    assert np.abs(error[-30:]).max() < 0.01
    assert np.abs(error).max() <= trial.offset + 0.08


def test_the_outline_of_the_car_is_seen_between_the_cones() -> None:
    driven = run(Trial("iso3888_1", "ordinary"), "preview")
    narrow = [lane._replace(left=lane.left - 0.2) for lane in driven.scenario.lanes]
    assert overlap(driven) < 0
    assert overlap(driven._replace(scenario=driven.scenario._replace(lanes=tuple(narrow)))) > 0


def test_mirrored_driving_is_steered_mirrored() -> None:
    recorded, path = sc1()
    mirrored = [
        s._replace(y=-s.y, yaw=-s.yaw, v_y=-s.v_y, yaw_rate=-s.yaw_rate) for s in recorded.states
    ]
    flipped = make_path(np.column_stack((path.x, -path.y)))
    straight = make_path(np.column_stack((path.x, path.y)))
    expected = open_loop_steering(preview(), recorded.states, straight)
    np.testing.assert_allclose(
        open_loop_steering(preview(), mirrored, flipped), -expected, atol=1e-6
    )


@given(st.floats(-math.pi, math.pi), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
@settings(max_examples=8, deadline=None)
def test_rotation_and_translation_do_not_matter(angle: float, dx: float, dy: float) -> None:
    recorded, _ = sc1()
    points = load_scenario("sc1", CAR.size).points
    cos, sin = math.cos(angle), math.sin(angle)

    def moved(x: Array, y: Array) -> tuple[Array, Array]:
        return dx + cos * x - sin * y, dy + sin * x + cos * y

    states = []
    for s in recorded.states:
        x, y = moved(np.array(s.x), np.array(s.y))
        yaw = math.remainder(s.yaw + angle, math.tau)
        states.append(s._replace(x=float(x), y=float(y), yaw=yaw))
    path = make_path(np.column_stack(moved(*points.T)))
    np.testing.assert_allclose(
        open_loop_steering(preview(), states, path), recorded.steering, atol=1e-6
    )


def test_a_shift_in_time_does_not_matter() -> None:
    recorded, path = sc1()
    later = [s._replace(stamp_ns=s.stamp_ns + 10**18) for s in recorded.states]
    np.testing.assert_array_equal(open_loop_steering(preview(), later, path), recorded.steering)


def test_both_conventions_of_base_link_give_the_same_driving() -> None:
    recorded, path = sc1()
    centred = [at_distance(s, TO_CG) for s in recorded.states]
    steering = open_loop_steering(preview(base_link_to_cg=0.0), centred, path)
    np.testing.assert_allclose(steering, recorded.steering, atol=1e-9)


@pytest.mark.parametrize("spacing", [0.1, 0.7, 1.3])
def test_a_replan_with_the_same_geometry_causes_no_jump(spacing: float) -> None:
    recorded, path = sc1()
    x = np.arange(0.0, path.x[-1], spacing)
    replanned = make_path(np.column_stack((x, np.interp(x, path.x, path.y))))
    controller, half = preview(), len(recorded.states) // 4
    open_loop_steering(controller, recorded.states[:half], path)
    steering = open_loop_steering(controller, recorded.states[half : half + 20], replanned)
    jump = np.abs(steering - recorded.steering[half : half + 20])
    assert np.degrees(jump[0]) < 0.2
    assert np.degrees(jump.max()) < 0.2


def test_after_a_noisy_stop_the_car_goes_on_without_a_swing() -> None:
    at, speed = np.array([0.0, 4.0, 8.0, 12.0, 18.0]), np.array([9.0, 9.0, 0.0, 0.0, 9.0])
    profile = SpeedProfile(False, at, speed)
    scenario = load_scenario("straight", CAR.size)._replace(
        speed=profile, duration=25.0, start_offset=0.0
    )
    simulation = Simulation(CAR, scenario, noise=NOISE, rng=np.random.default_rng(5))
    finished = drive(simulation, preview())
    speeds = np.array([s.v_x for s in finished.states])
    stopped = slice(int(np.argmax(speeds < 0.1)) + 3, 118)
    assert np.ptp(np.degrees(finished.steering[stopped])) < 0.5
    assert np.abs(np.degrees(finished.steering)).max() < 12.0
    assert max(abs(s.y) for s in finished.states) < 0.3


@pytest.mark.parametrize("step", [9.0, -4.0, 4.0])
def test_a_step_of_the_measured_speed_does_not_steer_into_a_bend_that_is_far_ahead(
    step: float,
) -> None:
    path = make_path(load_scenario("sc1", CAR.size).points)  # the lane change begins at 30 m
    before, after = (0.0, 9.0) if step == 9.0 else (6.0, 6.0 + step)
    states, x = [], 0.0
    for k in range(12):
        v = before if k < 4 else after
        states.append(state_at(x, 0.0, v_x=v, k=k))
        x += 0.1 * v
    assert x < 12.0
    stepped = open_loop_steering(preview(), states, path)
    assert np.abs(stepped).max() < math.radians(0.2)


def test_beyond_the_end_of_the_path_the_car_goes_straight_on() -> None:
    path = make_path([(0.0, 0.0), (50.0, 0.0)])
    scenario = load_scenario("straight", CAR.size, 9.0)
    controller, simulation = preview(), Simulation(CAR, scenario)
    states = []
    for tick in range(150):
        states.append(simulation.car.measure(tick * NANOSECONDS // 10))
        plan = controller.step(states[-1], path)
        simulation.advance(plan.steering, 9.0, NANOSECONDS // 10)
    assert states[-1].x > 100.0
    assert abs(states[-1].y) < 0.01
    assert plan.diagnosis.mode == PATH_END


def test_the_planner_stands_at_the_end_of_an_open_path() -> None:
    scenario = load_scenario("straight", CAR.size, 9.0)._replace(
        points=np.array([(0.0, 0.0), (50.0, 0.0)])
    )
    last = drive(Simulation(CAR, scenario), preview()).states[-1]
    assert last.v_x == pytest.approx(0.0, abs=0.01)
    assert 47.0 < last.x < 50.0


@pytest.mark.parametrize(
    ("state", "mode"),
    [
        (state_at(10.0, 0.1), TRACKING),
        (state_at(10.0, 0.1, v_x=0.0), STANDSTILL),
        (state_at(10.0, 0.1, v_x=-2.0), REVERSE),
        (state_at(10.0, 0.1, yaw=math.pi), WRONG_WAY),
        (state_at(10.0, 0.1, yaw=-2.0), WRONG_WAY),
    ],
)
def test_the_angle_is_held_in_every_mode_but_tracking(state: VehicleState, mode: int) -> None:
    controller = preview()
    held = controller.step(state_at(9.5, 0.5), STRAIGHT).steering
    command = controller.step(state._replace(stamp_ns=NANOSECONDS // 10), STRAIGHT)
    assert command.diagnosis.mode == mode
    assert (command.steering == held) is (mode != TRACKING)


def test_a_standing_car_with_noise_never_counts_as_reversing() -> None:
    controller, rng = preview(), np.random.default_rng(1)
    speeds = NOISE.speed * rng.standard_normal(200)
    modes = {
        controller.step(state_at(10.0, 0.0, v_x=v, k=k), STRAIGHT).diagnosis.mode
        for k, v in enumerate(speeds)
    }
    assert modes == {STANDSTILL}


def test_a_figure_eight_is_driven_for_two_laps() -> None:
    t = np.arange(0.0, math.tau, 0.02)
    points = 60.0 * np.column_stack((np.sin(t), np.sin(2 * t) / 2))
    path = make_path(points)
    scenario = load_scenario("straight", CAR.size, 6.0)._replace(
        points=points, start_offset=0.0, duration=2 * path.length / 6.0
    )
    finished = drive(Simulation(CAR, scenario), preview())
    progress = Progress(path)
    error = [progress.errors(at_distance(s, TO_CG))[0] for s in finished.states]
    assert np.abs(error).max() < 0.1
    last = at_distance(finished.states[-1], TO_CG)
    assert progress.advance(last.x, last.y) > 1.95 * path.length


def test_side_wind_leaves_no_error_and_is_estimated() -> None:
    wind = (Wind(kind="block", start=0.0, end=100.0, speed=15.0),)
    scenario = load_scenario("straight", CAR.size, 15.0)._replace(
        start_offset=0.0, wind=wind, duration=15.0
    )
    simulation, controller = Simulation(CAR, scenario), preview()
    commands: list[Plan] = []
    step = controller.step

    class Watched:
        period = controller.period

        def step(self, state: VehicleState, path: Path) -> Plan:
            commands.append(step(state, path))
            return commands[-1]

    drive(simulation, Watched())
    late = [command.diagnosis for command in commands[100:]]
    assert max(abs(d.cross_track_error) for d in late) < 0.01
    air = CAR.aerodynamics
    force = 0.5 * air.air_density * air.side_area * 15.0**2
    assert late[-1].disturbance == pytest.approx(force / CAR.chassis.mass, rel=0.05)


hostile = st.builds(
    VehicleState,
    stamp_ns=st.integers(0, 10**18),
    x=st.floats(-1e3, 1e3),
    y=st.floats(-1e3, 1e3),
    yaw=st.floats(-math.pi, math.pi),
    v_x=st.floats(-5.0, 60.0),
    v_y=st.floats(-10.0, 10.0),
    yaw_rate=st.floats(-5.0, 5.0),
)


@given(st.lists(hostile, min_size=1, max_size=10), st.integers(0, 3))
@settings(max_examples=60, deadline=None)
def test_commands_are_finite_and_within_angle_and_rate(
    states: list[VehicleState], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    path = make_path(np.cumsum(rng.uniform(-2.0, 5.0, (100, 2)), axis=0))
    limits = load(ControllerSettings, find("controllers", "table3"))
    steering = replace(CAR.steering, max_rate=0.7, delay=0.13, lag=0.05)
    controller = PreviewMpc(CAR.chassis, steering, limits, load_gain_table("preview"))
    before = 0.0
    for k, state in enumerate(states):
        timely = state._replace(stamp_ns=(k + 1) * NANOSECONDS // 10)
        command = controller.step(timely if seed % 2 else state, path)
        assert abs(command.steering) <= limits.max_angle + 1e-9
        assert abs(command.steering - before) <= 0.7 * controller.period + 1e-9
        before = command.steering


@pytest.mark.parametrize("car", [CAR, ORDINARY], ids=["paper", "ordinary"])
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.2])
def test_the_loop_is_stable_at_every_speed(car: Vehicle, delay: float) -> None:
    limits = load(ControllerSettings, find("controllers", "table3"))
    steering = replace(car.steering, delay=delay)
    controller = PreviewMpc(car.chassis, steering, limits, load_gain_table("preview"))
    for v in LOOP_SPEEDS:
        assert spectral_radius(controller, car.chassis, steering, v, estimator=False) < LOOP_RADIUS
        assert spectral_radius(controller, car.chassis, steering, v) < 0.97, v
        if delay == 0.0:
            assert delay_margin(controller, car.chassis, steering, v) >= 0.078, v


def test_a_wheel_that_is_stuck_holds_the_command_back() -> None:
    limits = load(ControllerSettings, find("controllers", "table3"))
    table = load_gain_table("preview")
    controller = PreviewMpc(ORDINARY.chassis, ORDINARY.steering, limits, table)
    step = ORDINARY.steering.max_rate * limits.sample_time
    angles = []
    for k in range(30):
        controller.observe_steering(0.0)
        state = state_at(100.0, -5.0, yaw=-0.5, v_x=5.0, k=k)
        angles.append(controller.step(state, STRAIGHT).steering)
    assert 1.5 * step < max(angles) <= 2.0 * step + 1e-12


class Measuring:
    """Controller that receives the measured angle before each step."""

    def __init__(self, controller: PreviewMpc, simulation: Simulation) -> None:
        """Measure on the car of a simulation."""
        self.controller, self.simulation = controller, simulation
        self.period = controller.period

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Tell, then answer."""
        self.controller.observe_steering(self.simulation.car.steering)
        return self.controller.step(state, path)


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.0), (0.1, 0.1)])
def test_a_measured_angle_that_moves_as_expected_changes_hardly_anything(
    delay: float, lag: float
) -> None:
    car = CAR._replace(steering=replace(CAR.steering, delay=delay, lag=lag))
    limits = load(ControllerSettings, find("controllers", "table3"))

    def fresh() -> tuple[PreviewMpc, Simulation]:
        controller = PreviewMpc(car.chassis, car.steering, limits, load_gain_table("preview"))
        return controller, Simulation(car, load_scenario("sc2", car.size))

    controller, simulation = fresh()
    alone = drive(simulation, controller).steering
    controller, simulation = fresh()
    measured = drive(simulation, Measuring(controller, simulation)).steering
    assert np.abs(alone - measured).max() < math.radians(0.05)
