"""Hostile inputs through the node's core: a small run of it, and that it finds what is broken."""

import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest

from ampc_msgs_config.types import REASONS, RUNGS, Plan, TickRecord
from ampc_ros.supervision.fallback import FallbackChain
from ampc_ros.supervision.guard import Guard, GuardResult
from ampc_ros.supervision.supervisor import Supervisor
from tests.workshop.fuzz.fuzz import main
from tests.workshop.fuzz.fuzz_core import KINDS, core_drive
from tests.workshop.fuzz.fuzz_guard import Violation
from tests.workshop.fuzz.fuzz_messages import message_drive

FEW = 2000


def test_hostile_inputs_reach_every_rung_and_reason_and_break_no_promise() -> None:
    done = sum((core_drive(1, drive, FEW) for drive in range(8)), Counter[str]())
    assert sum(done[kind] for kind in KINDS) == 8 * FEW
    assert all(done[f"rung {rung}"] for rung in RUNGS)
    reached = set(REASONS) - {"controller_fault"}  # that is a violation here
    assert all(done[f"reason {reason}"] for reason in reached)
    assert all(done[f"{kind} refused"] for kind in ("state", "path"))
    assert done["recovered"] >= 12


def test_hostile_messages_break_no_promise() -> None:
    done = sum((message_drive(1, drive, FEW) for drive in range(2)), Counter[str]())
    assert all(done[f"{kind} refused"] for kind in ("state", "path", "steering"))
    assert done["recovered"] == 4


def test_a_drive_is_repeated_by_its_seed_and_number() -> None:
    assert core_drive(2, 3, 500) == core_drive(2, 3, 500) != core_drive(2, 4, 500)


Step = Callable[..., GuardResult]
Tick = Callable[..., TickRecord | None]


def with_guarded(change: Callable[[GuardResult, float], GuardResult]) -> Any:
    """Return a guard's step whose result is changed, from the angle in force."""
    step = Guard.step

    def changed(self: Guard, *arguments: Any) -> GuardResult:
        last = self.steering
        guarded = change(step(self, *arguments), last)
        self.steering = guarded.steering
        return guarded

    return changed


def jumped(good: GuardResult, last: float) -> GuardResult:
    """Move by more than a wheel can."""
    return good._replace(steering=last - math.copysign(0.14, last))


BROKEN_GUARDS = {
    "nan": (lambda good, _: good._replace(steering=math.nan), "is not finite"),
    "infinite rate": (lambda good, _: good._replace(steering_rate=math.inf), "is not finite"),
    "rate": (lambda good, _: good._replace(steering_rate=9.0), "rate 9.0 is beyond"),
    "angle": (lambda good, _: good._replace(steering=1.7), "angle 1.7 is beyond"),
    "jump": (jumped, "step from|is beyond"),
    "limit": (lambda good, _: good._replace(limit=7), "clipped = 7"),
}


@pytest.mark.parametrize("fault", BROKEN_GUARDS)
def test_a_broken_guard_is_found(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    change, said = BROKEN_GUARDS[fault]
    monkeypatch.setattr(Guard, "step", with_guarded(change))
    with pytest.raises(Violation, match=rf"input \d+.*({said})"):
        core_drive(1, 0, FEW)


def test_a_tick_that_raises_a_refusal_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> Plan:
        raise ValueError("no graph over its chord")

    monkeypatch.setattr(FallbackChain, "_step", refuse)
    with pytest.raises(Violation, match="a tick raises ValueError"):
        core_drive(1, 0, FEW)


def test_a_ladder_that_stays_down_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FallbackChain, "answer", lambda self, _, __, now: self.stop(7, now, 0))
    with pytest.raises(Violation):
        core_drive(1, 0, FEW)


def test_a_forgotten_request_to_stop_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    tick = Supervisor.tick

    def forgetful(self: Supervisor, now_ns: int) -> TickRecord | None:
        decision = tick(self, now_ns)
        self._stop.clear()
        self._stop.drive = bool(decision and decision.command.rung == 4)
        return decision

    monkeypatch.setattr(Supervisor, "tick", forgetful)
    with pytest.raises(Violation, match="the request to stop was lost"):
        core_drive(1, 0, FEW)


def test_a_violation_tells_what_repeats_it(monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setattr(Guard, "step", with_guarded(BROKEN_GUARDS["limit"][0]))
    assert main(["--target", "core", "--seed", "5", "--drive", "2"]) == 1
    assert "fuzz.fuzz --target core --seed 5 --drive 2" in capsys.readouterr().out
