"""Estimation of what differs from the configured car, and its use by the controller."""

import json
import math
from collections.abc import Callable
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import understeer_gradient
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.assumed_car import MOST_STIFF, SteeringResponse, assumed_car, front_share, with_tyres
from ampc_ros.configuration import CarDifference, Configuration, from_yaml, to_yaml
from ampc_ros.estimation.adaptation import (
    DIFFERENCES,
    FILTER_SIZE,
    GRADIENT,
    LATENCY_CHANGE,
    STIFFNESS,
    Adaptation,
    corrected,
    lengthened,
)
from ampc_ros.estimation.command_history import CommandHistory
from ampc_ros.estimation.stored_difference import (
    difference_file,
    read_difference,
    remove_difference,
    store_difference,
)
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.parameters import load_vehicle_file
from tests.supervised import Run, made_for, supervised
from tests.workshop.acceptance.adapted_drives import (
    Change,
    ChangedOwnCar,
    changed,
    config_of,
    drive,
    hostile_drive,
    lane_change,
    ordinary_road,
)
from tests.workshop.acceptance.trials import Trial

ORDINARY = load_vehicle_file(find("vehicles", "ordinary"))
VEHICLE = astuple(ORDINARY.chassis)
STEP_NS = NANOSECONDS // 10


# Changed models


@settings(deadline=None)  # the first example may compile
@given(st.floats(-0.0015, 0.004), st.floats(-0.8, 0.8))
def test_changed_tyres_have_the_gradient_and_the_stiffness_that_are_asked_for(
    change: float, stiffness: float
) -> None:
    other = with_tyres(VEHICLE, change, stiffness)
    assert other[:4] == VEHICLE[:4]
    assert other[5] == pytest.approx(VEHICLE[5] * math.exp(stiffness))
    wanted = understeer_gradient(VEHICLE) + change
    if other[4] < 0.999 * MOST_STIFF * VEHICLE[4]:
        assert understeer_gradient(other) == pytest.approx(wanted, abs=1e-12)
    else:  # the front tyre is limited
        assert understeer_gradient(other) >= wanted - 1e-9


def test_no_gradient_makes_a_front_tyre_that_pulls() -> None:
    assert 0.0 < with_tyres(VEHICLE, -1.0, 0.0)[4] == pytest.approx(MOST_STIFF * VEHICLE[4])


@given(st.floats(0.0, 0.5), st.floats(0.0, 0.5), st.floats(-0.5, 0.5))
def test_a_changed_latency_is_the_sum_of_delay_and_lag(
    delay: float, lag: float, change: float
) -> None:
    other = lengthened(SteeringResponse(delay, lag), change)
    assert min(other) >= 0.0
    assert sum(other) == pytest.approx(max(delay + lag + change, 0.0), abs=1e-12)
    assert other.lag <= max(lag, 0.1)


# The filter


def test_a_correction_is_that_of_the_information_filter() -> None:
    rng = np.random.default_rng(1)
    root = rng.standard_normal((FILTER_SIZE, FILTER_SIZE))
    P, H, x = root @ root.T, rng.standard_normal(FILTER_SIZE), rng.standard_normal(FILTER_SIZE)
    after, covariance = corrected(x, P, H, 0.3, 0.5)
    information = np.linalg.inv(P) + np.outer(H, H) / 0.5
    assert covariance == pytest.approx(np.linalg.inv(information), abs=1e-8)
    wanted = np.linalg.solve(information, np.linalg.solve(P, x) + H * (0.3 + H @ x) / 0.5)
    assert after == pytest.approx(wanted, abs=1e-7)


