"""The fuzz command: a small run of it, and that it finds what is broken."""

import math
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.types import VehicleState
from tests.workshop.fuzz.fuzz import main
from tests.workshop.fuzz.fuzz_guard import (
    SHARES,
    Answer,
    ChecksAndGuard,
    Inputs,
    Promises,
    Violation,
    fuzz,
)

MANY = 3000


class Broken(ChecksAndGuard):
    """Checks and guard with one fault."""

    def __init__(self, inputs: Inputs, fault: str) -> None:
        """Choose the fault."""
        super().__init__(inputs.number, "road")
        self.fault, self.ticks = fault, 0

    def take_state(self, state: VehicleState, now_ns: int) -> None:
        """Forget to handle an overflow."""
        if self.fault == "exception":
            math.exp(state.v_x)
        super().take_state(state, now_ns)

    def tick(self, now_ns: int) -> Answer:
        """Publish what no guard has seen, once."""
        self.ticks += 1
        answer = super().tick(now_ns)
        if self.ticks < 50:
            return answer
        faults = {
            "nan": Answer(math.nan, 0.0),
            "infinite rate": Answer(0.0, math.inf),
            "angle": Answer(0.61, 0.0),
            "rate": Answer(answer.steering, 1.31),
            "jump": Answer(-math.copysign(0.3, answer.steering), 0.0),
        }
        return faults.get(self.fault, answer)


@pytest.mark.parametrize("limits", ["road", "track"])
@pytest.mark.parametrize("seed", range(3))
def test_hostile_inputs_give_no_exception_and_no_command_outside_the_limits(
    seed: int, limits: str
) -> None:
    inputs = Inputs(seed)
    subject = ChecksAndGuard(inputs.number, limits)
    with np.errstate(all="ignore"):
        done = fuzz(subject, inputs, Promises(limits), MANY)
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
def test_what_is_broken_is_found_and_its_input_named(fault: str) -> None:
    inputs = Inputs(1)
    with pytest.raises(Violation, match=rf"input \d+, \w+: .*{FAULTS[fault]}"):
        fuzz(Broken(inputs, fault), inputs, Promises("road"), MANY)


def test_the_same_seed_gives_the_same_inputs() -> None:
    def drawn(seed: int) -> str:
        inputs = Inputs(seed)
        return str([(inputs.time(), inputs.next_state(), inputs.path()) for _ in range(50)])

    assert drawn(1) == drawn(1) != drawn(2)


def test_the_command_tells_what_was_thrown_and_refused(capsys: Any) -> None:
    assert main(["--target", "guard", "--inputs", "6000", "--seed", "3"]) == 0
    said = capsys.readouterr().out
    assert "tick" in said
    assert "duplicate" in said
    assert "lateral_jerk" in said
