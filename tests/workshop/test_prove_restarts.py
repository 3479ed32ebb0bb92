"""Nodes that are killed and started again: two moments of the proof."""

import pytest

from tests.waiting import TIMEOUT
from tests.workshop.proofs import prove_restarts
from tests.workshop.proofs.prove_restarts import VICTIMS, main


def test_every_combination_of_nodes_is_killed() -> None:
    assert len(VICTIMS) == len({frozenset(names) for names in VICTIMS}) == 7


@pytest.mark.parametrize("names", [("controller",), ("planner", "simulator")])
def test_the_car_drives_or_stands_after_nodes_were_killed_and_started_again(
    names: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: object,
) -> None:
    monkeypatch.setattr(prove_restarts, "VICTIMS", [names])
    code = main(["--moments", "1", "--patience", str(TIMEOUT), "--logs", str(tmp_path)])
    said = capsys.readouterr().out
    assert code == 0, said
    assert f"1: {' and '.join(names)} killed: the car " in said
