"""Files of faults: every complaint names file, key, value and bound."""

import re
from pathlib import Path
from typing import Any

import pytest

from ampc_msgs_config.config import shipped
from launch_scripts.faults.kinds import FAULT_KINDS
from launch_scripts.faults.schedule import Fault, load_faults


def write(folder: Path, text: str) -> str:
    """Write a file of faults."""
    file = folder / "mine.yaml"
    file.write_text(text, encoding="utf-8")
    return str(file)


@pytest.mark.parametrize("name", shipped("faults"))
def test_shipped_files_are_valid(name: str) -> None:
    assert load_faults(name).faults


def test_a_file_gives_its_faults_and_seed(tmp_path: Path) -> None:
    file = write(tmp_path, "seed: 7\nfaults:\n  - {kind: noise, start: 3, duration: 1}\n")
    plan = load_faults(file)
    assert plan.seed == 7
    assert plan.faults == (Fault(kind="noise", start=3.0, duration=1.0, amount=0.1),)


WRONG = {
    "faults: []": "faults = [] must be a list of 1 to 10000 entries",
    "seed: 1": "missing key 'faults'",
    "fault: []": "unknown key 'fault'; known are faults, seed",
    "faults: [3]": "faults[0] = 3 must be a mapping of keys",
    "faults: [{kind: fire, start: 1, duration: 1}]": "faults[0].kind = 'fire' must be one of drop,",
    "faults: [{kind: drop, duration: 1}]": "faults[0]: missing key 'start'",
    "faults: [{kind: drop, start: 1, duration: 1, much: 1}]": "faults[0]: unknown key 'much'",
    "faults: [{kind: drop, start: -1, duration: 1}]": "[0].start = -1 must lie in [0, 100000] s",
    "faults: [{kind: drop, start: 1, duration: 0}]": "[0].duration = 0 must lie in [0.001, 1",
    "faults: [{kind: drop, start: 1, duration: .nan}]": "duration = nan must lie in",
    "faults: [{kind: drop, start: 1, duration: 1, amount: 2}]": "amount = 2.0 must lie in [0, 1]",
    "faults: [{kind: drop, start: 1, duration: 1, amount: all}]": "amount = 'all' must be a number",
    "faults: [{kind: hold, start: 1, duration: 1, amount: 2}]": "[0].amount = 2.0 is not allowed",
    "faults: [{kind: nan, start: 1, duration: 1, field: z}]": "field = 'z' must be one of x, y,",
    "faults: [{kind: drop, start: 1, duration: 1}]\nseed: -1": "seed = -1 must lie in [0, 2.14748",
    "faults: [{kind: drop, start: 1, duration: 1}]\nseed: 1.5": "seed = 1.5 must be a whole number",
    "faults: [{kind: drop, start: 1, duration: 1}]\nseed: a": "seed = 'a' must be a whole number",
}


@pytest.mark.parametrize("text", WRONG)
def test_what_is_wrong_is_named_with_its_file(text: str, tmp_path: Path) -> None:
    file = write(tmp_path, text)
    with pytest.raises(ValueError, match=re.escape(WRONG[text])) as error:
        load_faults(file)
    assert str(error.value).startswith(file)


def test_an_unknown_name_lists_the_shipped_ones() -> None:
    with pytest.raises(ValueError, match="neither a file nor one of the shipped faults: example"):
        load_faults("nothing")


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_a_mirrored_fault_mirrored_again_is_the_same(kind: str) -> None:
    given: dict[str, Any] = {"kind": kind, "start": 1.0, "duration": 1.0}
    fault = Fault(**given)
    assert fault.mirrored.mirrored == fault
    assert (fault.mirrored == fault) != FAULT_KINDS[kind].sided