def observed(
    config: Configuration,
    steering: Callable[[float], float],
    *,
    speed: float = 12.0,
    duration: float = 60.0,
    lag: float = 0.0,
    offset: float = 0.0,
    front: float = 1.0,
    rear: float = 1.0,
    point: float = 0.0,
    distort: Callable[[VehicleState, float], VehicleState] = lambda state, _: state,
) -> Adaptation:
    """Return the estimates for a linear car, integrated by SciPy, with commands of 10 Hz.

    Args:
        config: What the controller assumes.
        steering: Commanded angle by time [rad].
        speed: [m/s].
        duration: [s].
        lag: True time constant of the steering [s].
        offset: True angle of the wheels at a command of zero [rad].
        front: Factor on the front cornering stiffness.
        rear: Factor on the rear cornering stiffness.
        point: Distance of the measured point ahead of the rear axle [m].
        distort: What odometry makes of a state.
    """
    m, I_z, l_f, l_r, C_f, C_r = VEHICLE
    C_f, C_r = C_f * front, C_r * rear
    ticks = np.arange(0.0, duration, 0.1)
    sent = [steering(float(t)) for t in ticks]

    def rate(t: float, z: Array, /) -> Array:
        v_y, r, delta = z
        u = sent[min(int(t / 0.1 + 1e-9), len(sent) - 1)]
        wheel = (delta if lag else u) + offset
        F_f = 2 * C_f * (wheel - (v_y + l_f * r) / speed)
        F_r = 2 * C_r * (l_r * r - v_y) / speed
        slope = (u - delta) / lag if lag else 0.0
        return np.array([(F_f + F_r) / m - speed * r, (l_f * F_f - l_r * F_r) / I_z, slope])

    start = np.zeros(3)
    motion = solve_ivp(rate, (0.0, duration), start, t_eval=ticks, max_step=0.02)
    adaptation, commands = Adaptation(config), CommandHistory(0.0, 10 * NANOSECONDS)
    for i, t in enumerate(map(float, ticks)):
        v_y, r = float(motion.y[0, i]), float(motion.y[1, i])
        v_y += (point - l_r) * r
        state = VehicleState(i * STEP_NS, speed * t, 0.0, 0.0, speed, v_y, r)
        adaptation.observe(distort(state, t), commands)
        commands.store(sent[i], i * STEP_NS)
    return adaptation


def weave(t: float) -> float:
    """Return an angle with fast and slow parts, below 3 m/s^2 at 12 m/s [rad]."""
    return 0.025 * math.sin(1.1 * t) * (1.0 + 0.3 * math.sin(0.17 * t)) + 0.008 * math.sin(4.0 * t)


ASSUMED = config_of(ORDINARY.chassis, ORDINARY.steering)


@pytest.mark.parametrize("lag", [0.05, 0.12])
def test_a_latency_that_is_not_configured_is_estimated(lag: float) -> None:
    unknown = config_of(ORDINARY.chassis, replace(ORDINARY.steering, lag=-1.0))
    adaptation = observed(unknown, weave, lag=lag)
    assert adaptation.is_latency_known
    assert sum(adaptation.adapted_car.response) == pytest.approx(lag, abs=0.015)


@pytest.mark.parametrize("offset_deg", [1.0, -2.0])
def test_an_offset_is_estimated(offset_deg: float) -> None:
    offset = math.radians(offset_deg)
    adaptation = observed(ASSUMED, weave, offset=offset)
    assert adaptation.adapted_car.offset == pytest.approx(offset, abs=math.radians(0.1))


@pytest.mark.parametrize(("front", "rear"), [(0.7, 0.7), (0.75, 1.0), (1.3, 1.3)])
def test_gradient_and_rear_stiffness_are_estimated(front: float, rear: float) -> None:
    m, I_z, l_f, l_r, C_f, C_r = VEHICLE
    true = (m, I_z, l_f, l_r, C_f * front, C_r * rear)
    adaptation = observed(ASSUMED, weave, front=front, rear=rear)
    change, deviation = adaptation.difference, np.sqrt(np.diag(adaptation.P))
    gradient = understeer_gradient(true) - understeer_gradient(VEHICLE)
    assert change.understeer_gradient == pytest.approx(gradient, abs=2 * deviation[GRADIENT])
    assert change.rear_stiffness == pytest.approx(math.log(rear), abs=2 * deviation[STIFFNESS])
    assert deviation[GRADIENT] < 5e-4
    assert deviation[STIFFNESS] < 0.25


def test_a_car_as_configured_stays_as_configured() -> None:
    adaptation = observed(ASSUMED, weave)
    assert adaptation.adapted_car == assumed_car(ASSUMED)


