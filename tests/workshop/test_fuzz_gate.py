"""The fuzzing of the gate: a small run, and the detection of faults."""

import math

import pytest

from ampc_ros.gate.core import Gate, GateOutput
from tests.workshop.fuzz.fuzz_gate import gate_drive
from tests.workshop.fuzz.fuzz_guard import Violation

MANY = 3000


@pytest.mark.parametrize("drive", range(6))
def test_random_inputs_give_no_exception_and_no_output_outside_the_limits(drive: int) -> None:
    done = gate_drive(7, drive, MANY)
    for state in ("waiting", "driving", "degraded", "stopping", "stopped"):
        assert done[f"state {state}"]
    for kind in ("command", "plan", "speed", "reset"):
        assert done[f"{kind} used"]
        assert done[f"{kind} refused"]


FAULTS = {
    "not finite": GateOutput(math.nan, 0.0, 1.0, False),
    "largest angle": GateOutput(0.7, 0.0, 1.0, False),
    "turns faster": GateOutput(0.0, 4.0, 1.0, False),
    "impossible speed": GateOutput(0.0, 0.0, -1.0, False),
    "jumps": GateOutput(-0.6, 0.0, 1.0, False),
    "in state": None,
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_gate_is_detected(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    step, count = Gate.step, 0

    def broken(gate: Gate, now: float) -> GateOutput | None:
        nonlocal count
        output = step(gate, now)
        count += output is not None
        return FAULTS[fault] if count > 40 and output and abs(output.angle) < 0.3 else output

    monkeypatch.setattr(Gate, "step", broken)
    with pytest.raises(Violation, match=rf"input \d+, step: .*{fault}"):
        gate_drive(7, 1, MANY)


def test_a_speed_that_rises_during_a_stop_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    speed = Gate._commanded_speed

    def broken(gate: Gate, now: float) -> float:
        return speed(gate, now) + 1e-3 * now

    monkeypatch.setattr(Gate, "_commanded_speed", broken)
    with pytest.raises(Violation, match="the speed of a stop rises"):
        gate_drive(7, 1, MANY)
