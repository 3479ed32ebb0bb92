"""The benchmark: the same problems for all tools, exact references, and complete reports."""

import json
import math
import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.serialized_path import has_positions_of
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.mpc.model import augment, zero_order_hold
from ampc_ros.mpc.qp import Qp
from ampc_ros.mpc.small_matrices import make_scratch
from tests.workshop.bench import bench, bench_growth, bench_inputs, bench_qp, bench_report
from tests.workshop.bench.bench_mpc import (
    PROXIMAL,
    augmented_model,
    casadi_qp,
    do_mpc_controller,
    multiple_shooting,
    numpy_daqp,
)
from tests.workshop.bench.bench_ours import (
    GAINS,
    VEHICLE,
    Task,
    limits,
    qp_of,
    whole_tick,
)
from tests.workshop.bench.bench_problems import KINDS, Problem, perturbed, problems, recorded_ticks
from tests.workshop.bench.bench_qp import WRONG, one_sided
from tests.workshop.bench.bench_report import Section
from tests.workshop.bench.bench_solvers import wrong_shares
from tests.workshop.bench.bench_thresholds import compare, threshold_table
from tests.workshop.bench.bench_ticks import FIRST, FREE, Maker, exact_first_move, ours
from tests.workshop.bench.bench_timing import Entrant, interleaved, statistics

MAKERS: dict[str, tuple[str, Maker, Gains]] = {
    "ours": ("numba", ours, GAINS),
    "NumPy": ("numpy", numpy_daqp, GAINS),
    "condensed": ("casadi", partial(casadi_qp, "daqp", {}), GAINS),
    "multiple shooting": ("casadi", partial(multiple_shooting, "daqp", PROXIMAL), FIRST),
    "do-mpc": ("do_mpc", do_mpc_controller, FREE),
}
"""Package, constructor, and gains of the solved problem."""
EXACT = ("ours", "DAQP", "quadprog")
PARTS = ("solvers", "growth", "swarm", "scaling", "inputs")


