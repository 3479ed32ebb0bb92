"""Fault matrix: simulated timing, recovery from every fault, and the report."""

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config.metrics import LOST
from ampc_msgs_config.types import RUNGS, STOP
from launch_scripts.faults.schedule import Fault
from tests.workshop.fault_matrix import inject_cases
from tests.workshop.fault_matrix.fault_loop import Log
from tests.workshop.fault_matrix.inject import main
from tests.workshop.fault_matrix.inject_cases import (
    CASES,
    UNAVOIDABLE,
    Unavoidable,
    load_course,
    mirrored,
)
from tests.workshop.fault_matrix.inject_cells import Bench, Cell, Conditions, Course, evaluate_cell

BY_NAME = {case.name: case for case in CASES}
MIRRORED = (
    "half of odom lost",
    "jitter 0-200 ms",
    "pose frozen for 0.4 s",
    "noise 0.1 m, 0.6 deg",
    "heading 3 deg off",
    "position jumps by 2 m",
    "simulator gone for 2 s",
    "steering sensor 3 deg off",
    "QP fails for 3 s",
    "path 2 m aside",
    "path zigzags by 1 m",
)
SAME = 1.0e-9
"""Effect of rounding after 20 s of feedback [m] and [rad]."""


@cache
def bench(vehicle: str = "paper") -> Bench:
    """Return car and controller."""
    return Bench(Conditions(vehicle=vehicle))


@cache
def course(name: str = "sc1") -> Course:
    """Return a road with its drive without a fault."""
    return bench().course(load_course(name, bench().vehicle.size))


@cache
def cell(name: str, road: str = "sc1") -> Cell:
    """Return the cell of a fault on a road."""
    return bench().cell(BY_NAME[name], course(road))


def test_without_a_fault_nothing_is_rejected_missed_clipped_or_from_a_fallback() -> None:
    log = course("sc1").free
    assert not log.rejected
    assert not log.clips
    assert log.missed == 0
    assert {tick.record.command.rung for tick in log.ticks} == {0.0}
    assert np.diff([tick.time for tick in log.ticks]) == pytest.approx(0.1)
    assert abs(log.error).max() < 0.02


def test_a_drive_is_repeated_bit_for_bit() -> None:
    fault = replace(BY_NAME["jitter 0-200 ms"].fault, start=3.0)
    once, again = (bench().log(course().scenario, fault) for _ in range(2))
    assert np.array_equal(once.error, again.error)
    assert [t.record.command.steering for t in once.ticks] == [
        t.record.command.steering for t in again.ticks
    ]


@pytest.mark.parametrize("name", BY_NAME)
def test_the_car_recovers_from_every_fault_of_the_matrix(name: str) -> None:
    found = cell(name)
    assert not found.fails
    assert found.recovery < 5.0
    assert found.max_error < 2.5
    assert not found.clips


@pytest.mark.parametrize("road", ["sc1", "straight_3m"])
@pytest.mark.parametrize("name", MIRRORED)
def test_left_and_right_are_mirror_images(name: str, road: str) -> None:
    scenario = course(road).scenario
    fault = replace(BY_NAME[name].fault, start=course(road).start)
    left = bench().log(scenario, fault)
    right = bench().log(mirrored(scenario), fault.mirrored)
    assert right.error == pytest.approx(-left.error, abs=SAME)
    assert right.rejected == left.rejected
    for a, b in zip(left.ticks, right.ticks, strict=True):
        assert a.record.command.steering == pytest.approx(-b.record.command.steering, abs=SAME)
        assert a.record.command[4:7] == b.record.command[4:7]
        assert a.record[1:5] == b.record[1:5]


def test_the_rungs_and_reasons_of_a_fault_are_counted() -> None:
    gone = cell("simulator gone for 2 s")
    assert set(gone.reasons) == {"state_late", "state_lost"}
    assert gone.rungs["stop"] == pytest.approx(1.5)
    assert gone.stop_requested
    assert cell("QP fails for 0.3 s").rungs["shifted_plan"] == pytest.approx(0.3)
    assert cell("QP fails for 3 s").rungs["feed_forward"] == pytest.approx(2.5)
    assert cell("planner gone for 5 s").reasons == ("path_lost",)
    assert sum(cell("odom lost for 0.4 s").rungs.values()) == pytest.approx(
        course().scenario.duration - course().start, abs=0.3
    )
    assert set(cell("odom lost for 0.4 s").rungs) == set(RUNGS)


REJECTED = {
    "x is NaN for 0.4 s": {"not_finite": 20},
    "wrong frame for 0.4 s": {"wrong_frame": 20},
    "zero quaternion, 0.4 s": {"no_rotation": 20},
    "stamps 1 s ahead, 0.4 s": {"in_the_future": 20},
    "every odom twice": {"duplicate": 250},
    "empty path": {},  # it means that there is no path
    "path zigzags by 1 m": {"reference_path": 6},
}


@pytest.mark.parametrize("name", REJECTED)
def test_rejected_inputs_are_counted_by_cause(name: str) -> None:
    assert cell(name).rejected == REJECTED[name]


