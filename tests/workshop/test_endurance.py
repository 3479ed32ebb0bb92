"""Endurance test of two minutes: counts and failed conditions."""

import csv
import math
from itertools import pairwise
from pathlib import Path

import pytest
from rich.console import Console

from ampc_ros.supervision.guard import Guard
from tests.workshop.fault_matrix.endurance import (
    GROWTH,
    PAUSE,
    PIECE,
    EnduranceResult,
    Minute,
    drive_for,
    is_inside,
    main,
    random_faults,
)
from tests.workshop.fault_matrix.fault_loop import CommandedTick
from tests.workshop.fault_matrix.inject_cases import load_course
from tests.workshop.fault_matrix.inject_cells import Bench, Conditions


@pytest.fixture(scope="module")
def circuit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an oval of 600 m as a CSV file."""
    file = tmp_path_factory.mktemp("tracks") / "oval.csv"
    corners = [(150.0 * math.cos(0.02 * math.pi * i), 60.0 * math.sin(0.02 * math.pi * i))
               for i in range(101)]  # fmt: skip
    with file.open("w", encoding="utf-8", newline="") as text:
        csv.writer(text).writerows([("x_m", "y_m"), *corners])
    return file


def test_two_minutes_with_faults_keep_to_all_limits(
    circuit: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--hours", "0.033", "--path", str(circuit), "--seed", "2"]) == 0
    shown = capsys.readouterr().out
    assert "missed ticks" in shown
    assert "does not hold" not in shown


def test_faults_are_drawn_by_seed_with_pauses_and_to_both_sides() -> None:
    faults = random_faults(3600.0, 1)
    assert faults == random_faults(3600.0, 1) != random_faults(3600.0, 2)
    assert len(faults) > 100
    for one, other in pairwise(faults):
        pause = other.start - one.start - one.duration
        assert PAUSE[0] - 0.002 <= pause <= PAUSE[1] + 0.002
    assert faults[-1].start + faults[-1].duration <= 3600.0
    jumps = [fault.amount or 0.0 for fault in faults if fault.kind == "bias_heading"]
    assert min(jumps) < 0 < max(jumps)


def account(*minutes: Minute, missed: int = 0) -> EnduranceResult:
    """Return the result of some minutes."""
    return EnduranceResult(minutes, 0, 0, missed, 600 * len(minutes))


GOOD = Minute(100.0, 0.5, 600, 0, 3)


def test_failed_conditions_are_listed() -> None:
    assert account(*[GOOD] * 10).failures == []
    assert account(GOOD, missed=1).failures == ["1 ticks missed"]
    outside = account(GOOD, GOOD._replace(outside=2)).failures
    assert outside == ["2 commands outside the limits"]
    for error in (10.1, math.nan):
        assert account(GOOD._replace(error=error)).failures[0].startswith("the car was")


@pytest.mark.parametrize(("growth", "flat"), [(GROWTH - 0.01, True), (GROWTH, False)])
def test_memory_may_grow_before_minute_five_and_less_than_5_mb_after_it(
    growth: float, flat: bool
) -> None:
    later = [GOOD._replace(memory=120.0)] * 3 + [GOOD._replace(memory=120.0 + growth)]
    assert (account(*[GOOD] * 4, *later).failures == []) == flat


def test_a_command_outside_the_limits_is_detected() -> None:
    drive = Bench(Conditions()).drive(load_course("sc1", Bench(Conditions()).vehicle.size), ())
    drive.run(1.0)
    config, tick = drive.supervisor.config, drive.ticks[-1]
    guard = Guard(config.guard, config.chassis, drive.supervisor.period)

    def with_angle(angle: float) -> CommandedTick:
        command = tick.record.command._replace(steering=angle)
        return tick._replace(record=tick.record._replace(command=command))

    assert is_inside(tick, guard, tick.record.command.steering)
    for angle, last in ((0.61, 0.61), (-0.61, -0.61), (math.nan, 0.0), (0.59, -0.1)):
        assert not is_inside(with_angle(angle), guard, last)


def test_wrong_options_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for given, message in (
        (["--hours", "0"], "--hours = 0.0 must lie in [0.01, 100] h"),
        (["--seed", "-1"], "--seed = -1 must lie in"),
        (["--path", str(tmp_path / "none.csv")], "cannot be read"),
    ):
        assert main(given) == 2
        assert message in " ".join(capsys.readouterr().out.split())


def test_a_result_covers_every_minute(circuit: Path) -> None:
    found = drive_for(PIECE, circuit, Conditions(seed=3), Console(quiet=True))
    assert len(found.minutes) == 1
    assert 580 <= found.minutes[0].commands <= found.expected == 600
    assert found.growth == 0.0
