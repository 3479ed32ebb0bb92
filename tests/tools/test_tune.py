"""The tuner as a command: killed, resumed, on a full disk, in parallel, on a cluster."""

import errno
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config import config
from ampc_ros.mpc.gain_table import gain_table, load_gain_table
from launch_scripts.certify import certify_parser
from launch_scripts.tune import build_parser, main
from launch_scripts.tuning.fitness import fitness
from launch_scripts.tuning.methods import SearchRecord
from launch_scripts.tuning.report import Candidate, TuningReport
from launch_scripts.tuning.search import Checkpoints, SearchResult, run_searches
from launch_scripts.tuning.task import Search, read_task
from launch_scripts.tuning.workers import Workers, open_workers
from tests.waiting import TIMEOUT

SMALL = ["--formulation", "paper", "--speeds", "3", "9", "--references", "5", "10"]
SMALL += ["--seeds", "1"]


def tuned(output: Path, *words: str) -> tuple[str, Any]:
    """Tune in this process and return table and proof."""
    assert main([*SMALL, *words, "--output", str(output)]) == 0
    return output.read_text(), json.loads(output.with_suffix(".json").read_text())


def test_the_last_line_is_the_command_that_certifies_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tuned(tmp_path / "a.yaml", "--evaluations", "12")
    last = capsys.readouterr().out.splitlines()[-1]
    command = f"python launch_scripts/certify.py --vehicle paper --gain-table {tmp_path}/a.yaml"
    assert last == f"certify it: {command} --controller paper"
    chosen = certify_parser().parse_args(shlex.split(command)[2:])
    assert Path(chosen.gain_table) == tmp_path / "a.yaml"


def test_a_tuned_table_can_be_loaded_marks_unreached_nodes_and_has_its_provenance(
    tmp_path: Path,
) -> None:
    text, proof = tuned(tmp_path / "a.yaml", "--evaluations", "16")
    content = config.read(tmp_path / "a.yaml")
    provenance = content["provenance"]
    assert provenance["nodes_not_reached"] == [[3.0, 10.0]]
    assert provenance["seeds"] == [1]
    assert any(line.endswith(f": {provenance['command']}") for line in text.splitlines()[3:5])
    assert len(gain_table(content).nodes) in (2, 4)
    assert ("NOT REACHED" in text) == (len(gain_table(content).nodes) == 4)
    assert proof["verdict"] in provenance["verdict"]
    assert {"table, seed 1", "single, seed 1", "shipped table3"} == set(proof["candidates"])
    assert not (tmp_path / "a.checkpoint").exists()


def test_the_reported_fitness_is_that_of_the_written_gains(
    tmp_path: Path,
) -> None:
    _, proof = tuned(tmp_path / "a.yaml", "--evaluations", "12")
    task = read_task(build_parser().parse_args([*SMALL, "--evaluations", "12"]))
    written = load_gain_table(str(tmp_path / "a.yaml"))
    kind = "table, seed 1" if proof["verdict"].endswith("table written") else "single, seed 1"
    reported = proof["candidates"][kind]["fitness"]
    places = [n for n in task.nodes() if abs(n.reference) <= 2 * n.speed]
    own = [fitness(n, [written.lookup(n.speed, n.reference).gains])[0] for n in places]
    assert own == reported


SIZES = {
    "pso": ["--evaluations", "60"],
    "de": ["--method", "de", "--evaluations", "60"],
    "paper": ["--method", "paper", "--particles", "4", "--generations", "14"],
}