def test_a_queue_of_old_states_changes_no_command() -> None:
    assert cell("queue of 1000 old odom").max_error == cell("queue of 1000 old odom").free_error
    assert cell("queue of 1000 old odom").resets == 0


def test_a_driver_who_obeys_the_stop_request_stops() -> None:
    obedient = Bench(Conditions(obey=True))
    fault = Fault(kind="silence", start=3.0, duration=1.0)
    drive = obedient.drive(course().scenario, (fault,))
    drive.run(course().scenario.duration)
    assert drive.simulation.car.state[3] < 0.2
    assert max(abs(drive.log().error)) < 0.3


def log_with(error: list[float], rungs: list[int]) -> Log:
    """Return a log of 10 s with the given errors and rungs at each second."""
    whole = course().free
    ticks = []
    for i, rung in enumerate(rungs):
        record = whole.ticks[i].record
        record = record._replace(command=record.command._replace(rung=rung))
        ticks.append(whole.ticks[i]._replace(time=float(i), record=record))
    time = np.arange(10, dtype=np.float64)
    speed = np.full(10, 9.0)
    return whole._replace(time=time, error=np.array(error), speed=speed, ticks=ticks)


@pytest.mark.parametrize(
    ("error", "rungs", "outcome"),
    [
        ([0.0] * 10, [0] * 10, "0.0 s"),
        ([0.0] * 10, [0, 0, STOP, STOP, 0, 0, 0, 0, 0, 0], "0.0 s"),
        ([0.0] * 10, [0, 0, STOP, STOP, STOP, 0, 0, 0, 0, 0], "1.0 s"),
        ([0.0, 0.0, 0.0, 5.0, -2.0, -0.11, 0.1, 0.0, 0.0, 0.0], [0] * 10, "2.0 s"),
        ([0.0] * 9 + [0.2], [0] * 10, "not recovered"),
        ([0.0, 0.0, 0.0, 5.0, -LOST - 0.01, 5.0, 0.0, 0.0, 0.0, 0.0], [0] * 10, "lost at 4.0 s"),
        ([0.0, 0.0, 0.0, math.nan, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0], [0] * 10, "lost at 3.0 s"),
    ],
)
def test_the_outcome_of_a_drive_follows_from_its_errors_and_rungs(
    error: list[float], rungs: list[int], outcome: str
) -> None:
    free = log_with([0.0] * 10, [0] * 10)
    fault = Fault(kind="silence", start=2.0, duration=1.0)
    found = evaluate_cell("x", Course(course().scenario, 2.0, free), fault, log_with(error, rungs))
    assert found.outcome == outcome
    assert found.fails == (not outcome.endswith("0 s") or outcome.startswith("lost"))


def test_an_unavoidable_loss_has_a_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert not UNAVOIDABLE  # by the default controller
    known = (Unavoidable("x", ("sc1",), "because"),)
    monkeypatch.setattr(inject_cases, "UNAVOIDABLE", known)
    free = log_with([0.0] * 10, [0] * 10)
    lost = log_with([0.0] * 5 + [20.0] * 5, [0] * 10)
    fault = Fault(kind="silence", start=2.0, duration=1.0)
    found = evaluate_cell("x", Course(course().scenario, 2.0, free), fault, lost)
    assert found.allowed_reason == "because"
    assert not found.kept
    assert not found.fails


def test_the_command_writes_numbers_and_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ["odom lost for 0.4 s", "path 2 m aside"]
    given = ["--faults", *names, "--scenarios", "sc1", "circle", "--output", str(tmp_path)]
    assert main(given) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in names)
    content = json.loads((tmp_path / "faults.json").read_text(encoding="utf-8"))
    assert [(each["case"], each["scenario"]) for each in content["cells"]] == [
        (name, road) for name in names for road in ("sc1", "circle")
    ]
    assert content["cells"][0]["max_error"] == cell(names[0]).max_error
    assert content["faults"][names[1]] == {"kind": "path_shift", "duration": 3.0, "amount": 2.0}
    assert "| path 2 m aside | 2.17 m, 3.2 s |" in (tmp_path / "faults.md").read_text("utf-8")
    assert (tmp_path / "faults.png").read_bytes().startswith(b"\x89PNG")


def test_a_car_that_does_not_recover_makes_the_command_fail(tmp_path: Path) -> None:
    given = ["--controller", "classic", "--faults", "position drifts by 1 m"]
    assert main([*given, "--scenarios", "sc1", "--output", str(tmp_path)]) == 1
    assert "not allowed" in (tmp_path / "faults.md").read_text("utf-8")


WRONG = {
    "--faults: 'fire' must be one of odom lost": ["--faults", "fire"],
    "--scenarios nowhere: 'nowhere' is neither a file nor": ["--scenarios", "nowhere"],
    "'no car' is neither a file nor": ["--vehicle", "no car"],
    "--seed = -1 must lie in": ["--seed", "-1"],
    "'soft' is neither a file nor one of the shipped guards": ["--guard", "soft"],
}


@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_option_is_named(message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(WRONG[message]) == 2
    assert message in " ".join(capsys.readouterr().out.split())
