"""Health: every sentence at its level, and the numbers beside it."""

import math
import re
from typing import Any, NamedTuple

import numpy as np
import pytest

from ampc_msgs_config.types import (
    ERROR,
    FEED_FORWARD,
    LIMITS,
    MODES,
    NANOSECONDS,
    OK,
    REASONS,
    RECORD_QUANTITIES,
    RUNGS,
    SHIFTED_PLAN,
    SLACK,
    STALE,
    STOP,
    WARN,
    Diagnosis,
    TickRecord,
    VehicleState,
)
from ampc_ros.supervision.fallback import OFF_PATH
from ampc_ros.supervision.health import Health, health, health_numbers
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Supervisor
from tests.supervised import made_for

ROAD = np.array([(x, 0.0) for x in np.arange(0.0, 400.0, 5.0)])
NOW = 10 * NANOSECONDS


class Case(NamedTuple):
    """A supervisor with one good decision."""

    supervisor: Supervisor
    decision: TickRecord


def good(v_x: float = 9.0, **choices: object) -> Case:
    """Return a supervisor that has steered once, and what it decided."""
    supervisor = Supervisor(made_for(**choices))
    supervisor.take_path(ROAD, NOW, NOW)
    supervisor.take_state(VehicleState(NOW, 50.0, 0.1, 0.0, v_x, 0.0, 0.0), NOW)
    decision = supervisor.tick(NOW)
    assert decision is not None
    return Case(supervisor, decision)


def told(decision: TickRecord, **changed: Any) -> TickRecord:
    """Return a decision about which something else is told."""
    return decision._replace(command=decision.command._replace(**changed))


def diagnosed(decision: TickRecord, diagnosis: Diagnosis) -> TickRecord:
    """Return a record with another diagnosis."""
    command = decision.command
    return decision._replace(
        command=command._replace(plan=command.plan._replace(diagnosis=diagnosis))
    )


def test_good_decision_is_in_order() -> None:
    supervisor, decision = good()
    assert health(supervisor, decision, NOW) == Health(OK, "")


def test_what_is_missing_is_waited_for() -> None:
    supervisor = Supervisor(made_for())
    assert health(supervisor, None, NOW) == Health(STALE, "waiting for odom")
    supervisor.take_state(VehicleState(NOW, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0), NOW)
    assert health(supervisor, None, NOW) == Health(WARN, "waiting for reference_path")
    supervisor.take_path(ROAD, NOW, NOW)
    assert health(supervisor, None, NOW) == Health(OK, "")


@pytest.mark.parametrize(("age", "level"), [(0.5 - 1e-9, OK), (0.5, OK), (0.5 + 1e-9, STALE)])
def test_lost_state_is_stale(age: float, level: int) -> None:
    supervisor, decision = good()
    said = health(supervisor, decision, NOW + round(age * NANOSECONDS))
    assert said.level == level
    assert said.sentence == ("odom is 0.5 s old: a stop is requested" if level else "")


PATH_AGES = [
    (0.9, OK, "^$"),
    (0.9 + 1e-9, WARN, r"reference_path is 0\.9 s old$"),
    (2.0, WARN, r"reference_path is 2\.0 s old$"),
    (2.0 + 1e-9, ERROR, r"reference_path is 2\.0 s old: a stop is requested; .*static_path = true"),
]


@pytest.mark.parametrize(("age", "level", "sentence"), PATH_AGES)
def test_old_path_warns_and_then_is_an_error(age: float, level: int, sentence: str) -> None:
    supervisor, decision = good(static_path=False)
    assert supervisor.path
    old = supervisor.path.value, NOW - round(age * NANOSECONDS), NOW
    supervisor.follow(*old)
    now = health(supervisor, decision, NOW)
    assert now.level == level
    assert re.match(sentence, now.sentence)
    static, _ = good()
    static.follow(*old)
    assert health(static, decision, NOW) == Health(OK, "")


@pytest.mark.parametrize("reason", range(1, len(REASONS)))
@pytest.mark.parametrize(("rung", "level"), [(SLACK, WARN), (SHIFTED_PLAN, WARN),
                                             (FEED_FORWARD, ERROR), (STOP, ERROR)])  # fmt: skip
