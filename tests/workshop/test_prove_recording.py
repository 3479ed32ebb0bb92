"""The proof of the recorder with few kills, in real and in simulated time."""

from pathlib import Path

import pytest

from tests.workshop.proofs import prove_recording
from tests.workshop.proofs.prove_recording import Kill, prove, table


def test_killed_recorders_lose_less_than_a_second_and_every_library_opens_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(prove_recording, "LONGEST", 3.0)
    kills = list(prove(tmp_path, 3, seed=2))
    assert [kill.simulated for kill in kills] == [False, True, False]
    assert all(kill.published > 10 for kill in kills)
    assert [kill for kill in kills if not kill.is_good] == []


def test_the_table_marks_every_failure() -> None:
    good = Kill(1.0, False, 100, 80, 0.2, 0, "only the index was missing", opened=True)
    bad = [good._replace(loss=1.0), good._replace(gaps=1), good._replace(opened=False)]
    assert [kill.is_good for kill in (good, *bad)] == [True, False, False, False]
    assert table([good, *bad]).row_count == 4
    assert table([good, *bad]).caption == "largest loss 1.000 s of 1 s allowed"
