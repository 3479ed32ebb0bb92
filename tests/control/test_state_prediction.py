"""Prediction of late and missing states: equations, command history, and the supervised drive."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, replace
from functools import cache
from itertools import pairwise
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.parameters import GRAVITY, ChassisParameters, SteeringParameters
from ampc_msgs_config.paths.path import Progress
from ampc_msgs_config.scenarios.scenario import SpeedPlanner, load_scenario
from ampc_msgs_config.types import (
    NANOSECONDS,
    OPTIMAL,
    REASONS,
    SHIFTED_PLAN,
    STOP,
    Array,
    TickRecord,
    VehicleState,
)
from ampc_ros.configuration import Configuration, from_yaml, to_yaml
from ampc_ros.estimation import state_prediction
from ampc_ros.estimation.command_history import CommandHistory
from ampc_ros.estimation.present_state import longest_history_ns
from ampc_ros.estimation.state_prediction import MODEL_ABOVE, StatePredictor
from ampc_ros.mpc.model import DELTA, STATES, zero_order_hold
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.tick import ACCELERATION, BEFORE, DISTURBANCE, EXPECTED
from ampc_ros.supervision import warm_up
from ampc_ros.supervision.fallback import (
    NO_REASON,
    OFF_PATH,
    PATH_ENDS,
    STATE_LATE,
    STATE_LOST,
)
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.tick_policy import Action, TickPolicy
from launch_scripts.replaying.recorded_run import read_run
from launch_scripts.replaying.repetition import differences, replay_ticks
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import load_vehicle_file
from tests.control.test_state_filter import vehicles
from tests.recorded_drives import Bag
from tests.supervised import Fault, between, made_for, never

MS = 1_000_000
START_NS = 1000 * NANOSECONDS
CARS = ("paper", "ordinary")
VEHICLES = {name: load_vehicle_file(find("vehicles", name)) for name in CARS}


def with_steering(config: Configuration, **changes: float) -> Configuration:
    """Return a configuration with another steering actuator."""
    return config._replace(steering=replace(config.steering, **changes))


def with_settings(config: Configuration, **changes: Any) -> Configuration:
    """Return a configuration with other settings."""
    return config._replace(settings=replace(config.settings, **changes))


# The independent model: the same differential equations, solved by SciPy.


def reference(
    config: Configuration, state: VehicleState, commands: list[tuple[int, float]], end_ns: int
) -> VehicleState:
    """Return the state at a later time, after commands (time [ns], angle); the first holds before.

    Args:
        config: Model.
        state: State at `base_link`.
        commands: In order of time.
        end_ns: Time of the prediction [ns].
    """
    m, I_z, l_f, l_r, C_f, C_r = vars(config.chassis).values()
    lag, delay_ns = config.steering.time_constant, round(config.steering.delay * NANOSECONDS)
    load = config.settings.friction * m * GRAVITY / (l_f + l_r)
    begin_ns = state.stamp_ns
    times = [time_ns + delay_ns for time_ns, _ in commands[1:]]
    angles = [angle for _, angle in commands]

    def command(t: float) -> float:
        passed = sum(t >= (each - begin_ns) / NANOSECONDS - 1e-12 for each in times)
        return angles[passed]

    def wheel_rate(t: float, delta: Any) -> Any:
        return (command(t) - delta) / lag

    def rate(t: float, z: Array) -> list[float]:
        _, _, yaw, v_y, r, delta = z
        v = state.v_x
        if lag == 0.0:
            delta = command(t)
        front = load * l_r * math.tanh(2 * C_f * (delta - (v_y + l_f * r) / v) / (load * l_r))
        rear = load * l_f * math.tanh(2 * C_r * (l_r * r - v_y) / v / (load * l_f))
        return [
            v * math.cos(yaw) - v_y * math.sin(yaw),
            v * math.sin(yaw) + v_y * math.cos(yaw),
            r,
            (front + rear) / m - v * r,
            (l_f * front - l_r * rear) / I_z,
            wheel_rate(t, delta) if lag else 0.0,
        ]

    delta, at = angles[0], [(each - begin_ns) / NANOSECONDS for each in times]
    if lag:
        bounds = [min([-1.0, *at]) - 1.0, *sorted({t for t in at if t < 0.0}), 0.0]
        for span in pairwise(bounds):
            delta = at_end(wheel_rate, span, [delta])[0]
    car = at_distance(state, config.base_link_to_cg)
    end = (end_ns - begin_ns) / NANOSECONDS
    z = np.array([car.x, car.y, car.yaw, car.v_y, car.yaw_rate, delta])
    bounds = [0.0, *sorted({t for t in at if 0.0 < t < end}), end]
    for span in pairwise(bounds):
        z = at_end(rate, span, z)
    x, y, yaw, v_y, r, _ = z
    return at_distance(VehicleState(end_ns, x, y, yaw, car.v_x, v_y, r), -config.base_link_to_cg)


def at_end(rate: Callable[..., Any], span: tuple[float, float], z: Any) -> Array:
    """Return the solution of a differential equation at the end of a time without a switch."""
    begin, end = span[0] + 1e-10, span[1] - 1e-10
    return np.asarray(solve_ivp(rate, (begin, end), z, rtol=1e-9, atol=1e-10).y[:, -1])


def predictor_of(config: Configuration, steering: float) -> StatePredictor:
    """Return a predictor with an angle in force [rad]."""
    return StatePredictor(config, CommandHistory(steering, longest_history_ns(config)))


def predictor_after(
    config: Configuration, commands: list[tuple[int, float]], before: float | None = None
) -> StatePredictor:
    """Return a predictor after commands (time [ns], angle); the first one holds before."""
    predictor = predictor_of(config, commands[0][1] if before is None else before)
    for time_ns, angle in commands:
        predictor.commands.store(angle, time_ns)
    return predictor


def random_commands(seed: int, size: float = 0.05) -> list[tuple[int, float]]:
    """Return commands at 20 Hz from 1 s before to 1 s after the start."""
    angles = size * np.random.default_rng(seed).uniform(-1.0, 1.0, 41)
    return [(START_NS + (i - 20) * 50 * MS, float(each)) for i, each in enumerate(angles)]


def close(a: VehicleState, b: VehicleState, position: float, angle: float) -> None:
    """Check that two states agree within metres, and radians or units of the twist."""
    assert a.stamp_ns == b.stamp_ns
    assert math.hypot(a.x - b.x, a.y - b.y) < position
    assert abs(math.remainder(a.yaw - b.yaw, math.tau)) < angle
    np.testing.assert_allclose(a[4:], b[4:], atol=10 * angle)


DRIVING = VehicleState(START_NS, 3.0, -2.0, 2.9, 12.0, 0.1, 0.05)
ACTUATORS = [(0.0, 0.0), (0.08, 0.0), (0.0, 0.13), (0.2, 0.07)]


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize(("lag", "delay"), ACTUATORS)
def test_prediction_solves_the_single_track_model(car: str, lag: float, delay: float) -> None:
    config = with_steering(made_for(car), lag=lag, delay=delay)
    for seed, (v_x, size, longest) in enumerate(
        [
            (5.0, 0.05, 1.0),
            (12.0, 0.05, 1.0),
            (25.0, 0.03, 1.0),
            (12.0, 0.5, 0.5),
        ]  # last: saturated
    ):
        commands, state = random_commands(seed, size), DRIVING._replace(v_x=v_x)
        end_ns = START_NS + round(longest * NANOSECONDS)
        predicted = predictor_after(config, commands).predict(state, end_ns)
        close(predicted, reference(config, state, commands, end_ns), 0.02, 2e-3)
        end_ns = START_NS + 20 * MS
        predicted = predictor_after(config, commands).predict(state, end_ns)
        close(predicted, reference(config, state, commands, end_ns), 1e-3, 2e-4)


@pytest.mark.parametrize("v_x", [3.0, 9.0, 30.0])
@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_small_motions_are_those_of_the_linear_model(v_x: float, lag: float) -> None:
    config = with_steering(made_for(), lag=lag)._replace(base_link_to_cg=0.0)
    before, after, elapsed = 2e-4, -3e-4, 0.4
    state = VehicleState(START_NS, 0.0, 1e-3, 1e-4, v_x, 2e-3, -1e-3)
    predictor = predictor_of(config, before)
    predictor.commands.store(after, START_NS)
    predicted = predictor.predict(state, START_NS + round(elapsed * NANOSECONDS))
    A, B = np.zeros((STATES, STATES)), np.zeros(STATES)
    vehicle = tuple(vars(config.chassis).values())
    zero_order_hold(vehicle, v_x, lag, elapsed, A, B, make_scratch(400))
    x = np.array([state.v_y, state.yaw, state.yaw_rate, state.y, 0.0])
    x[DELTA] = before
    v_y, yaw, r, y, _ = A @ x + B * after
    expected = VehicleState(predicted.stamp_ns, v_x * elapsed, y, yaw, v_x, v_y, r)
    np.testing.assert_allclose(predicted[1:], expected[1:], atol=2e-6)


@given(st.integers(-(10**10), 0), st.floats(-5.0, 60.0))
@settings(max_examples=50, deadline=None)
def test_a_state_of_now_or_later_is_the_same_object(after_ns: int, v_x: float) -> None:
    predictor = predictor_after(made_for(), random_commands(1))
    state = DRIVING._replace(v_x=v_x)
    assert predictor.predict(state, START_NS + after_ns) is state


@given(st.integers(1, 999), st.floats(0.0, 40.0), st.integers(0, 20))
@settings(max_examples=40, deadline=None)
def test_two_predictions_in_a_row_are_one(middle: int, v_x: float, seed: int) -> None:
    config = with_steering(made_for(), lag=0.1, delay=0.07)
    predictor = predictor_after(config, random_commands(seed))
    state, end_ns = DRIVING._replace(v_x=v_x), START_NS + NANOSECONDS
    once = predictor.predict(state, end_ns)
    twice = predictor.predict(predictor.predict(state, START_NS + middle * MS), end_ns)
    close(once, twice, 3e-3, 3e-4)


@given(st.integers(0, 20), st.floats(0.0, 40.0), st.floats(-0.2, 0.2), st.floats(-1.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_a_mirrored_car_is_predicted_mirrored(seed: int, v_x: float, r: float, v_y: float) -> None:
    config = with_steering(made_for("ordinary"), lag=0.05, delay=0.1)
    state = VehicleState(START_NS, 0.0, 0.4, 0.3, v_x, v_y, r)
    mirrored = state._replace(y=-0.4, yaw=-0.3, v_y=-v_y, yaw_rate=-r)
    commands, end_ns = random_commands(seed, 0.2), START_NS + 700 * MS
    left = predictor_after(config, commands).predict(state, end_ns)
    right = predictor_after(config, [(t, -u) for t, u in commands]).predict(mirrored, end_ns)
    opposite = left._replace(y=-left.y, yaw=-left.yaw, v_y=-left.v_y, yaw_rate=-left.yaw_rate)
    np.testing.assert_allclose(right, opposite, atol=1e-12)


@pytest.mark.parametrize("angle", [-0.5, 0.0, 0.5])
def test_a_standing_car_is_not_moved(angle: float) -> None:
    predictor = predictor_after(made_for(), [(START_NS, angle)])
    state = DRIVING._replace(v_x=0.0, v_y=0.0, yaw_rate=0.0)
    predicted = predictor.predict(state, START_NS + 3 * NANOSECONDS)
    np.testing.assert_allclose(predicted[1:], state[1:], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("v_x", [0.3, -2.0, 0.99 * MODEL_ABOVE])
def test_a_slow_car_keeps_its_twist(v_x: float) -> None:
    predictor = predictor_after(made_for()._replace(base_link_to_cg=0.0), random_commands(2))
    state = DRIVING._replace(v_x=v_x, v_y=0.0, yaw_rate=0.2, yaw=0.0, x=0.0, y=0.0)
    predicted = predictor.predict(state, START_NS + 2 * NANOSECONDS)
    radius, turned = v_x / 0.2, 0.4
    expected = (radius * math.sin(turned), radius * (1.0 - math.cos(turned)), turned, *state[4:])
    np.testing.assert_allclose(predicted[1:], expected, atol=1e-4)


@given(
    vehicles(),
    st.floats(-5.0, 60.0),
    st.floats(0.05, 2.0),
    st.floats(-1.5, 1.5),
    st.floats(-10.0, 10.0),
    st.sampled_from([0.0, 1e-6, 0.08, 5.0]),
)
@settings(max_examples=60, deadline=None)
def test_every_car_is_predicted_finite(
    vehicle: tuple[float, ...], v_x: float, friction: float, angle: float, v_y: float, lag: float
) -> None:
    names = (each.name for each in fields(ChassisParameters))
    values = dict(zip(names, vehicle, strict=True))
    for name, least in (("mass", 1.0), ("yaw_inertia", 0.01)):  # bounds of the parameters
        values[name] = max(values[name], least)
    chassis = ChassisParameters(**values)
    config = with_settings(made_for(), friction=friction)._replace(chassis=chassis)
    steering = SteeringParameters(max_angle=1.5, lag=lag, delay=2.0)
    predictor = predictor_of(config._replace(steering=steering), angle)
    predictor.commands.store(-angle, START_NS - NANOSECONDS)
    state = DRIVING._replace(v_x=v_x, v_y=v_y, yaw_rate=v_y / 2)
    predicted = predictor.predict(state, START_NS + 3 * NANOSECONDS)
    assert np.isfinite(predicted).all()
    assert abs(predicted.yaw) <= math.pi
    travelled = math.hypot(predicted.x - state.x, predicted.y - state.y)
    assert travelled <= 3.0 * (abs(v_x) + 200.0)


def test_a_stiff_small_car_is_predicted_stably() -> None:
    chassis = ChassisParameters(
        mass=1.0,
        yaw_inertia=0.01,
        cg_to_front_axle=0.15,
        cg_to_rear_axle=0.1,
        front_cornering_stiffness=1.0e7,
        rear_cornering_stiffness=1.0e7,
    )
    predictor = predictor_of(made_for()._replace(chassis=chassis), 0.3)
    predicted = predictor.predict(DRIVING, START_NS + 3 * NANOSECONDS)
    assert np.isfinite(predicted).all()


# History of commands


def test_stored_commands_are_bounded() -> None:
    config = with_steering(made_for(), lag=0.1, delay=0.2)
    predictor = predictor_of(config, 0.0)
    for i in range(5000):
        predictor.commands.store(0.001 * (i % 7), START_NS + 10 * i * MS)
        assert len(predictor.commands.sent) <= 402  # (3 + 0.2 + 0.3 + 5 * 0.1) s at 100 Hz


@pytest.mark.parametrize("prediction", [0.5, 10.0])
def test_history_covers_the_longest_prediction(prediction: float) -> None:
    config = with_steering(made_for(), lag=0.1, delay=2.0)
    config = with_settings(config, state_prediction=prediction)
    rng, count = np.random.default_rng(3), 300
    commands = [
        (START_NS + 50 * i * MS, float(u)) for i, u in enumerate(rng.uniform(-0.02, 0.02, count))
    ]
    now_ns = commands[-1][0]
    state = DRIVING._replace(stamp_ns=now_ns - round(prediction * NANOSECONDS), v_x=5.0)
    bounded, unbounded = (predictor_of(config, commands[0][1]) for _ in range(2))
    unbounded.commands.longest_ns = 10**18
    for time_ns, angle in commands:
        bounded.commands.store(angle, time_ns)
        unbounded.commands.store(angle, time_ns)
    assert bounded.predict(state, now_ns) == unbounded.predict(state, now_ns)


def test_a_command_at_the_same_time_replaces_the_earlier_one() -> None:
    commands = random_commands(4)
    once, twice = predictor_after(made_for(), commands), predictor_after(made_for(), commands)
    once.commands.store(0.1, commands[-1][0])
    twice.commands.store(-0.3, commands[-1][0])
    twice.commands.store(0.1, commands[-1][0])
    end_ns = START_NS + 1500 * MS
    assert once.predict(DRIVING, end_ns) == twice.predict(DRIVING, end_ns)


@pytest.mark.parametrize("back", [1e-3, 0.5, 100.0])
def test_after_a_clock_that_was_set_back_the_newest_command_was_always_in_force(
    back: float,
) -> None:
    config = with_steering(made_for(), lag=0.1, delay=0.1)
    predictor, commands = predictor_after(config, random_commands(5)), random_commands(5)
    now_ns = commands[-1][0] - round(back * NANOSECONDS)
    predictor.commands.store(0.03, now_ns)
    fresh = predictor_of(config, commands[-1][1])
    fresh.commands.store(0.03, now_ns)
    state = DRIVING._replace(stamp_ns=now_ns)
    for after_ns in (50 * MS, 300 * MS):
        assert predictor.predict(state, now_ns + after_ns) == fresh.predict(
            state, now_ns + after_ns
        )


def test_a_corrected_command_is_predicted_as_if_it_had_been_sent() -> None:
    commands = random_commands(6)
    predictor = predictor_after(made_for(), commands)
    predictor.commands.correct(0.07)
    sent = predictor_after(made_for(), [*commands[:-1], (commands[-1][0], 0.07)])
    end_ns = START_NS + 1500 * MS
    assert predictor.predict(DRIVING, end_ns) == sent.predict(DRIVING, end_ns)
    empty = predictor_of(made_for(), 0.2)
    empty.commands.correct(0.07)
    expected = predictor_of(made_for(), 0.07).predict(DRIVING, end_ns)
    assert empty.predict(DRIVING, end_ns) == expected


# The supervisor


WAVES = [(float(x), 2.0 * math.sin(0.05 * x)) for x in range(300)]


def on_waves(time: float, late: float = 0.0, offset: float = 0.0) -> VehicleState:
    """Return the state of a car that followed a winding road `late` seconds before a time."""
    x = 8.9 * (time - late)
    yaw = math.atan(0.1 * math.cos(0.05 * x))
    rate = -0.005 * math.sin(0.05 * x) * 8.9
    stamp_ns = START_NS + round((time - late) * NANOSECONDS)
    return VehicleState(stamp_ns, x, 2.0 * math.sin(0.05 * x) + offset, yaw, 9.0, 0.0, rate)


class OnWaves:
    """A supervisor on a winding road, ticked at 10 Hz."""

    def __init__(self, points: Any = WAVES, **settings: Any) -> None:
        """Start at 0 s, settings replaced."""
        settings = {"adaptation": False, **settings}
        self.supervisor = Supervisor(with_settings(made_for(), **settings))
        self.supervisor.take_path(points, START_NS, START_NS)
        self.time = 0.0

    def tick(self, state: VehicleState | None = None) -> TickRecord:
        """Tick with a new state, or without one."""
        now_ns = START_NS + round(self.time * NANOSECONDS)
        if state:
            self.supervisor.take_state(state, now_ns)
        record = self.supervisor.tick(now_ns)
        assert record
        self.time += 0.1
        return record

    def drive(self, ticks: int, late: float = 0.0) -> list[TickRecord]:
        """Tick with a new state each time."""
        return [self.tick(on_waves(self.time, late)) for _ in range(ticks)]

    def silence(self, ticks: int) -> list[TickRecord]:
        """Tick without states."""
        return [self.tick() for _ in range(ticks)]


def explanation(record: TickRecord) -> tuple[int, str]:
    """Return rung and reason of a tick."""
    return record.command.rung, REASONS[int(record.command.reason)]


def test_late_then_lost_states_are_named_and_the_stop_request_remains() -> None:
    drive = OnWaves()
    assert {explanation(each) for each in drive.drive(20)} == {(OPTIMAL, REASONS[NO_REASON])}
    silent = drive.silence(40)
    ages = [each.state_age for each in silent]
    for record, age in zip(silent, ages, strict=True):
        if age <= 0.2:
            expected = (OPTIMAL, REASONS[NO_REASON])
        elif age <= 0.5:
            expected = (SHIFTED_PLAN, REASONS[STATE_LATE])
        else:
            expected = (STOP, REASONS[STATE_LOST])
        assert explanation(record) == expected
        assert bool(record.stop_requested) == (age > 0.5)
    drive.supervisor.take_path(WAVES, START_NS, START_NS)
    after = [drive.tick(on_waves(drive.time)) for _ in range(30)]
    assert explanation(after[-1]) == (OPTIMAL, REASONS[NO_REASON])
    assert all(each.stop_requested for each in after)
    drive.supervisor.clear_stop()
    assert not drive.drive(1)[0].stop_requested


def test_without_prediction_a_late_state_is_answered_from_the_plan() -> None:
    drive = OnWaves(state_prediction=0.0)
    plan = drive.drive(20, late=0.05)[-1].command.plan.angles
    assert plan is not None
    drive.time += 0.1
    for i, record in enumerate(drive.silence(3), start=2):
        assert explanation(record) == (SHIFTED_PLAN, REASONS[STATE_LATE])
        assert record.command.planned_steering == plan[i]


def test_without_prediction_a_state_in_time_is_used_as_it_is() -> None:
    late, in_time = OnWaves(state_prediction=0.0), OnWaves()
    for _ in range(30):
        one = late.tick(on_waves(late.time, 0.1))
        other = in_time.supervisor
        stamp_ns = on_waves(in_time.time, 0.1).stamp_ns
        other.take_state(on_waves(in_time.time, 0.1), stamp_ns)
        record = other.tick(stamp_ns)  # as in lock-step: nothing to predict
        in_time.time += 0.1
        assert record
        assert record.command.steering == one.command.steering


def test_beyond_the_longest_prediction_the_plan_continues() -> None:
    drive = OnWaves(state_prediction=1.0)
    drive.drive(20)
    silent = drive.silence(20)
    assert {explanation(each) for each in silent[5:]} == {(STOP, REASONS[STATE_LOST])}
    angles = np.array([each.command.steering for each in silent])
    assert np.abs(np.diff(angles[10:])).max() <= 0.1 * 0.1 + 1e-12


def test_estimates_wait_while_a_state_is_repeated_and_learn_the_error_of_all_ticks() -> None:
    drive = OnWaves()
    drive.drive(20, late=0.05)

    def estimates() -> bytes:
        memory = drive.supervisor.controller.memory  # type: ignore[attr-defined]
        rows = memory[DISTURBANCE:EXPECTED], memory[ACCELERATION:BEFORE]
        return b"".join(each.tobytes() for each in rows)

    before = estimates()
    for _ in range(8):
        drive.tick()
        assert estimates() == before
    memory = drive.supervisor.controller.memory  # type: ignore[attr-defined]
    earlier = memory[DISTURBANCE:EXPECTED].copy()
    drive.tick(on_waves(drive.time, 0.05, offset=0.3))
    change = memory[DISTURBANCE:EXPECTED] - earlier
    assert 0.0 < change[3] < 0.05 * 0.4 / 9  # 0.3 m in nine ticks, not in one


def test_states_that_are_always_late_do_not_hide_the_end_of_the_path() -> None:
    drive = OnWaves(points=WAVES[:60])
    records = drive.drive(70, late=0.25)
    assert explanation(records[20]) == (SHIFTED_PLAN, REASONS[STATE_LATE])
    due = next(each for each in records if each.stop_requested)
    assert REASONS[int(due.command.reason)] == REASONS[PATH_ENDS]
    assert due.state_age == pytest.approx(0.25)


def test_states_that_are_always_late_do_not_hide_a_deviation() -> None:
    drive = OnWaves()
    drive.drive(30, late=0.25)
    for i in range(15):
        record = drive.tick(on_waves(drive.time, 0.25, offset=0.12 * i))
    assert REASONS[int(record.command.reason)] == REASONS[OFF_PATH]
    assert record.stop_requested


def test_a_lost_state_comes_before_the_end_of_the_path() -> None:
    drive = OnWaves(points=WAVES[:60])
    drive.drive(45)
    assert {explanation(each) for each in drive.silence(15)[6:]} == {(STOP, REASONS[STATE_LOST])}


def test_what_is_predicted_with_is_the_command_after_the_guard() -> None:
    drive = OnWaves()
    guard = drive.supervisor.config.guard
    slow = replace(guard, max_rate=tuple(0.01 for _ in guard.max_rate))
    drive.supervisor.reconfigure(drive.supervisor.config._replace(guard=slow))
    records = drive.drive(20)
    sent = drive.supervisor._present.commands.sent
    assert [each.steering for each in sent] == [each.command.steering for each in records]
    assert any(each.command.clipped for each in records)
    drive.supervisor.correct(0.01)
    assert sent[-1].steering == drive.supervisor.steering == 0.01


def test_a_new_configuration_keeps_the_history_of_commands() -> None:
    drive = OnWaves()
    drive.drive(20)
    state, now_ns = on_waves(1.5), START_NS + 2 * NANOSECONDS
    before = drive.supervisor._present.predictor.predict(state, now_ns)
    drive.supervisor.reconfigure(with_settings(drive.supervisor.config, max_increment=0.2))
    assert drive.supervisor._present.predictor.predict(state, now_ns) == before
    drive.supervisor.reconfigure(with_steering(drive.supervisor.config, delay=0.2))
    assert drive.supervisor._present.predictor.predict(state, now_ns) != before


def test_a_restart_in_the_drive_keeps_the_history_of_commands() -> None:
    drive = OnWaves()
    drive.drive(20)
    state, now_ns = on_waves(1.5), START_NS + 2 * NANOSECONDS
    before = drive.supervisor._present.predictor.predict(state, now_ns)
    drive.supervisor.restart()
    assert drive.supervisor._present.predictor.predict(state, now_ns) == before
    drive.supervisor.restart(0.1)
    expected = predictor_of(drive.supervisor.config, 0.1).predict(state, now_ns)
    assert drive.supervisor._present.predictor.predict(state, now_ns) == expected


@pytest.mark.parametrize("simulated", [False, True])
def test_after_a_clock_that_jumped_back_the_angle_in_force_is_predicted_with(
    simulated: bool,
) -> None:
    config = with_settings(made_for()._replace(simulated_time=simulated), adaptation=False)
    supervisor = Supervisor(config)
    supervisor.take_path(WAVES, START_NS, START_NS)
    for i in range(40):
        now_ns = START_NS + i * 100 * MS
        supervisor.take_state(on_waves(0.1 * i), now_ns)
        supervisor.tick(now_ns)
    angle, back_ns = supervisor.steering, 500 * NANOSECONDS
    restarted = False
    for i in range(40, 60):
        now_ns = START_NS + i * 100 * MS - back_ns
        state = on_waves(0.1 * i)
        state = state._replace(stamp_ns=state.stamp_ns - back_ns)
        try:
            restarted = supervisor.take_state(state, now_ns)
        except ValueError:  # until others confirm it
            continue
        break
    assert restarted
    in_force = 0.0 if simulated else angle
    fresh = predictor_of(config, in_force).predict(state, now_ns + 50 * MS)
    assert supervisor._present.predictor.predict(state, now_ns + 50 * MS) == fresh


def test_warm_up_predicts_a_state(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, advance_car = [], state_prediction.advance_car

    def counted(*arguments: Any) -> Any:
        calls.append(arguments)
        return advance_car(*arguments)

    monkeypatch.setattr(state_prediction, "advance_car", counted)
    warm_up.warm_up(made_for())
    assert calls


def test_older_recordings_are_replayed_without_prediction_and_filter() -> None:
    later = ("state_prediction", "position_noise", "heading_noise")
    text = to_yaml(made_for(), 1)
    old = "\n".join(each for each in text.splitlines() if not any(key in each for key in later))
    before, now = (from_yaml(each, "bag")[0].settings for each in (old, text))
    assert [getattr(before, key) for key in later] == [0.0, 0.0, 0.0]
    assert [getattr(now, key) for key in later] == [3.0, 0.05, 0.0087]


# Drives with late and missing odometry


class Timing(NamedTuple):
    """Odometry and controller of a drive."""

    late: float = 0.0
    """Time from stamp to arrival [s]."""
    odometry: float = 0.02
    """Time between two states [s]."""
    settings: str = "table3"
    gains: str = ""
    silent: Fault = never
    """When no state arrives."""


class Late(NamedTuple):
    """Result of a drive."""

    error: Array
    """Cross-track error of the centre of gravity (n,) [m]."""
    time: Array
    """[s]."""
    records: list[TickRecord]


STEP = 0.01
"""Step of the loop [s]."""


def drive_late(
    car: str,
    timing: Timing,
    speed: float = 9.0,
    mirrored: bool = False,
    bag: Bag | None = None,
    disturb: Callable[[Supervisor, int], None] = lambda *_: None,
    **changes: Any,
) -> Late:
    """Drive sc1 by the tick policy of the node, with its own clock.

    Args:
        car: Shipped vehicle.
        timing: Odometry and controller.
        speed: [m/s].
        mirrored: Whether the road turns the other way.
        bag: Bag to record into.
        disturb: Called before each tick with the number of ticks.
        changes: Changed settings.
    """
    choices = {"settings": timing.settings, "gain_table": timing.gains}
    config = with_settings(made_for(car, **choices), **changes)
    scenario = load_scenario("sc1", VEHICLES[car].size, speed)
    if mirrored:
        scenario = scenario._replace(points=np.asarray(scenario.points) * (1.0, -1.0))
    simulation, planner = Simulation(VEHICLES[car], scenario), SpeedPlanner(scenario)
    supervisor, progress = Supervisor(config), Progress(scenario.path)
    policy, period_ns = TickPolicy(supervisor), round(config.settings.sample_time * NANOSECONDS)
    supervisor.take_path(scenario.points, START_NS, START_NS)
    if bag:
        bag.path(scenario.points, START_NS)
    queue: list[VehicleState] = []
    error, records, number = [], list[TickRecord](), 0
    count, to_cg = round(scenario.duration / STEP), VEHICLES[car].chassis.cg_to_rear_axle

    def tick(now_ns: int) -> None:
        nonlocal number
        disturb(supervisor, len(records))
        if bag and supervisor.number != number:
            number = supervisor.number
            bag.configuration(supervisor)
        if record := policy.tick(now_ns):
            records.append(record)
            if bag:
                bag.decision(record, len(records))

    for step in range(count):
        now_ns = START_NS + round(step * STEP * NANOSECONDS)
        measured = as_received(simulation.car.measure(now_ns))
        if step % round(timing.odometry / STEP) == 0 and not timing.silent(step * STEP):
            queue.append(bag.state(measured) if bag else measured)
        while queue and queue[0].stamp_ns + round(timing.late * NANOSECONDS) <= now_ns:
            with suppress(ValueError):  # rejected after a long gap, until others confirm it
                policy.take_state(queue.pop(0), now_ns)
            if policy.on_input() is Action.TICK:
                tick(now_ns)
        is_due = (now_ns - START_NS) % period_ns == 0
        if is_due and policy.on_timer(now_ns, period_ns) is Action.TICK:
            tick(now_ns)
        centre = at_distance(measured, to_cg)
        error.append(progress.errors(centre)[0])
        target = planner.target_speed(measured)
        simulation.advance(supervisor.steering, target, round(STEP * NANOSECONDS))
    return Late(np.array(error), STEP * np.arange(count, dtype=float), records)


AT_50_HZ = {"settings": "50hz", "gains": "preview_50hz"}
RATES: dict[str, dict[str, str]] = {"10 Hz": {}, "50 Hz": AT_50_HZ}


@cache
def largest(car: str, rate: str, late: float) -> float:
    """Return the largest error of a drive with odometry that is late [m]."""
    return float(np.abs(drive_late(car, Timing(late, **RATES[rate])).error).max())  # type: ignore[arg-type]


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize(("late", "bar"), [(0.05, 0.03), (0.1, 0.05), (0.15, 0.08)])
def test_late_odometry_costs_centimetres(car: str, rate: str, late: float, bar: float) -> None:
    assert largest(car, rate, late) <= largest(car, rate, 0.0) + bar


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize(("speed", "bar"), [(9.0, 0.5), (15.0, 1.0)])
def test_two_seconds_without_a_state_cost_decimetres(car: str, speed: float, bar: float) -> None:
    for begin in (1.0, 2.5, 4.0, 6.0):
        silent = between(begin, begin + 2.0)
        done = drive_late(car, Timing(silent=silent), speed)
        assert np.abs(done.error).max() < bar, begin
        assert max(each.state_age for each in done.records) > 1.9
        assert np.abs(done.error[-100:]).max() < 0.05


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("odometry", [0.04, 0.1, 0.2, 0.25, 0.5])
def test_odometry_that_is_slower_than_the_controller_is_followed(
    rate: str, odometry: float
) -> None:
    done = drive_late("paper", Timing(0.05, odometry, **RATES[rate]))  # type: ignore[arg-type]
    assert np.abs(done.error).max() < 0.05
    assert np.abs(done.error[-100:]).max() < 0.005


def test_a_mirrored_drive_with_late_and_missing_states_is_mirrored() -> None:
    timing = Timing(0.1, silent=between(2.5, 3.5))
    left, right = drive_late("paper", timing), drive_late("paper", timing, mirrored=True)
    angles = [np.array([each.command.steering for each in done.records]) for done in (left, right)]
    np.testing.assert_allclose(angles[0], -angles[1], atol=1e-6)


def changed_in_the_middle(supervisor: Supervisor, tick: int) -> None:
    """Change the configuration while states are late."""
    if tick == 33:
        supervisor.reconfigure(with_steering(supervisor.config, lag=0.05, delay=0.05))


def stop_taken_back(supervisor: Supervisor, tick: int) -> None:
    """Take back the request to stop."""
    if tick == 60:
        supervisor.clear_stop()


@pytest.mark.parametrize("disturb", [changed_in_the_middle, stop_taken_back])
@pytest.mark.parametrize("rate", RATES)
def test_late_and_missing_states_are_replayed_bit_for_bit(
    rate: str, disturb: Callable[[Supervisor, int], None], tmp_path: File
) -> None:
    timing = Timing(0.1, silent=between(2.5, 3.5), **RATES[rate])  # type: ignore[arg-type]
    with Bag(tmp_path / "bag") as bag:
        done = drive_late("paper", timing, bag=bag, disturb=disturb)
    run = read_run(tmp_path / "bag")
    assert len(run.ticks) == len(done.records)
    assert {int(each.command.rung) for each in done.records} >= {OPTIMAL, SHIFTED_PLAN, STOP}
    replayed = list(replay_ticks(run.ticks, run.config))
    for tick, record in zip(run.ticks, replayed, strict=True):
        assert differences(tick, record, 0.0) == []
