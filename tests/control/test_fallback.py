"""The ladder of fall-backs: every rung, every reason, every threshold, and what a fall costs."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.paths.path import MAX_PROJECTION_DISTANCE, Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import (
    FEED_FORWARD,
    NANOSECONDS,
    OPTIMAL,
    SHIFTED_PLAN,
    SLACK,
    STOP,
    Diagnosis,
    Plan,
    VehicleState,
)
from ampc_ros.configuration import CONTROLLERS
from ampc_ros.controller import build_controller
from ampc_ros.controller_interface import Controller
from ampc_ros.mpc.tick_result import HOLD_BELOW, REVERSE_BELOW
from ampc_ros.supervision.fallback import (
    AGAINST_PATH,
    BACKWARDS,
    MIN_SLACK,
    NO_REASON,
    OFF_PATH,
    PLAN_TIME,
    PLAN_USED_UP,
    QP_NOT_SOLVED,
    SLACK_IN_USE,
    STATE_LATE,
    STATE_LOST,
    STOP_RATE,
    FallbackChain,
    refusal,
)
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Supervisor
from tests.supervised import Run, between, made_for, never, supervised
from tests.workshop.acceptance.trials import Trial

ROAD = make_path([(0.0, 0.0), (400.0, 0.0)])
PLAN = np.array([0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08])
SOLVED, FAILED = Diagnosis(0.0, 0.0), Diagnosis(0.0, 0.0, converged=0.0)
HZ = {10: {}, 50: {"settings": "50hz", "gain_table": "preview_50hz"},
      100: {"settings": "100hz", "gain_table": "preview_100hz"}}  # fmt: skip
every_rate = pytest.mark.parametrize("rate", HZ)
every_controller = pytest.mark.parametrize("name", CONTROLLERS)
both_cars = pytest.mark.parametrize("car", ["paper", "ordinary"])


class Scripted(Controller):
    """A controller that says what a test puts into its mouth."""

    steering = 0.0

    def __init__(self, period: float = 0.1) -> None:
        """Solve everything."""
        self.period, self.steering = period, 0.0
        self.says = Plan(0, 0.01, 0.0, SOLVED, angles=PLAN)
        self.resets: list[float] = []

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Return the next answer."""
        self.steering = self.says.steering
        return self.says._replace(stamp_ns=state.stamp_ns)

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Go on from there."""
        self.steering = steering

    def reset(self, steering: float = 0.0) -> None:
        """Remember from where."""
        self.resets.append(steering)


def scripted(period: float = 0.1) -> tuple[FallbackChain, Scripted]:
    """Return a ladder, and the controller on top of it."""
    controller = Scripted(period)
    return FallbackChain(made_for(), controller), controller


def at(now_ns: int, v_x: float = 9.0, y: float = 0.0, yaw: float = 0.0) -> VehicleState:
    """Return a state on ROAD."""
    return VehicleState(now_ns, 100.0, y, yaw, v_x, 0.0, 0.0)


def ns(seconds: float) -> int:
    """Return a time [ns]."""
    return round(seconds * NANOSECONDS)


@cache
def driven(trial: Trial, controller: str = "preview", **choices: str) -> Run:
    """Drive a trial without a fault."""
    return supervised(trial, made_for(trial.car, controller, **choices))


def added(trial: Trial, faulty: Run, controller: str = "preview", **choices: str) -> float:
    """Return the largest difference to the drive without a fault [m]."""
    fine = driven(trial, controller, **choices)
    return float(np.abs(faulty.driven.error - fine.driven.error).max())


def test_solution_stands_on_top() -> None:
    ladder, _ = scripted()
    answer = ladder.answer(at(0), ROAD, 0.0, 0)
    assert (answer.rung, answer.reason) == (OPTIMAL, NO_REASON)
    assert answer.steering == 0.01


@pytest.mark.parametrize(("slack", "rung"), [(MIN_SLACK * 0.99, OPTIMAL), (MIN_SLACK, OPTIMAL),
                                             (MIN_SLACK * 1.01, SLACK), (0.5, SLACK)])  # fmt: skip
def test_slack_beyond_rounding_is_a_rung_of_its_own(slack: float, rung: int) -> None:
    ladder, controller = scripted()
    controller.says = controller.says._replace(diagnosis=SOLVED._replace(slack=slack))
    answer = ladder.answer(at(0), ROAD, 0.0, 0)
    assert (answer.rung, answer.reason) == (rung, SLACK_IN_USE if rung else NO_REASON)


@every_rate
def test_plan_holds_for_its_time_and_not_a_tick_longer(rate: int) -> None:
    period = 1.0 / rate
    for since, rung in (
        (0.0, SHIFTED_PLAN),
        (PLAN_TIME - period, SHIFTED_PLAN),
        (PLAN_TIME, SHIFTED_PLAN),
        (PLAN_TIME + 0.49 * period, SHIFTED_PLAN),
        (PLAN_TIME + 0.51 * period, FEED_FORWARD),
        (PLAN_TIME + period, FEED_FORWARD),
        (10.0, FEED_FORWARD),
    ):
        ladder, controller = scripted(period)
        ladder.answer(at(0), ROAD, 0.0, 0)
        controller.says = controller.says._replace(diagnosis=FAILED)
        answer = ladder.answer(at(ns(since)), ROAD, 0.01, ns(since))
        reason = QP_NOT_SOLVED if rung == SHIFTED_PLAN else PLAN_USED_UP
        assert (answer.rung, answer.reason) == (rung, reason)


@every_rate
def test_plan_goes_by_time_however_many_ticks_commanded(rate: int) -> None:
    period = 1.0 / rate
    for ticks in (1, 3, 5):
        ladder, _ = scripted(period)
        ladder.answer(at(0), ROAD, 0.0, 0)
        for late in (-0.4, 0.0, 0.4):
            now_ns = ns((ticks + late) * period)
            answer = ladder.advance(STATE_LATE, 0.01, now_ns)
            assert answer.steering == PLAN[ticks]
            assert (answer.rung, answer.reason) == (SHIFTED_PLAN, STATE_LATE)


def test_end_of_a_short_plan_is_held() -> None:
    ladder, controller = scripted()
    controller.says = controller.says._replace(angles=PLAN[:3])
    ladder.answer(at(0), ROAD, 0.0, 0)
    angles = [ladder.advance(STATE_LATE, 0.0, ns(0.1 * k)).steering for k in range(6)]
    assert angles == [0.01, 0.02, 0.03, 0.03, 0.03, 0.03]


def test_controller_without_a_plan_holds_its_angle() -> None:
    ladder, controller = scripted()
    controller.says = controller.says._replace(angles=None, steering=0.2)
    ladder.answer(at(0), ROAD, 0.0, 0)
    assert ladder.advance(STATE_LATE, 0.2, ns(0.3)).steering == 0.2


def test_late_state_without_a_plan_leads_to_the_stop() -> None:
    ladder, controller = scripted()
    assert ladder.advance(STATE_LATE, 0.0, ns(0.3)).rung == STOP
    ladder.answer(at(0), ROAD, 0.0, 0)
    controller.says = controller.says._replace(diagnosis=FAILED)
    assert ladder.answer(at(ns(2.0)), ROAD, 0.0, ns(2.0)).rung == FEED_FORWARD
    answer = ladder.advance(STATE_LATE, 0.0, ns(2.3))
    assert (answer.rung, answer.reason) == (STOP, STATE_LATE)


def test_solver_that_works_again_leads_back_to_the_top() -> None:
    ladder, controller = scripted()
    works = controller.says
    for k, rung in enumerate([OPTIMAL, *[SHIFTED_PLAN] * 5, FEED_FORWARD, FEED_FORWARD, OPTIMAL]):
        controller.says = works if rung == OPTIMAL else works._replace(diagnosis=FAILED)
        assert ladder.answer(at(ns(0.1 * k)), ROAD, 0.0, ns(0.1 * k)).rung == rung


def test_standing_car_does_not_turn_its_wheel_on_the_rung_of_the_feed_forward() -> None:
    for v_x, holds in ((HOLD_BELOW * 0.999, True), (HOLD_BELOW, False), (0.0, True)):
        ladder, controller = scripted()
        controller.says = controller.says._replace(diagnosis=FAILED)
        answer = ladder.answer(at(0, v_x, y=0.5), ROAD, 0.123, 0)
        assert answer.rung == FEED_FORWARD
        assert (answer.steering == 0.123) is holds


@pytest.mark.parametrize("in_force", [-0.5, 0.0, 0.005, 0.01, 0.5])
def test_stop_turns_the_wheel_to_the_planned_angle_at_a_bounded_rate(in_force: float) -> None:
    ladder, controller = scripted()
    controller.says = controller.says._replace(angles=None)
    ladder.answer(at(0), ROAD, 0.0, 0)
    angle, step = in_force, STOP_RATE * 0.1
    for k in range(60):
        answer = ladder.stop(STATE_LOST, angle, ns(1.0 + 0.1 * k))
        assert (answer.rung, answer.reason) == (STOP, STATE_LOST)
        assert abs(answer.steering - angle) <= step * (1 + 1e-12)
        angle = answer.steering
    assert angle == 0.01


def test_stop_goes_on_along_the_plan_and_then_holds_its_end() -> None:
    ladder, _ = scripted()
    ladder.answer(at(0), ROAD, 0.0, 0)
    assert ladder.stop(STATE_LOST, 0.065, ns(0.6)).steering == 0.07
    assert ladder.stop(STATE_LOST, 0.08, ns(60.0)).steering == 0.08


def test_stop_after_the_feed_forward_keeps_its_angle() -> None:
    ladder, controller = scripted()
    controller.says = controller.says._replace(diagnosis=FAILED)
    angle = ladder.answer(at(0, y=0.5), ROAD, 0.0, 0).steering
    assert angle < -0.001
    assert ladder.stop(STATE_LOST, angle, ns(1.0)).steering == angle


REFUSALS = [  # v_x [m/s], heading and cross-track error, reason
    (9.0, 0.0, 0.0, NO_REASON),
    (9.0, 0.0, MAX_PROJECTION_DISTANCE, NO_REASON),
    (9.0, 0.0, np.nextafter(MAX_PROJECTION_DISTANCE, 100), OFF_PATH),
    (9.0, 0.0, -np.nextafter(MAX_PROJECTION_DISTANCE, 100), OFF_PATH),
    (9.0, math.pi / 2, 0.0, NO_REASON),
    (9.0, np.nextafter(math.pi / 2, 4), 0.0, AGAINST_PATH),
    (9.0, -np.nextafter(math.pi / 2, 4), 0.0, AGAINST_PATH),
    (HOLD_BELOW, math.pi, 0.0, AGAINST_PATH),
    (np.nextafter(HOLD_BELOW, 0), math.pi, 0.0, NO_REASON),
    (REVERSE_BELOW, 0.0, 0.0, NO_REASON),
    (np.nextafter(REVERSE_BELOW, -1), 0.0, 0.0, BACKWARDS),
    (9.0, math.nan, math.nan, NO_REASON),
]


@pytest.mark.parametrize(("v_x", "heading", "across", "reason"), REFUSALS)
def test_what_cannot_be_steered_is_refused_at_its_threshold(
    v_x: float, heading: float, across: float, reason: int
) -> None:
    assert refusal(at(0, v_x), Diagnosis(across, heading)) == reason


@every_controller
def test_every_controller_is_stopped_where_it_cannot_steer(name: str) -> None:
    for reason, state in (
        (BACKWARDS, at(NANOSECONDS, v_x=-1.0)),
        (AGAINST_PATH, at(NANOSECONDS, yaw=3.0)),
        (OFF_PATH, at(NANOSECONDS, y=MAX_PROJECTION_DISTANCE + 1.0)),
    ):
        config = made_for("paper", name)
        ladder = FallbackChain(config, build_controller(config))
        answer = ladder.answer(state, ROAD, 0.1, NANOSECONDS)
        assert (answer.rung, answer.reason) == (STOP, reason)
        assert answer.steering == pytest.approx(0.1 - STOP_RATE * 0.1)


@every_controller
def test_angle_that_is_no_number_is_not_used_and_the_next_good_state_is_answered_as_ever(
    name: str,
) -> None:
    config = made_for("paper", name)
    ladder, fresh = (FallbackChain(config, build_controller(config)) for _ in range(2))
    ladder.answer(at(0, y=0.3), ROAD, 0.0, 0)
    in_force = ladder.controller.steering
    answer = ladder.answer(at(ns(0.1), y=math.nan), ROAD, in_force, ns(0.1))
    assert answer.rung in (SHIFTED_PLAN, OPTIMAL)
    if answer.rung == SHIFTED_PLAN:
        assert answer.reason == QP_NOT_SOLVED
        assert answer.plan.diagnosis.converged == 0.0
        fresh.controller.reset(in_force)
    assert math.isfinite(answer.steering)
    good = at(ns(0.2), y=0.3)
    again = ladder.answer(good, ROAD, in_force, ns(0.2))
    assert again.rung == OPTIMAL
    assert math.isfinite(again.steering)
    if answer.rung == SHIFTED_PLAN:
        assert again.steering == fresh.answer(good, ROAD, in_force, ns(0.2)).steering


@pytest.mark.parametrize("what", ["plan", "prediction", "steering"])
def test_what_is_no_number_is_neither_used_nor_told(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ladder = FallbackChain(config := made_for(), build_controller(config))
    ladder.answer(at(0, y=0.3), ROAD, 0.0, 0)
    good = ladder.controller.step(at(ns(0.1), y=0.3), ROAD)
    bad = {
        "plan": good._replace(angles=np.array([math.nan])),
        "prediction": good._replace(prediction=np.array([[0.0, math.nan]])),
        "steering": good._replace(steering=math.nan),
    }[what]
    monkeypatch.setattr(ladder.controller, "step", lambda state, path: bad)
    answer = ladder.answer(at(ns(0.1), y=0.3), ROAD, 0.0, ns(0.1))
    assert (answer.rung, answer.reason) == (SHIFTED_PLAN, QP_NOT_SOLVED)
    assert math.isfinite(answer.steering)
    assert answer.plan.angles is None
    assert answer.plan.prediction is None


def test_soft_lane_that_is_left_is_told_as_slack() -> None:
    config = made_for()
    narrow = config._replace(settings=replace(config.settings, max_output_error=0.2))
    run = supervised(Trial("straight", speed=9.0, offset=1.5), narrow)
    assert run.rungs[0] == SLACK
    assert run.records[0].command.reason == SLACK_IN_USE
    assert run.rungs[-1] == OPTIMAL
    assert set(run.rungs) == {OPTIMAL, SLACK}


COSTS = [  # speed [m/s], failed ticks, largest difference to the drive without a fault [m]
    (9.0, 1, 0.001),
    (9.0, 3, 0.004),
    (9.0, 5, 0.012),
    (15.0, 1, 0.02),
    (15.0, 3, 0.05),
    (15.0, 5, 0.10),
]


@both_cars
@pytest.mark.parametrize(("speed", "ticks", "most"), COSTS)
def test_shifted_plan_is_nearly_what_the_solver_would_have_said_in_a_lane_change(
    car: str, speed: float, ticks: int, most: float
) -> None:
    trial = Trial("sc1", car, speed)
    for begin in np.arange(2.0, 12.0, 1.0) * 9.0 / speed:
        t = round(begin, 1)
        run = supervised(trial, made_for(car), unsolved=between(t, t + 0.1 * ticks))
        assert run.rungs.count(SHIFTED_PLAN) == ticks
        assert set(run.rungs) == {OPTIMAL, SHIFTED_PLAN}
        assert added(trial, run) < most


@every_rate
@pytest.mark.parametrize("failed", [0.5, 0.6, 2.0])
def test_failing_solver_goes_by_plan_then_by_feed_forward_at_each_rate(
    rate: int, failed: float
) -> None:
    trial, config = Trial("sc1", speed=9.0), made_for("paper", "preview", **HZ[rate])
    run = supervised(trial, config, unsolved=between(4.0, 4.0 + failed))
    assert run.rungs.count(SHIFTED_PLAN) == round(PLAN_TIME * rate)
    assert run.rungs.count(FEED_FORWARD) == round((failed - PLAN_TIME) * rate)
    assert added(trial, run, "preview", **HZ[rate]) < 0.05


@every_rate
def test_lost_state_goes_by_plan_then_to_the_stop_at_each_rate(rate: int) -> None:
    trial, config = Trial("sc1", speed=9.0), made_for("paper", "preview", **HZ[rate])
    run = supervised(trial, config, blind=between(4.0, 5.0))
    last = 4.0 - 1.0 / rate
    late = [
        t
        for t, told in zip(run.times, run.records, strict=True)
        if told.command.reason == STATE_LATE
    ]
    lost = [
        t
        for t, told in zip(run.times, run.records, strict=True)
        if told.command.reason == STATE_LOST
    ]
    assert last + 0.2 < late[0] <= last + 0.2 + 1.01 / rate
    assert last + 0.5 < lost[0] <= last + 0.5 + 1.01 / rate
    assert lost[-1] == pytest.approx(5.0 - 1.0 / rate)
    assert run.records[-1].stop_requested == 1.0
    assert added(trial, run, "preview", **HZ[rate]) < 0.2


BLIND = [("circle", 9.0, 1.0, 0.01), ("circle", 9.0, 2.0, 0.03), ("sc1", 9.0, 0.3, 0.07),
         ("sc1", 9.0, 1.0, 0.20), ("sc1", 9.0, 2.0, 0.50)]  # fmt: skip


@both_cars
@pytest.mark.parametrize(("name", "speed", "time", "most"), BLIND)
def test_car_that_goes_blind_stays_near_its_path(
    car: str, name: str, speed: float, time: float, most: float
) -> None:
    trial = Trial(name, car, speed)
    for begin in (2.0, 3.4, 4.8, 6.2, 7.6, 9.0):
        run = supervised(trial, made_for(car), blind=between(begin, begin + time))
        assert added(trial, run) < most


@pytest.mark.parametrize("name", ["preview", "paper", "classic", "pure_pursuit"])
def test_every_controller_survives_a_failing_solver_and_a_lost_state(name: str) -> None:
    trial = Trial("sc1", speed=9.0)
    for lowest in (FEED_FORWARD, STOP):
        unsolved = between(4.0, 6.0) if lowest == FEED_FORWARD else never
        blind = between(4.0, 5.0) if lowest == STOP else never
        run = supervised(trial, made_for("paper", name), blind, unsolved)
        assert max(run.rungs) == lowest
        assert np.abs(run.driven.error).max() < np.abs(driven(trial, name).driven.error).max() + 1.0
        assert run.rungs[-1] == OPTIMAL


@every_controller
@given(
    y=st.floats(-3.0, 3.0), yaw=st.floats(-0.5, 0.5), v_x=st.floats(0.0, 25.0),
    faults=st.lists(st.sampled_from(["none", "qp", "late", "lost", "off"]), max_size=12),
)  # fmt: skip
@settings(max_examples=25, deadline=None, derandomize=True)
def test_mirrored_inputs_go_down_the_same_rungs_to_mirrored_angles(
    name: str, y: float, yaw: float, v_x: float, faults: list[str]
) -> None:
    left, right = (climb(name, faults, side, (y, yaw, v_x)) for side in (1.0, -1.0))
    assert [each[:2] for each in left] == [each[:2] for each in right]
    exact = name in ("preview", "pure_pursuit")  # the paper's active rows round by their order
    there, back = ([each[2] for each in way] for way in (left, right))
    assert there == pytest.approx([-angle for angle in back], rel=0, abs=0.0 if exact else 1e-9)


@cache
def at_rest(name: str) -> Supervisor:
    """Make a supervisor, once."""
    return Supervisor(made_for("paper", name))


def climb(
    name: str, faults: list[str], side: float, start: tuple[float, float, float]
) -> list[tuple[float, float, float]]:
    """Return rung, reason and angle of each tick of a sequence of faults, left or right."""
    supervisor = at_rest(name)
    supervisor.restart(0.0)
    y, yaw, v_x = start
    bend = np.array([(s, 2.0 * math.sin(s / 30.0)) for s in np.arange(0.0, 300.0, 2.0)])
    supervisor.take_path(bend * [1.0, side], NANOSECONDS, NANOSECONDS)
    told: list[tuple[float, float, float]] = []
    for k, fault in enumerate(["none", *faults, "none"]):
        now_ns = NANOSECONDS + ns(0.1 * k)
        supervisor.inject_qp_fault(fault == "qp")
        away = MAX_PROJECTION_DISTANCE + 10.0 if fault == "off" else 0.0
        state = VehicleState(
            now_ns, 20.0 + 0.1 * v_x * k, side * (y + away), side * yaw, v_x, 0.0, 0.0
        )
        age = {"late": 0.3, "lost": 0.6}.get(fault, 0.0)
        supervisor.replay_state(received(state, age), supervisor.resets)
        decision = supervisor.tick(now_ns)
        assert decision is not None
        command = decision.command
        told.append((command.rung, command.reason, command.steering))
    return told


def received(state: VehicleState, age: float) -> Received[VehicleState]:
    """Return a state that came in some time ago [s]."""
    return Received(state, state.stamp_ns - ns(age), state.stamp_ns - ns(age))