def test_a_wrong_measuring_point_is_no_soft_tyre() -> None:
    adaptation = observed(ASSUMED, weave, point=0.6)
    assert abs(adaptation.difference.rear_stiffness) < 0.15
    assert abs(adaptation.difference.understeer_gradient) < 2e-4


@pytest.mark.parametrize(
    ("speed", "distort"),
    [
        (1.4, lambda state, _: state),
        (12.0, lambda state, t: state._replace(yaw_rate=0.1)),
        (12.0, lambda state, t: state._replace(yaw_rate=5.0 * (-1) ** round(10 * t))),
        (12.0, lambda state, t: state._replace(v_x=28.0, yaw_rate=0.3 + 0.01 * (t % 1.0))),
    ],
    ids=["slow", "stuck", "skid", "fast"],
)
def test_estimates_freeze(
    speed: float, distort: Callable[[VehicleState, float], VehicleState]
) -> None:
    adaptation = observed(ASSUMED, weave, speed=speed, duration=20.0, offset=0.02, distort=distort)
    assert adaptation.difference == CarDifference()


def test_the_rear_stiffness_needs_a_lateral_velocity() -> None:
    adaptation = observed(
        ASSUMED, weave, front=0.7, rear=0.7, distort=lambda state, _: state._replace(v_y=0.0)
    )
    assert adaptation.difference.rear_stiffness == 0.0
    assert adaptation.difference.understeer_gradient > 3e-4


def test_a_replaced_yaw_rate_resets_what_may_have_been_learnt_from_it() -> None:
    config = made_for("ordinary")
    supervisor = Supervisor(config._replace(steering=replace(config.steering, lag=-1.0)))
    supervisor.take_path([(0.5 * i, 0.0) for i in range(200)], NANOSECONDS, NANOSECONDS)
    adaptation = supervisor.adaptation
    assert adaptation
    adaptation.x[LATENCY_CHANGE] = adaptation.used[0] = 0.2
    state = VehicleState(NANOSECONDS, 1.0, 0.0, 0.0, 9.0, 0.0, 0.0)
    supervisor.replay_state(Received(state, NANOSECONDS, NANOSECONDS), 0, 0.05)
    record = supervisor.tick(NANOSECONDS)
    assert record
    assert adaptation.difference == CarDifference()
    assert record.steering_latency == pytest.approx(0.08)


