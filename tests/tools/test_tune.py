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
from ampc_ros.pso.swarm import Swarm
from launch_scripts.certify import certify_parser
from launch_scripts.tune import build_parser, main
from launch_scripts.tuning.fitness import fitness
from launch_scripts.tuning.report import NO_SINGLE, Candidate, TuningReport
from launch_scripts.tuning.search import Checkpoints, SearchResult, run_searches
from launch_scripts.tuning.task import Search, read_task
from launch_scripts.tuning.workers import Workers, open_workers
from tests.waiting import TIMEOUT

SMALL = ["--formulation", "paper", "--speeds", "3", "9", "--references", "5", "10"]
SMALL += ["--particles", "4", "--seeds", "1"]


def tuned(output: Path, *words: str) -> tuple[str, Any]:
    """Tune in this process and return table and proof."""
    assert main([*SMALL, *words, "--output", str(output)]) == 0
    return output.read_text(), json.loads(output.with_suffix(".json").read_text())


def test_the_last_line_is_the_command_that_certifies_the_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tuned(tmp_path / "a.yaml", "--generations", "1")
    last = capsys.readouterr().out.splitlines()[-1]
    command = f"python launch_scripts/certify.py --vehicle paper --gain-table {tmp_path}/a.yaml"
    assert last == f"certify it: {command} --controller paper"
    chosen = certify_parser().parse_args(shlex.split(command)[2:])
    assert Path(chosen.gain_table) == tmp_path / "a.yaml"


def test_a_tuned_table_can_be_loaded_marks_unreached_nodes_and_has_its_provenance(
    tmp_path: Path,
) -> None:
    text, proof = tuned(tmp_path / "a.yaml", "--generations", "3")
    content = config.read(tmp_path / "a.yaml")
    provenance = content["provenance"]
    assert provenance["nodes_not_reached"] == [[3.0, 10.0]]
    assert provenance["seeds"] == [1]
    assert provenance["command"] in text.splitlines()[3]
    assert len(gain_table(content).nodes) in (2, 4)
    assert ("NOT REACHED" in text) == (len(gain_table(content).nodes) == 4)
    assert proof["verdict"] in provenance["verdict"]
    assert {"table, seed 1", "random, seed 1", "shipped table3"} < set(proof["candidates"])
    assert not (tmp_path / "a.checkpoint").exists()


def test_the_reported_fitness_is_that_of_the_written_gains(
    tmp_path: Path,
) -> None:
    _, proof = tuned(tmp_path / "a.yaml", "--generations", "2")
    task = read_task(build_parser().parse_args([*SMALL, "--generations", "2"]))
    written = load_gain_table(str(tmp_path / "a.yaml"))
    kind = "table, seed 1" if proof["verdict"].endswith("table written") else "single, seed 1"
    reported = proof["candidates"][kind]["fitness"]
    places = [n for n in task.nodes() if abs(n.reference) <= 2 * n.speed]
    own = [fitness(n, [written.lookup(n.speed, n.reference).gains])[0] for n in places]
    assert own == reported


def test_a_search_that_was_killed_resumes_to_the_same_table_bit_for_bit(tmp_path: Path) -> None:
    whole = tuned(tmp_path / "whole.yaml", "--generations", "30")
    words = [*SMALL, "--generations", "30", "--output", str(tmp_path / "cut.yaml")]
    command = [sys.executable, "-m", "launch_scripts.tune", *words, "--workers", "1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    seen = wait_for(lambda: generations(tmp_path / "cut.checkpoint") > 3)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    assert seen
    assert not (tmp_path / "cut.yaml").exists()
    before = generations(tmp_path / "cut.checkpoint")
    assert main([*words[:-1], str(tmp_path / "cut.yaml")]) == 2  # the checkpoints are kept
    assert generations(tmp_path / "cut.checkpoint") == before
    assert tuned(tmp_path / "cut.yaml", "--generations", "30", "--resume") == whole


def wait_for(condition: Callable[[], bool], patience: float = TIMEOUT) -> bool:
    """Wait until a condition holds."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.002)
    return False


def generations(folder: Path) -> int:
    """Return the number of all generations in a folder of checkpoints."""
    files = [f for f in folder.glob("*.json") if f.name != "task.json"]
    return sum(json.loads(f.read_text())["generation"] + 1 for f in files)


def test_a_disk_that_fills_up_loses_no_checkpoint_and_gives_one_error_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = tuned(tmp_path / "whole.yaml", "--generations", "4")
    capsys.readouterr()
    room, real = [8], os.fsync

    def fills_up(number: int) -> None:
        room[0] -= 1
        if room[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(number)

    words = [*SMALL, "--generations", "4", "--output", str(tmp_path / "cut.yaml")]
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fills_up)
        assert main(words) == 2
    said = capsys.readouterr().out
    assert said.count("error:") == 1
    assert "cut" in said
    assert "No space left on device" in said
    assert "--resume" in said
    assert generations(tmp_path / "cut.checkpoint") > 0
    assert tuned(tmp_path / "cut.yaml", "--generations", "4", "--resume") == whole


def searched(workers: Workers, folder: Path, show: Callable[[Search, Swarm], None]) -> Any:
    """Run the searches of a small task."""
    task = read_task(build_parser().parse_args([*SMALL, "--generations", "6"]))
    checkpoints = Checkpoints(folder)
    return run_searches(task.searches(), workers, checkpoints, show)


def ignore(search: Search, swarm: Swarm) -> None:
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

        def kill_one(search: Search, swarm: Swarm) -> None:
            seen.append(swarm.generation)
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

        def kill(search: Search, swarm: Swarm) -> None:
            os.kill(pid, signal.SIGKILL)
            time.sleep(0.2)

        with pytest.raises(ValueError, match=r"workers: lost .*--resume"):
            searched(workers, tmp_path, kill)
    assert generations(tmp_path) > 0


@pytest.mark.parametrize(("table", "single", "is_table"), [(0.899, 1.0, True), (0.901, 1.0, False)])
def test_a_table_has_to_beat_the_single_set_by_a_tenth(
    table: float, single: float, is_table: bool
) -> None:
    grid = load_gain_table("table3")
    two = (Candidate(name, grid, (x,), (x,)) for name, x in (("t", table), ("s", single)))
    report = TuningReport(next(two), next(two), (), ())
    assert report.is_table == is_table
    assert report.verdict.endswith("table written") == is_table


def test_where_no_single_set_comes_through_the_table_is_written() -> None:
    grid = load_gain_table("table3")
    none = Candidate(NO_SINGLE, grid, (np.inf,), (np.inf,))
    report = TuningReport(Candidate("t", grid, (0.1,), (0.1,)), none, (), ())
    assert report.is_table
    assert report.verdict == "no single gain set brings every car through: table written"


def test_a_table_that_is_worse_between_its_nodes_is_not_written() -> None:
    grid = load_gain_table("table3")
    table, single = Candidate("t", grid, (0.1,), (1.01,)), Candidate("s", grid, (9.0,), (1.0,))
    report = TuningReport(table, single, (), ())
    assert report.advantage > 0.1
    assert not report.is_table
    assert report.verdict.startswith("between its nodes the table is worse")


def test_a_table_that_loses_a_car_between_its_nodes_is_not_written() -> None:
    grid = load_gain_table("table3")
    lost = Candidate("t", grid, (0.1,), (np.inf,))
    assert not TuningReport(lost, Candidate("s", grid, (9.0,), (9.0,)), (), ()).is_table
