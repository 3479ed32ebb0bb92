"""The fuzz command: a small run, and the detection of faults."""

import math
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.types import VehicleState
from tests.workshop.fuzz.fuzz import main
from tests.workshop.fuzz.fuzz_guard import (
    SHARES,
    ChecksAndGuard,
    FuzzCommand,
    Guarantees,
    Inputs,
    Violation,
    fuzz_guard,
)

MANY = 3000


class Broken(ChecksAndGuard):
    """Checks and guard with one fault."""

    def __init__(self, inputs: Inputs, fault: str) -> None:
        """Choose the fault."""
        super().__init__(inputs.number, "road")
        self.fault, self.ticks = fault, 0

    def take_state(self, state: VehicleState, now_ns: int) -> None:
        """Raise an OverflowError for an extreme speed."""
        if self.fault == "exception":
            math.exp(state.v_x)
        super().take_state(state, now_ns)

    def tick(self, now_ns: int) -> FuzzCommand:
        """Return an unguarded command."""
        self.ticks += 1
        answer = super().tick(now_ns)
        if self.ticks < 50:
            return answer
        faults = {
            "nan": FuzzCommand(math.nan, 0.0),
            "infinite rate": FuzzCommand(0.0, math.inf),
            "angle": FuzzCommand(0.61, 0.0),
            "rate": FuzzCommand(answer.steering, 1.31),
            "jump": FuzzCommand(-math.copysign(0.3, answer.steering), 0.0),
        }
        return faults.get(self.fault, answer)


@pytest.mark.parametrize("limits", ["road", "track"])
@pytest.mark.parametrize("seed", range(3))
def test_random_inputs_give_no_exception_and_no_command_outside_the_limits(
    seed: int, limits: str
) -> None:
    inputs = Inputs(seed)
    subject = ChecksAndGuard(inputs.number, limits)
    with np.errstate(all="ignore"):
        done = fuzz_guard(subject, inputs, Guarantees(limits), MANY)
    assert sum(done[kind] for kind in SHARES) == MANY
    assert all(done[kind] for kind in SHARES)
    assert sum(1 for count in subject.guard.count.values() if count) >= 4
    assert sum(1 for count in subject.filter.rejected.values() if count) >= 8


FAULTS = {
    "nan": "is not finite",
    "infinite rate": "is not finite",
    "angle": "angle 0.61 is beyond 0.6",
    "rate": "rate 1.31 is beyond 1.3",
    "jump": "angle jumped",
    "exception": "OverflowError",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_detected_and_its_input_named(fault: str) -> None:
    inputs = Inputs(1)
    with pytest.raises(Violation, match=rf"input \d+, \w+: .*{FAULTS[fault]}"):
        fuzz_guard(Broken(inputs, fault), inputs, Guarantees("road"), MANY)


def test_the_same_seed_gives_the_same_inputs() -> None:
    def drawn(seed: int) -> str:
        inputs = Inputs(seed)
        return str([(inputs.time(), inputs.next_state(), inputs.path()) for _ in range(50)])

    assert drawn(1) == drawn(1) != drawn(2)


def test_the_command_prints_inputs_and_rejections(capsys: Any) -> None:
    assert main(["--target", "guard", "--inputs", "6000", "--seed", "3"]) == 0
    output = capsys.readouterr().out
    assert "tick" in output
    assert "duplicate" in output
    assert "lateral_jerk" in output