@pytest.mark.parametrize("method", SIZES)
def test_a_search_that_was_killed_resumes_to_the_same_table_bit_for_bit(
    method: str, tmp_path: Path
) -> None:
    sizes = SIZES[method]
    whole = tuned(tmp_path / "whole.yaml", *sizes)
    words = [*SMALL, *sizes, "--output", str(tmp_path / "cut.yaml")]
    command = [sys.executable, "-m", "launch_scripts.tune", *words, "--workers", "1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    seen = wait_for(lambda: evaluations(tmp_path / "cut.checkpoint") > 3)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    assert seen
    assert not (tmp_path / "cut.yaml").exists()
    before = evaluations(tmp_path / "cut.checkpoint")
    assert main([*words[:-1], str(tmp_path / "cut.yaml")]) == 2  # the checkpoints are kept
    assert evaluations(tmp_path / "cut.checkpoint") == before
    assert tuned(tmp_path / "cut.yaml", *sizes, "--resume") == whole


def wait_for(condition: Callable[[], bool], patience: float = TIMEOUT) -> bool:
    """Wait until a condition holds."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.002)
    return False


def evaluations(folder: Path) -> int:
    """Return the number of all evaluations in a folder of checkpoints."""
    files = [f for f in folder.glob("*.json") if f.name != "task.json"]
    return sum(len(json.loads(f.read_text())["fitness"]) for f in files)


def test_a_disk_that_fills_up_loses_no_checkpoint_and_gives_one_error_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = tuned(tmp_path / "whole.yaml", "--evaluations", "20")
    capsys.readouterr()
    room, real = [8], os.fsync

    def fills_up(number: int) -> None:
        room[0] -= 1
        if room[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(number)

    words = [*SMALL, "--evaluations", "20", "--output", str(tmp_path / "cut.yaml")]
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fills_up)
        assert main(words) == 2
    said = capsys.readouterr().out
    assert said.count("error:") == 1
    assert "cut" in said
    assert "No space left on device" in said
    assert "--resume" in said
    assert evaluations(tmp_path / "cut.checkpoint") > 0
    assert tuned(tmp_path / "cut.yaml", "--evaluations", "20", "--resume") == whole


def searched(workers: Workers, folder: Path, show: Callable[[Search, SearchRecord], None]) -> Any:
    """Run the searches of a small task."""
    task = read_task(build_parser().parse_args([*SMALL, "--evaluations", "24"]))
    checkpoints = Checkpoints(folder)
    return run_searches(task.searches(), workers, checkpoints, show)


def ignore(search: Search, record: SearchRecord) -> None:
    """Ignore the progress."""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, SearchResult]:
    """Results of one thread."""
    with open_workers(1) as workers:
        found: dict[str, SearchResult] = searched(workers, tmp_path_factory.mktemp("alone"), ignore)
    return found


@pytest.mark.parametrize(("count", "processes"), [(3, False), (2, True)])
def test_threads_and_processes_find_the_same_bit_for_bit(
    alone: dict[str, SearchResult], tmp_path: Path, count: int, processes: bool
) -> None:
    with open_workers(count, processes) as workers:
        assert searched(workers, tmp_path, ignore) == alone


def test_a_cluster_whose_worker_is_killed_finds_the_same_bit_for_bit(
    alone: dict[str, SearchResult], tmp_path: Path
) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is an optional extra")
    from ampc_msgs_config.compiled import source_hash

    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(host="127.0.0.1", **options) as cluster:
        client = distributed.Client(cluster, set_as_default=False)
        pids = list(client.run(os.getpid).values())
        assert len(set(client.run(source_hash).values())) == 1
        seen: list[int] = []

        def kill_one(search: Search, record: SearchRecord) -> None:
            seen.append(len(record.fitness))
            if len(seen) == 8:
                os.kill(pids[0], signal.SIGKILL)

        with open_workers(1, scheduler=cluster.scheduler_address, trusted=True) as workers:
            assert workers.capacity == 2
            assert searched(workers, tmp_path, kill_one) == alone
        assert len(seen) > 8
        client.close()


def test_lost_workers_give_one_error_line(tmp_path: Path) -> None:
    with open_workers(1, processes=True) as workers:
        pid = workers.executor.submit(os.getpid).result()

        def kill(search: Search, record: SearchRecord) -> None:
            os.kill(pid, signal.SIGKILL)
            time.sleep(0.2)

        with pytest.raises(ValueError, match=r"workers: lost .*--resume"):
            searched(workers, tmp_path, kill)
    assert evaluations(tmp_path) > 0


def judged(table: list[float], single: list[float], hand_set: list[float]) -> TuningReport:
    """Return a report with these values at one node and half-way to the next ones."""
    grid = load_gain_table("table3")
    names = "table, seed 1", "single, seed 1", "shipped table3"
    ours, one, reference = (
        Candidate(name, grid, (1.0,), tuple(values[:1]), tuple(values[1:]))
        for name, values in zip(names, (table, single, hand_set), strict=True)
    )
    return TuningReport(ours, one, reference, (), ())


@pytest.mark.parametrize(("table", "is_table"), [(0.899, True), (0.901, False)])
def test_a_table_has_to_beat_the_single_set_by_a_tenth_between_its_nodes(
    table: float, is_table: bool
) -> None:
    report = judged([0.1, table, table], [9.0, 1.0, 1.0], [9.0, 9.0, 9.0])
    assert report.saving == pytest.approx(1.0 - table)
    assert report.is_table == is_table
    assert report.verdict.endswith("table written") == is_table
    assert report.written == (report.table if is_table else report.single)


def test_the_nodes_do_not_count_for_the_saving() -> None:
    assert not judged([0.01, 1.0], [1.0, 1.0], [9.0, 9.0]).is_table


@pytest.mark.parametrize(("node", "between", "is_table"), [(1.019, 0.5, True), (1.021, 0.5, False),
                                                          (0.5, 1.021, False)])  # fmt: skip
def test_a_table_may_be_worse_than_the_hand_set_gains_by_two_percent_at_any_speed(
    node: float, between: float, is_table: bool
) -> None:
    report = judged([node, between], [9.0, 9.0], [1.0, 1.0])
    assert report.is_table == is_table
    if not is_table:
        assert report.verdict.startswith("at one speed the table is up to 2.1% worse than")


def test_where_no_single_set_comes_through_the_table_is_written() -> None:
    report = judged([0.1, 0.1], [np.inf, np.inf], [9.0, 9.0])
    assert report.is_table
    assert report.verdict == "no single gain set brings every car through: table written"


def test_a_table_that_loses_a_car_between_its_nodes_is_not_written() -> None:
    report = judged([0.1, np.inf], [9.0, 9.0], [9.0, 9.0])
    assert not report.is_table
    assert report.verdict.endswith("single gain set written")


def test_written_gains_that_are_worse_than_the_hand_set_ones_are_named() -> None:
    assert judged([0.9, 0.9], [1.0, 1.019], [1.0, 1.0]).warning == ""
    warned = judged([1.25, 1.25], [1.0, 1.3], [1.0, 1.0]).warning
    assert warned == (
        "at one speed or more the written gains are up to 30.0% worse than the hand-set table3"
    )
    assert "lose a car" in judged([np.inf, 0.95], [0.9, np.inf], [1.0, 1.0]).warning


def test_where_neither_a_table_nor_a_set_comes_through_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--formulation", "paper", "--fitness", "robust", "--speeds", "5", "27"]
    output = tmp_path / "a.yaml"
    assert main([*words, "--evaluations", "12", "--seeds", "1", "--output", str(output)]) == 2
    assert "neither a table nor a single gain set" in capsys.readouterr().out
    assert not output.exists()


def test_the_provenance_has_the_fitness_of_the_written_gains(tmp_path: Path) -> None:
    _, proof = tuned(tmp_path / "a.yaml", "--evaluations", "12")
    written = proof["candidates"][proof["written"]]["fitness"]
    stated = [value for value in proof["task"]["node_fitness"] if value is not None]
    assert stated == pytest.approx(written, rel=1e-3)


def test_a_changed_settings_file_is_another_task(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, output = tmp_path / "s.yaml", tmp_path / "a.yaml"
    file.write_text(config.find("controllers", "table3").read_text())
    words = ["--speeds", "9", "--settings", str(file), "--output", str(output)]
    task = read_task(build_parser().parse_args(words))
    Checkpoints(tmp_path / "a.checkpoint").begin(task.describe(), False)
    file.write_text(file.read_text() + "# changed\n")
    assert main([*words, "--resume"]) == 2
    assert "settings_sha256" in capsys.readouterr().out


def test_speeds_at_which_the_hand_set_gains_lose_a_car_are_not_compared() -> None:
    assert judged([5.0, 0.5], [9.0, 9.0], [np.inf, 1.0]).is_table