@pytest.fixture(scope="module")
def task() -> list[Problem]:
    """Return a few problems of every kind."""
    return problems(6)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run all parts without ROS quickly and return the folder."""
    folder = tmp_path_factory.mktemp("bench")
    assert bench.main(["--quick", "--output", str(folder), "--only", *PARTS]) == 0
    return folder


@pytest.fixture(scope="module")
def sections(written: Path) -> dict[str, Any]:
    """Return the tables by key."""
    content: dict[str, Any] = json.loads((written / "bench.json").read_text(encoding="utf-8"))
    return dict(content["sections"])


def test_exact_solvers_are_never_wrong_in_the_table(sections: dict[str, Any]) -> None:
    shares = {row["solver"]: row["wrong in all [%]"] for row in sections["qp"]["rows"]}
    assert {name: shares[name] for name in EXACT if name in shares} == dict.fromkeys(
        [name for name in EXACT if name in shares], 0.0
    )
    ticks = {row["controller"]: row["wrong [%]"] for row in sections["tick"]["rows"]}
    assert (ticks["ours"], ticks["NumPy + DAQP"]) == (0.0, 0.0)


def test_every_part_gives_a_table_in_json_and_markdown(
    written: Path, sections: dict[str, Any]
) -> None:
    keys = {"thresholds", "qp", "qp_kinds", "tick", "swarm_paper", "swarm_preview", "scaling"}
    assert set(sections) == keys | {f"growth_{axis.split()[0]}" for axis in bench_growth.AXES}
    text = (written / "bench.md").read_text(encoding="utf-8")
    for section in sections.values():
        assert f"**{section['title']}.**" in text
        assert len({tuple(row) for row in section["rows"]}) == 1
    assert (written / "bench.png").read_bytes().startswith(b"\x89PNG")


def test_every_measured_quantity_is_compared_with_its_thresholds(sections: dict[str, Any]) -> None:
    rows = sections["thresholds"]["rows"]
    assert [row["what"] for row in rows if row["threshold"] == ">= 60,000"]
    assert {row["met"] for row in rows} <= {"yes", "no"}
    correct = next(row for row in rows if row["what"].startswith("QP right"))
    assert (correct["measured"], correct["met"]) == ("100", "yes")
    for threshold, basis in (("<= 0.7", 3), ("<= 1.5", 2), ("<= 2", 4), (">= 1.6", 1)):
        assert sum(row["threshold"] == threshold for row in rows) == basis


@pytest.mark.parametrize(
    ("value", "threshold", "met"),
    [
        (0.7, "<= 0.7", "yes"),
        (0.71, "<= 0.7", "no"),
        (60_000.0, ">= 60,000", "yes"),
        (59_999.0, ">= 60,000", "no"),
        (math.nan, "<= 2", "no"),
    ],
)
def test_a_threshold_is_met_up_to_its_number(value: float, threshold: str, met: str) -> None:
    assert compare("", "", value, threshold)["met"] == met


def test_the_node_has_thresholds_with_a_busy_core_and_other_tables_have_none() -> None:
    busy = {
        "rate [Hz]": "100",
        "busy cores": "1",
        "missed ticks": "3",
        "tick p99 / period [%]": 1.9,
    }
    rows = [{**busy, "busy cores": "0", "missed ticks": "0"}, busy]
    (section,) = threshold_table([Section("node", "", "", rows)])
    assert [row["met"] for row in section.rows] == ["no", "yes"]
    assert threshold_table([Section("growth_rows", "", "", rows)]) == []


def test_the_page_of_the_documentation_has_the_marks() -> None:
    text = bench.PAGE.read_text(encoding="utf-8")
    assert text.count(bench_report.BEGIN) == text.count(bench_report.END) == 1


def test_written_results_can_be_read_and_inserted_into_a_page(
    written: Path, tmp_path: Path
) -> None:
    page = tmp_path / "benchmarks.md"
    page.write_text(f"before\n{bench_report.BEGIN}\noutdated\n{bench_report.END}\nafter\n", "utf-8")
    words = ["--read", str(written / "bench.json"), "--output", str(tmp_path)]
    assert bench.main([*words, "--page", str(page)]) == 0
    for kind in ("json", "md"):
        assert (tmp_path / f"bench.{kind}").read_bytes() == (written / f"bench.{kind}").read_bytes()
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "outdated" not in text
    assert "| >= 60,000 |" in text


def test_a_page_without_marks_is_an_error(written: Path, tmp_path: Path) -> None:
    machine, (section, *_) = bench_report.read([written / "bench.json"])
    page = tmp_path / "benchmarks.md"
    page.write_text("nothing", "utf-8")
    with pytest.raises(ValueError, match="missing"):
        bench_report.put_into(page, machine, section)
    assert page.read_text("utf-8") == "nothing"


def test_report_names_the_machine_but_no_host_and_no_folder(written: Path) -> None:
    text = "".join(
        (written / f"bench.{kind}").read_text(encoding="utf-8") for kind in ("json", "md")
    )
    machine = json.loads((written / "bench.json").read_text(encoding="utf-8"))["machine"]
    assert machine["cpu"]
    assert machine["cores"] >= 1
    assert {"numba", "daqp"} <= set(machine["packages"])
    for secret in (os.uname().nodename, str(Path.home()), str(written), str(Path.cwd())):
        assert secret not in text


def test_problems_of_every_kind_have_the_properties_of_their_name(task: list[Problem]) -> None:
    assert [p.kind for p in task] == [kind for kind in KINDS for _ in range(6)]
    assert [math.isnan(p.move) for p in task] == [p.kind == "infeasible" for p in task]
    rows = {p.kind: len(p.qp.M) for p in task}
    assert rows["repeated rows"] == 1.5 * rows["recorded"]
    assert sum(p.active for p in task if p.kind == "perturbed") > 0
    assert all(p.doubt < WRONG / 10 for p in task)


@pytest.mark.parametrize("solver", bench_qp.SOLVERS, ids=lambda solver: solver.name)
def test_a_solver_returns_the_exact_solution_or_none(
    solver: bench_qp.Solver, task: list[Problem]
) -> None:
    pytest.importorskip(solver.package)
    shares = wrong_shares(task, [solver.prepare(p.qp)() for p in task])
    assert shares["infeasible undetected [%]"] == 0.0
    if solver.name in EXACT:
        assert shares["wrong in all [%]"] == 0.0


def test_the_error_bound_covers_a_wrong_point(task: list[Problem]) -> None:
    problem = task[0]
    x = bench_qp.with_daqp(problem.qp)()
    assert x is not None
    off = 0.9 * x
    doubt, _ = bench_qp.certificate(problem.qp, off, problem.L_0)
    assert doubt >= abs(problem.L_0 @ (off - x))
    M, gamma = one_sided(problem.qp)
    outside = x + 10 * M[0] * gamma[0] / (M[0] @ M[0])
    assert bench_qp.certificate(problem.qp, outside, problem.L_0)[0] == math.inf


def test_a_reference_without_a_tight_error_bound_is_an_error() -> None:
    one = np.ones((1, 1))
    empty = Qp(one, np.zeros(1), one, np.ones(1), -np.ones(1))
    with pytest.raises(ArithmeticError, match="reference"):
        bench_qp.exact_move(empty, np.ones(1))


@pytest.mark.parametrize("tool", MAKERS)
def test_controllers_of_other_tools_give_the_exact_first_move(tool: str) -> None:
    package, make, gains = MAKERS[tool]
    pytest.importorskip(package)
    answer = make()
    recorded, rng = recorded_ticks(), np.random.default_rng(5)
    ticks = [perturbed(recorded[i], rng) for i in range(0, 640, 128)]
    moves = np.array([answer(tick) for tick in ticks], dtype=float)
    exact = np.array([exact_first_move(gains, tick) for tick in ticks])
    np.testing.assert_allclose(moves, exact, atol=1e-5)


def test_two_sided_form_is_the_same_polyhedron(task: list[Problem]) -> None:
    rng = np.random.default_rng(0)
    for problem in task:
        M, gamma = one_sided(problem.qp)
        for x in rng.normal(size=(20, len(problem.qp.K))):
            y = problem.qp.M @ x
            inside = bool(((problem.qp.low <= y) & (y <= problem.qp.high)).all())
            assert inside == bool((M @ x <= gamma).all())


def test_recorded_ticks_are_those_of_the_closed_loop() -> None:
    ticks, answer = recorded_ticks(), whole_tick(GAINS)
    moves = np.array([answer(tick) for tick in ticks[:-1]], float)
    commanded = np.diff([tick.u for tick in ticks])
    same_drive = np.abs(np.diff([tick.x[4] for tick in ticks])) < 2.0
    np.testing.assert_allclose(moves[same_drive], commanded[same_drive], atol=1e-7)


def test_competitors_are_interleaved_and_every_call_counts_once() -> None:
    order: list[str] = []
    entrants = {
        name: Entrant([lambda name=name: order.append(name)] * 30, rounds)  # type: ignore[misc]
        for name, rounds in (("a", 2), ("b", 1))
    }
    times = interleaved(entrants)
    assert (times["a"].shape, times["b"].shape) == ((2, 30), (1, 30))
    warm_up = 2 * (2 + 1)
    assert len(order) == 30 * 3 + warm_up
    assert order[:21] + order[21:42] == ["a"] * 21 + ["b"] * 21


def test_statistics_separate_the_solver_from_the_machine() -> None:
    times = np.ones((11, 100))
    times[5] = 50.0  # one round in which the machine was busy
    result = statistics(times)
    assert (result.median, result.p99, result.p99_of_problems) == (1.0, 50.0, 1.0)


def test_the_exponent_of_a_power_is_estimated() -> None:
    rows = [{"n": str(n), **dict.fromkeys(bench_growth.SERIES, 3.0 * n**1.5)} for n in (1, 4, 9)]
    for power in bench_growth.exponents("n", rows).values():
        assert power == pytest.approx(1.5)


def test_the_model_of_the_other_tools_is_that_of_ampc() -> None:
    for v_x in (1.0, 9.0, 27.0):
        A_k, B_k, A, B = np.zeros((5, 5)), np.zeros(5), np.zeros((5, 5)), np.zeros(5)
        zero_order_hold(VEHICLE, v_x, 0.0, limits().T, A_k, B_k, make_scratch(500))
        augment(A_k, B_k, A, B)
        for found, expected in zip(augmented_model(v_x), (A, B), strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-9)
    assert qp_of(Task(GAINS, math.inf, recorded_ticks()[0])).M.shape == (30, 5)


def test_the_message_of_a_long_path_is_the_one_that_ros_writes() -> None:
    points = np.random.default_rng(1).normal(size=(9, 2))
    expected = serialize_message(ros.path_message(points, 5, "map"))
    table = bench_inputs.serialized(points)
    assert len(table) == len(expected)
    assert has_positions_of(table, expected)