def test_lower_rungs_are_told_with_their_reason(rung: int, level: int, reason: int) -> None:
    supervisor, decision = good()
    said = health(supervisor, told(decision, rung=rung, reason=reason), NOW)
    if reason == OFF_PATH and rung != STOP:  # an error whatever the solver's status
        assert said.level == ERROR
        assert said.sentence.startswith("off_path: ")
        assert said.sentence.endswith(": a stop is requested")
        return
    assert said.level == level
    assert re.search(f"{RUNGS[rung]}, .*{REASONS[reason]}", said.sentence)
    assert said.sentence.endswith(": a stop is requested") is (rung == STOP)


@pytest.mark.parametrize("limit", range(1, len(LIMITS)))
def test_guard_that_clips_warns(limit: int) -> None:
    supervisor, decision = good()
    said = health(supervisor, told(decision, clipped=limit), NOW)
    assert said == Health(WARN, f"the guard clips the command: {LIMITS[limit]}")


@pytest.mark.parametrize("mode", range(len(MODES)))
def test_place_on_the_path_warns_where_it_is_out_of_order(mode: int) -> None:
    supervisor, decision = good()
    diagnosis = decision.command.plan.diagnosis._replace(mode=float(mode))
    decision = diagnosed(decision, diagnosis)
    said = health(supervisor, decision, NOW)
    assert said == (Health(WARN, MODES[mode]) if mode > 1 else Health(OK, ""))


def test_speed_outside_the_gain_table_is_told_by_how_far() -> None:
    supervisor, decision = good()
    axis = supervisor.config.gains["speed"]
    for v_x, off in ((axis[-1] + 2.0, 2.0), (axis[0] - 0.5, 0.5)):
        state = VehicleState(NOW, 50.0, 0.0, 0.0, v_x, 0.0, 0.0)
        supervisor.replay_state(Received(state, NOW, NOW), 0)
        outside = decision.command.plan.diagnosis._replace(outside_table=1.0)
        said = health(supervisor, diagnosed(decision, outside), NOW)
        assert said.level == WARN
        for number in (f"{v_x:.1f} m/s", f"{off:.1f} m/s", f"{axis[0]:g} to {axis[-1]:g} m/s"):
            assert number in said.sentence


def test_reference_outside_the_gain_table_is_told() -> None:
    supervisor, decision = good()
    outside = decision.command.plan.diagnosis._replace(outside_table=1.0)
    said = health(supervisor, diagnosed(decision, outside), NOW)
    assert said == Health(WARN, "lateral reference outside the gain table: nearest edge in use")


def test_request_to_stop_that_is_over_is_remembered() -> None:
    supervisor, decision = good()
    supervisor.tick(NOW + NANOSECONDS)  # the state is lost
    assert supervisor.stop_requested
    said = health(supervisor, decision, NOW)
    assert said.level == WARN
    assert "~/reset_stop" in said.sentence


def test_worst_is_said_and_the_first_of_equals() -> None:
    supervisor, decision = good()
    supervisor.tick(NOW + NANOSECONDS)  # the state is lost
    assert supervisor.stop_requested
    both = told(decision, rung=STOP, reason=9, clipped=2)
    assert health(supervisor, both, NOW).level == ERROR
    assert re.search("stop, .*driving_backwards", health(supervisor, both, NOW).sentence)
    equals = told(decision, rung=SLACK, reason=1, clipped=2)
    assert "slack" in health(supervisor, equals, NOW).sentence


def test_numbers_are_those_of_the_tick_and_all_counts() -> None:
    supervisor, decision = good()
    supervisor._clips["rate"] = 3
    with pytest.raises(ValueError, match="must be finite"):
        supervisor.take_state(VehicleState(NOW + 1, math.nan, 0.0, 0.0, 9.0, 0.0, 0.0), NOW)
    values = health_numbers(supervisor, decision)
    assert set(RECORD_QUANTITIES) <= values.keys()
    assert (values["clipped_rate"], values["rejected_not_finite"]) == (3, 1)
    assert "clipped_angle" not in values
    assert health_numbers(supervisor, None) == {"clipped_rate": 3, "rejected_not_finite": 1}
