"""A controller that raises: its fallbacks steer, a stop is requested, and the text is kept."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.types import (
    FEED_FORWARD,
    NANOSECONDS,
    OPTIMAL,
    REASONS,
    SHIFTED_PLAN,
    STOP,
    TickRecord,
    VehicleState,
)
from ampc_ros.controller_interface import Controller
from ampc_ros.supervision.fallback import CONTROLLER_FAULT
from ampc_ros.supervision.guard import bounds
from ampc_ros.supervision.supervisor import Supervisor
from tests.supervised import made_for

RADIUS, SPEED = 60.0, 9.0
ARC = np.array([(RADIUS * np.sin(a), RADIUS * (1.0 - np.cos(a))) for a in np.arange(0, 1.2, 0.02)])
TICK_NS = NANOSECONDS // 10


def state(tick: int) -> VehicleState:
    """Return the state on the arc at a tick."""
    a = SPEED * tick / 10 / RADIUS
    x, y = RADIUS * np.sin(a), RADIUS - RADIUS * np.cos(a)
    return VehicleState(tick * TICK_NS, float(x), float(y), a, SPEED, 0.0, SPEED / RADIUS)


def drive(supervisor: Supervisor, ticks: range) -> list[TickRecord]:
    """Drive along the arc in real time."""
    records = []
    for tick in ticks:
        supervisor.take_state(state(tick), tick * TICK_NS)
        record = supervisor.tick(tick * TICK_NS)
        assert record
        records.append(record)
    return records


def driving(controller: str = "preview") -> Supervisor:
    """Return a supervisor after a second on the arc."""
    supervisor = Supervisor(made_for(controller=controller))
    supervisor.take_path(ARC, 0, 0)
    drive(supervisor, range(1, 11))
    return supervisor


def raising(*_: Any, **__: Any) -> Any:
    """Raise what no code expects."""
    raise ZeroDivisionError("in the middle of a step")


PARTS = [name for name in vars(Controller) if callable(getattr(Controller, name))]
IN_A_TICK = ["step", "reset", "observe_steering", "take_over", "disturbance", "expect_after"]


@pytest.mark.parametrize("controller", ["preview", "paper", "pure_pursuit"])
def test_a_step_that_raises_counts_as_not_solved_and_requests_a_stop(
    controller: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor = driving(controller)
    assert not supervisor.stop_requested
    before = supervisor.steering
    monkeypatch.setattr(supervisor.controller, "step", raising)
    records = drive(supervisor, range(11, 41))
    assert {record.command.rung for record in records} <= {SHIFTED_PLAN, FEED_FORWARD}
    assert {record.command.reason for record in records} == {CONTROLLER_FAULT}
    assert records[0].stop_requested == 1.0
    assert supervisor.failure == (
        "the controller raised ZeroDivisionError: in the middle of a step"
    )
    angles = np.array([before, *(record.command.steering for record in records)])
    # The feed-forward gives about the angle of the arc: the car stays in its lane as it brakes.
    chassis = supervisor.config.chassis
    steady = (chassis.wheelbase + chassis.understeer_gradient * SPEED**2) / RADIUS
    assert 0.5 * steady < angles[-1] < 2.0 * steady
    assert np.abs(np.diff(angles)).max() <= limit(supervisor)


def limit(supervisor: Supervisor) -> float:
    """Return the largest step of the guard in one period [rad]."""
    bound = bounds(supervisor.config.guard, supervisor.config.chassis, SPEED)
    return min(bound.rate, bound.jerk) * supervisor.period + 1e-12


def test_a_controller_that_recovers_steers_again_and_the_stop_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    supervisor = driving()
    with monkeypatch.context() as patch:
        patch.setattr(supervisor.controller, "step", raising)
        drive(supervisor, range(11, 14))
    records = drive(supervisor, range(14, 30))
    assert records[-1].command.rung == OPTIMAL
    assert supervisor.failure == ""
    assert supervisor.stop_requested
    supervisor.clear_stop()
    assert drive(supervisor, range(30, 35))[-1].stop_requested == 0.0


def test_the_reason_is_the_last_one_of_the_table() -> None:
    assert REASONS[CONTROLLER_FAULT] == "controller_fault"
    assert len(REASONS) - 1 == CONTROLLER_FAULT


@pytest.mark.parametrize("part", IN_A_TICK)
def test_any_part_of_the_controller_may_raise_in_a_tick(
    part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert part in PARTS
    supervisor = driving()
    monkeypatch.setattr(supervisor.controller, part, raising)
    for tick in range(11, 25):
        supervisor.take_steering(supervisor.steering)
        before = supervisor.steering
        drive(supervisor, range(tick, tick + 1))
        assert abs(supervisor.steering - before) <= limit(supervisor)
    if part not in ("reset", "take_over"):  # those that every tick calls
        assert supervisor.stop_requested
        assert "ZeroDivisionError" in supervisor.failure


BROKEN: dict[str, Callable[[Supervisor], tuple[object, str]]] = {
    "prediction": lambda supervisor: (supervisor._present, "at"),
    "location": lambda supervisor: (supervisor._progress, "locate"),
    "monitor": lambda supervisor: (supervisor, "_monitor"),
}


@pytest.mark.parametrize("part", BROKEN)
def test_a_fault_beside_the_controller_uses_the_last_plan_and_then_stops(
    part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor = driving()
    monkeypatch.setattr(*BROKEN[part](supervisor), raising)
    records = drive(supervisor, range(11, 31))
    rungs = [record.command.rung for record in records]
    assert rungs[0] == SHIFTED_PLAN
    # a fault behind the controller leaves a new plan in every tick
    assert rungs[-1] == (SHIFTED_PLAN if part == "monitor" else STOP)
    assert sorted(rungs) == rungs
    assert all(record.stop_requested == 1.0 for record in records)
    assert "the controller failed: ZeroDivisionError" in supervisor.failure
    steps = np.diff([record.command.steering for record in records])
    assert np.abs(steps).max() <= limit(supervisor)
