"""The benchmark of the node: real processes and complete rows; the durations are not tested."""

import json
import time
from pathlib import Path

import pytest
from rich.console import Console

from launch_scripts.run.processes import Processes
from tests.workshop.bench import bench_node
from tests.workshop.bench.bench_node import NodeRow, Spread, busy_cores, main, node_section
from tests.workshop.bench.bench_report import show


def test_the_controller_answers_the_states_of_the_benchmark(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "rows.json"
    words = ["--rates", "100", "--busy", "0", "--seconds", "2", "--output", str(file)]
    assert main(words) == 0
    (row,) = json.loads(file.read_text(encoding="utf-8"))
    assert set(row) == set(NodeRow._fields)
    assert (row["rate"], row["busy"]) == (100, 0)
    assert row["ticks"] + row["unanswered"] == pytest.approx(200, abs=120)
    for name in ("lateness", "latency", "tick"):
        assert 0.0 < row[name]["p50"] <= row[name]["p99"] <= row[name]["max"]
    assert row["lateness"]["max"] <= 10.0
    assert row["share"] == pytest.approx(row["tick"]["p99"] / 10.0)
    assert 0.0 < row["load"] < 1.5
    assert "100" in capsys.readouterr().out


def test_a_table_shows_every_number_of_a_row() -> None:
    spread = Spread(0.11, 0.22, 0.33)
    row = NodeRow(50, 1, 499, spread, spread, spread, 0.044, 6, 7, 0.08)
    console = Console(width=bench_node.WIDTH)
    with console.capture() as shown:
        show(node_section([row]), console)
    for text in ("50", "499", "0.11 / 0.22 / 0.33", "4.4", "6", "7", "8"):
        assert text in shown.get()


def test_busy_cores_are_busy_and_end_with_the_measurement() -> None:
    def running() -> set[str]:
        commands = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                commands[folder.name] = (folder / "cmdline").read_text(encoding="utf-8")
            except OSError:
                continue
        return {pid for pid, line in commands.items() if bench_node.SPIN in line}

    before = running()
    with busy_cores(1):
        until = time.monotonic() + 10.0  # the command line of a new process appears a little later
        while not running() - before and time.monotonic() < until:
            time.sleep(0.01)
        assert len(running() - before) == 1
    assert not running() - before


def test_a_controller_that_cannot_start_ends_the_benchmark_with_its_last_line(
    tmp_path: Path,
) -> None:
    with Processes(tmp_path) as nodes:
        nodes.start("controller", "ampc_ros.nodes.controller_node", {"settings": "none.yaml"})
        with pytest.raises(RuntimeError, match=r"none\.yaml"):
            bench_node.wait_for(nodes, 60.0)
