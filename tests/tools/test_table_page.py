"""Page of the shipped tables: what is compared, and at which speeds."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ampc_ros.mpc.gain_table import load_gain_table
from launch_scripts.study import shipped_tables
from launch_scripts.study.shipped_tables import Judged, judged_table, judged_tables, main, task_of
from launch_scripts.tuning.fitness import JUDGED, fitness
from launch_scripts.tuning.methods import SearchRecord, run_method


class Immediate:
    """Executor whose searches have all found the same."""

    def submit(self, function: Any, name: str, speed: float) -> "Immediate":
        """Accept a call."""
        return self

    def result(self) -> float:
        """Return a fitness that nothing beats."""
        return 1e-4


def example() -> Judged:
    return judged_table("preview_ordinary", Immediate())  # type: ignore[arg-type]


def test_every_tuned_table_of_the_default_formulation_is_judged() -> None:
    assert {"preview_paper", "preview_ordinary"} <= set(judged_tables())
    assert "preview" not in judged_tables()


def test_speeds_alternate_between_nodes_and_the_middle_between_them() -> None:
    item, nodes = example(), np.array(task_of("preview_ordinary").speeds)
    assert np.all(np.diff(item.speeds) > 0.0)
    np.testing.assert_array_equal(item.speeds[::2], nodes)
    np.testing.assert_array_equal(item.between, np.arange(1, len(item.speeds), 2))
    np.testing.assert_allclose(item.speeds[item.between], (nodes[1:] + nodes[:-1]) / 2)


def test_means_and_worst_ratios_are_those_of_the_proof() -> None:
    item = example()
    best = item.proof["candidates"][item.proof["written"]]
    key = item.proof["written"].partition(",")[0]
    assert item.mean(key) == pytest.approx(best["geometric_mean"][2])
    largest = max(best["held_out"] + best["between"])
    assert item.worst("best possible") == pytest.approx(largest / 1e-4)


def test_the_search_for_the_best_possible_uses_the_held_out_cars(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shipped_tables, "BEST_EVALUATIONS", 12)
    kinds: list[str] = []

    def watched(name: str, record: SearchRecord, rng: np.random.Generator) -> SearchRecord:
        kinds.extend(node.kind for node in record.cost.args[0])  # type: ignore[attr-defined]
        return run_method(name, record, rng)

    monkeypatch.setattr(shipped_tables, "run_method", watched)
    found = shipped_tables.best_possible("preview_ordinary", 9.5)
    assert kinds == [JUDGED]
    node = task_of("preview_ordinary").nodes((9.5,))[0]._replace(kind=JUDGED)
    shipped_gains = load_gain_table("preview_ordinary").lookup(9.5).gains
    assert found < 1.5 * fitness(node, [shipped_gains])[0]


def test_the_page_has_a_row_a_verdict_and_a_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shipped_tables, "judged_tables", lambda: ["preview_ordinary"])
    monkeypatch.setattr(shipped_tables, "judged_table", lambda name, pool: example())
    assert main(["--update", str(tmp_path / "page.md"), "--workers", "1"]) == 0
    text = (tmp_path / "page.md").read_text()
    proof = json.loads(shipped_tables.proof_file("preview_ordinary").read_text())
    assert f"* `preview_ordinary`: {proof['verdict']}." in text
    assert sum(line.startswith("| `preview_ordinary`") for line in text.splitlines()) == 1
    assert (tmp_path / "page.png").read_bytes().startswith(b"\x89PNG")