def test_a_mirrored_drive_has_mirrored_estimates() -> None:
    def mirrored(t: float) -> float:
        return -weave(t)

    left, right = (observed(ASSUMED, f, lag=0.1) for f in (weave, mirrored))
    one, other = left.difference, right.difference
    assert one.steering_offset == pytest.approx(-other.steering_offset, abs=1e-6)
    assert one.latency == pytest.approx(other.latency, abs=1e-5)
    assert one.understeer_gradient == pytest.approx(other.understeer_gradient, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_hostile_states_leave_the_estimates_within_their_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stated = float(rng.choice([-1.0, 0.0, 0.2, 3.0]))
    config = config_of(ORDINARY.chassis, replace(ORDINARY.steering, lag=stated))
    adaptation, commands = Adaptation(config), CommandHistory(0.0, 5 * NANOSECONDS)
    now_ns, extreme = 0, 10.0 ** rng.uniform(-2, 300)
    for _ in range(60):
        now_ns += int(rng.choice([0, 1, STEP_NS, STEP_NS, 10 * STEP_NS, -STEP_NS]))
        size = extreme if rng.random() < 0.1 else 1.0
        v_x, v_y, r = size * rng.normal((12.0, 0.0, 0.0), (5.0, 1.0, 0.3))
        adaptation.observe(VehicleState(now_ns, 0.0, 0.0, 0.0, v_x, v_y, r), commands)
        commands.store(float(rng.normal(0.0, 0.3)), now_ns)
        x = adaptation.x[DIFFERENCES]
        assert ((adaptation.lower <= x) & (x <= adaptation.upper)).all()
        car = adaptation.adapted_car
        assert np.isfinite(car.vehicle).all()
        assert min(car.response) >= 0.0
        assert 0.0 <= car.caution <= 1.0
    assert abs(adaptation.difference.understeer_gradient) <= 0.5 * front_share(VEHICLE) + 1e-12


# In the loop


def with_adaptation(config: Configuration, *, on: bool) -> Configuration:
    """Return the configuration with adaptation on or off."""
    return config._replace(settings=replace(config.settings, adaptation=on))


@pytest.mark.parametrize("car", ["ordinary", "paper"])
def test_a_car_as_configured_is_driven_bit_for_bit_as_without_adaptation(car: str) -> None:
    trial = Trial("sc1", car)
    runs = [supervised(trial, with_adaptation(made_for(car), on=on)) for on in (True, False)]
    one, other = ([record.command.steering for record in run.records] for run in runs)
    assert one == other


def test_the_paper_formulation_does_not_adapt() -> None:
    supervisor = Supervisor(made_for("paper", "paper"))
    assert supervisor.adaptation is None
    assert not supervisor.assumed_car.offset


@pytest.mark.parametrize("change", [Change(offset_deg=1.0), Change(delay=0.1), Change(tyres=0.7)])
def test_after_ordinary_driving_a_changed_car_is_nearly_driven_as_with_its_true_file(
    change: Change,
) -> None:
    true = replace(ORDINARY.steering, delay=change.delay)
    right = config_of(changed(ORDINARY.chassis, change), true, adaptation=False)
    wrong = config_of(ORDINARY.chassis, ORDINARY.steering)
    straight, to_cg = change._replace(offset_deg=0.0), ORDINARY.chassis.cg_to_rear_axle
    errors = []
    for config, car, trained in (
        (right, straight, False),
        (wrong, change, True),
        (with_adaptation(wrong, on=False), change, False),
    ):
        supervisor, road, test = Supervisor(config), ordinary_road(21), lane_change(13.0)
        if trained:
            drive(supervisor, road, ChangedOwnCar(ORDINARY, road, car), to_cg, NANOSECONDS)
            supervisor.forget()
            supervisor.restart(0.0)
        driven = drive(
            supervisor, test, ChangedOwnCar(ORDINARY, test, car), to_cg, 300 * NANOSECONDS
        )
        errors.append(float(np.abs(driven).max()))
    assert errors[1] < min(1.5 * errors[0], errors[2])


def test_the_offset_is_taken_off_the_command_and_added_to_the_measured_angle() -> None:
    config = made_for("ordinary")._replace(difference=CarDifference(steering_offset=0.02))
    supervisor, straight = Supervisor(config), Supervisor(made_for("ordinary"))
    for each in (supervisor, straight):
        adaptation = each.adaptation
        assert adaptation
        adaptation.P[4, 4] = 1e-8  # significant
        each.take_path([(0.5 * i, 0.0) for i in range(200)], NANOSECONDS, NANOSECONDS)
    commands = []
    for each in (supervisor, straight):
        for i in range(60):
            now_ns = NANOSECONDS + i * STEP_NS
            each.take_state(VehicleState(now_ns, 0.5 * i, 0.0, 0.0, 5.0, 0.0, 0.0), now_ns)
            record = each.tick(now_ns)
        assert record
        commands.append(record)
    assert commands[0].steering_offset == pytest.approx(0.02, abs=1e-4)
    assert commands[0].command.steering == pytest.approx(-0.02, abs=2e-3)
    assert commands[0].command.planned_steering == commands[0].command.steering
    assert commands[1].command.steering == pytest.approx(0.0, abs=1e-4)


def replayed(run: Run, config: Configuration, changes: dict[int, Configuration]) -> None:
    """Check that a drive is replayed bit for bit."""
    again = Supervisor(config)
    again.take_path(run.driven.scenario.points, NANOSECONDS, NANOSECONDS)
    states = {state.stamp_ns: state for state in run.driven.drive.states}
    for i, (t, record) in enumerate(zip(run.times, run.records, strict=True)):
        if i in changes:
            again.reconfigure(changes[i])
        state = states[record.command.stamp_ns]
        received = Received(state, state.stamp_ns, state.stamp_ns)
        again.replay_state(received, int(record.resets), record.corrected_yaw_rate)
        other = again.tick(NANOSECONDS + round(t * NANOSECONDS))
        assert other
        assert repr(other.quantities) == repr(record.quantities)


def test_an_adapted_drive_with_a_reset_is_replayed_bit_for_bit() -> None:
    unknown = made_for("ordinary")
    unknown = unknown._replace(steering=replace(unknown.steering, lag=-1.0))
    start = CarDifference(0.03, 0.0005, 0.01, 0.1)
    supervisor, changes = Supervisor(unknown._replace(difference=start)), {}
    reset = unknown._replace(difference=CarDifference())

    def change(state: VehicleState, t: float) -> VehicleState:
        if abs(t - 6.0) < 1e-6:
            supervisor.reconfigure(reset)
            changes[round(t / 0.1)] = reset
        if abs(t - 9.0) < 1e-6:
            supervisor.reconfigure(unknown)
            changes[round(t / 0.1)] = unknown
        return state

    run = supervised(Trial("sc1", "ordinary"), unknown, supervisor=supervisor, distort=change)
    assert len(changes) == 2
    assert len({record.steering_latency for record in run.records}) > 50
    replayed(run, unknown._replace(difference=start), changes)


def test_estimates_survive_a_new_configuration_of_the_same_car_only() -> None:
    config = made_for("ordinary")
    supervisor = Supervisor(config._replace(difference=CarDifference(steering_offset=0.02)))
    kept = supervisor.adaptation
    supervisor.reconfigure(config._replace(settings=replace(config.settings, friction=0.8)))
    assert supervisor.adaptation is kept
    heavier = replace(config.chassis, mass=1700.0)
    supervisor.reconfigure(config._replace(chassis=heavier))
    assert supervisor.adaptation
    assert supervisor.adaptation.difference == CarDifference()
    supervisor.reconfigure(with_adaptation(config, on=False))
    assert supervisor.adaptation is None


def test_hostile_drives_lose_no_car_more_than_without_adaptation() -> None:
    for seed in range(900_000, 900_012):
        result = hostile_drive(seed, adaptation=True)
        assert not result.outside
        assert not (result.lost and not hostile_drive(seed, adaptation=False).lost)


# Files


def test_a_configuration_with_a_difference_is_restored_from_its_text() -> None:
    config = made_for()._replace(difference=CarDifference(0.1, -0.001, 1 / 3, 0.2))
    assert from_yaml(to_yaml(config, 3), "bag") == (config, 3)
    assert from_yaml(to_yaml(made_for(), 1), "bag")[0].difference is None


def test_a_recording_of_an_older_version_is_repeated_without_adaptation() -> None:
    text = to_yaml(made_for(), 1)
    older = "\n".join(line for line in text.splitlines() if "adaptation" not in line)
    assert older != text
    assert not from_yaml(older, "bag")[0].settings.adaptation


def test_stored_estimates_are_those_of_one_vehicle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    config, difference = made_for("ordinary"), CarDifference(0.1, 1e-4, 0.01, -0.2)
    assert read_difference(config) is None
    store_difference(config, difference)
    assert read_difference(config) == difference
    assert [each.suffix for each in (tmp_path / "ampc_ros").iterdir()] == [".json"]
    heavier = config._replace(chassis=replace(config.chassis, mass=1700.0))
    assert read_difference(heavier) is None
    remove_difference(config)
    remove_difference(config)
    assert read_difference(config) is None


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "[]",
        "3",
        '{"latency": NaN}',
        '{"latency": "x"}',
        '{"steering_offset": 7.0}',
        '{"other": 1.0}',
        "[" * 5000,
        " " * 20_000,
        json.dumps({"latency": 1e400}),
    ],
)
def test_damaged_estimates_are_rejected_with_their_file(
    content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    config = made_for("ordinary")
    file = difference_file(config)
    file.parent.mkdir()
    file.write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=file.name):
        read_difference(config)


def test_estimates_beyond_their_bounds_are_clipped_at_the_start() -> None:
    difference: Any = CarDifference(5.0, -0.5, 0.9, 3.0)
    adaptation = Adaptation(made_for("ordinary")._replace(difference=difference))
    x = adaptation.x[DIFFERENCES]
    assert ((adaptation.lower <= x) & (x <= adaptation.upper)).all()
    assert adaptation.P[LATENCY_CHANGE, LATENCY_CHANGE] > 0.0
