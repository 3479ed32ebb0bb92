"""Tuning tasks: search space, searches, checkpoints, and rejected options."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.types import Array
from launch_scripts.tune import build_parser, command_of, main
from launch_scripts.tuning.choices import FORMULATIONS, METHOD_NAMES, SYMBOLS
from launch_scripts.tuning.methods import SEARCH_METHODS, SearchRecord
from launch_scripts.tuning.report import hand_set_table
from launch_scripts.tuning.search import Checkpoints, write_atomically
from launch_scripts.tuning.task import (
    DEFAULT_BOUNDS,
    DEFAULT_TUNED,
    PRESETS,
    Search,
    read_task,
    search_space,
)

FIXED = PRESETS["preview"].space.fixed
PAPER_GRID = ["--formulation", "paper", "--speeds", "3", "9", "--references", "0", "15"]


def task(*words: str):  # type: ignore[no-untyped-def]
    return read_task(build_parser().parse_args(words))


def record() -> SearchRecord:
    """Return the evaluations of a search in which some cars are lost."""
    where = search_space({"R": (1.0, 100.0)}, FIXED).dimensions
    result = SearchRecord(lambda x: np.where(x[:, 0] < 1.0, x[:, 0] / 3.0, np.inf), where, 9)
    unit: Array = np.array([[k / 10.0] for k in range(1, 9)])
    result(unit)
    return result


def test_weights_are_searched_in_the_logarithm() -> None:
    space = search_space({"R": (1.0, 1e4), "alpha": (0.0, 0.8)}, FIXED)
    rows = space.gains_at(np.array([[0.0, 0.0], [2.0, 0.4], [4.0, 0.8]]))
    np.testing.assert_allclose(rows[:, 5], [1.0, 100.0, 1e4])
    np.testing.assert_allclose(rows[:, 3], [0.0, 0.4, 0.8])
    np.testing.assert_array_equal(rows[:, :3], [FIXED[:3]] * 3)


def test_control_horizon_and_terms_stay_within_the_prediction_horizon() -> None:
    space = search_space({"N_p": (1, 50), "N_c": (1, 50), "N": (1, 9)}, FIXED)
    rows = space.gains_at(np.array([[4.0, 50.0, 9.0], [50.0, 3.0, 2.0]]))
    np.testing.assert_array_equal(rows[:, :3], [[4, 4, 4], [50, 3, 2]])


@pytest.mark.parametrize("method", ["pso", "paper", "de"])
def test_table_and_single_set_drive_the_same_number_of_cars(method: str) -> None:
    some = task("--speeds", "5", "9", "15", "--seeds", "3", "--method", method)
    cost: dict[str, int] = {}
    searches = some.searches()
    searches += some.polishes(3, [FIXED] * 3) if some.is_smooth else []
    for job in searches:
        purpose = "single" if job.purpose == "single" else "table"
        cost[purpose] = cost.get(purpose, 0) + job.drives
    assert len(set(cost.values())) == 1
    assert set(cost) == {"table", "single"}


@pytest.mark.parametrize("speed", [3.0, 7.0, 40.0])
def test_bounds_of_the_increment_weight_grow_with_the_square_of_the_speed(speed: float) -> None:
    space = task("--bounds", "R/v^2=0.5:4").space.at([speed])
    assert space.bounds == (("alpha", 0.0, 0.9), ("R", 0.5 * speed**2, 4.0 * speed**2))
    both = task().space.at([speed, 2.0 * speed]).bounds[1]
    assert both == ("R", pytest.approx(0.05 * speed**2), pytest.approx(20.0 * 4.0 * speed**2))
    assert task("--bounds", "R=3:5").space.at([speed]).bounds[1] == ("R", 3.0, 5.0)


@pytest.mark.parametrize(("settings", "ticks"), [("50hz", 5), ("100hz", 10)])
def test_bounds_follow_the_period_of_the_settings(settings: str, ticks: int) -> None:
    slow, fast = task().space, task("--settings", settings).space
    assert fast.bounds[0][2] == pytest.approx(0.9 ** (1 / ticks))
    assert fast.bounds[1][1:] == pytest.approx([x * ticks**2 for x in slow.bounds[1][1:]])
    assert fast.fixed.prediction_horizon == 100
    assert fast.fixed.control_horizon == 80
    assert fast.fixed.laguerre_terms == slow.fixed.laguerre_terms


@pytest.mark.parametrize(("settings", "name"), [("table3", "preview"), ("50hz", "preview_50hz"),
                                                ("100hz", "preview_100hz")])  # fmt: skip
def test_hand_set_gains_are_those_of_the_period_whatever_the_file_is_called(
    settings: str, name: str, tmp_path: Path
) -> None:
    own = tmp_path / "mine.yaml"
    own.write_bytes(find("controllers", settings).read_bytes())
    assert hand_set_table(task("--settings", settings)) == name
    assert hand_set_table(task("--settings", str(own))) == name


def test_the_literal_method_tunes_what_the_authors_tune() -> None:
    literal = task("--formulation", "paper", "--method", "paper")
    assert [symbol for symbol, _, _ in literal.space.bounds] == ["N_p", "N_c", "alpha", "R"]
    assert (literal.evaluations, literal.generation) == (20 * 16, 20)
    assert not literal.is_smooth


def test_references_beyond_two_seconds_of_speed_are_not_searched() -> None:
    some = task(*PAPER_GRID)
    places = {(n.speed, n.reference) for job in some.searches() for n in job.nodes}
    assert places == {(3.0, 0.0), (9.0, 0.0), (9.0, 15.0)}


def test_held_out_speeds_lie_half_way_between_those_of_the_grid() -> None:
    assert [node.speed for node in task("--speeds", "4", "6", "10").held_out_nodes()] == [5.0, 8.0]


def test_every_search_has_random_numbers_of_its_own_that_depend_on_seed_and_node() -> None:
    def first(search: Search) -> float:
        return float(search.rng.random())

    jobs = task("--speeds", "5", "9", "--seeds", "1", "2").searches()
    assert len({first(job) for job in jobs}) == len(jobs)
    assert first(next(j for j in jobs if j.name == "table_2_001")) == float(
        np.random.default_rng([2, 1]).random()
    )


def test_a_gap_in_a_table_takes_the_gains_of_its_neighbour_at_the_same_speed() -> None:
    gains = [FIXED._replace(increment_weight=R) for R in (1.0, 2.0, 3.0)]
    places = [(3.0, 0.0), (9.0, 0.0), (9.0, 15.0)]
    table = task(*PAPER_GRID).build_table(dict(zip(places, gains, strict=True)))
    assert [node.increment_weight for node in table.nodes] == [1.0, 1.0, 2.0, 3.0]


def test_the_command_leads_to_the_same_task() -> None:
    words = [*PAPER_GRID, "--tune", "alpha", "R", "--bounds", "R=0.1:5", "--fix", "N_p=30"]
    chosen = build_parser().parse_args([*words, "--resume", "--workers", "1", "--output", "a.yaml"])
    command = command_of(chosen).split()
    assert command[:2] == ["python", "launch_scripts/tune.py"]
    assert task(*command[2:]) == read_task(chosen)
    assert not {"--resume", "--workers", "--output"} & set(command)


def test_a_task_describes_itself_in_json() -> None:
    described = task(*PAPER_GRID).describe()
    assert json.loads(json.dumps(described)) == described
    assert described["bounds"]["alpha"] == [0.75, 0.99]
    assert "output_weight" not in described
    assert described["fixed"] == {"N_p": 25, "N_c": 12, "N": 3, "Q": 10.0}


WRONG = {
    "--speeds": "speeds = [] must have at least one value",
    "--speeds 9 nan": "speeds[1] = nan must lie in [0.5, 100]",
    "--speeds 9 5": "speeds[1] = 5 must be greater than 9",
    "--speeds 0": "speeds[0] = 0.0 must lie in [0.5, 100]",
    "--references 0 5": "references = [0.0, 5.0] must be [0] for fitness robust",
    "--formulation paper --speeds 3 --references 15": "none is reachable",
    "--bounds R=5:1": "bounds: R.low = 5.0 must be below R.high = 1.0",
    "--bounds R=1:nan": "bounds: R.high = nan must lie in",
    "--bounds R=0:1": "bounds: R.low = 0.0 must lie in [1e-09, 1e+09]",
    "--bounds R/v^2=0:1": "bounds: R/v^2.low = 0.0 must lie in [1e-09, 1e+09]",
    "--tune alpha --bounds R/v^2=1:2": "--bounds R/v^2: is not among the tuned, alpha",
    "--fix alpha=0.5": "--fix alpha=0.5: alpha is tuned: name the tuned gains with --tune",
    "--bounds R=1:2 R/v^2=1:2": "--bounds R=1:2: R has bounds already: name R or R/v^2",
    "--output a.json": "--output a.json: must be a file that ends with .yaml",
    "--output .": "--output .: must be a file that ends with .yaml",
    "--tune N_p R": "--tune N_p: horizons and terms are equal at all nodes",
    "--particles 5": "--particles: is an option of --method paper, not pso",
    "--method de --generations 5": "--generations: is an option of --method paper, not de",
    "--method paper --evaluations 50": "--evaluations: is no option of --method paper",
    "--evaluations 3": "evaluations = 3 must lie in [12, 1e+06]",
    "--settings 30hz": "'30hz' is neither a file nor one of the shipped controllers",
    "--bounds alpha=0:1": "bounds: alpha.high = 1.0 must lie in [0, 0.999]",
    "--tune N_p --method paper --bounds N_p=1:2.5": "bounds: N_p.high = 2.5 must be a whole number",
    "--bounds R=5": "--bounds R=5: must look like R=1:1e4",
    "--bounds Z=1:2": "unknown gain 'Z'; known are N_p, N_c, N, alpha, Q, R",
    "--bounds Q=1:2": "--bounds Q: is not among the tuned, alpha, R",
    "--fix Z=1": "--fix Z=1: unknown gain; known are N_p",
    "--fix N_p=a": "--fix N_p=a: must look like N_p=25",
    "--fix N_p=0": "fixed: N_p = 0 must lie in [1, 200]",
    "--seeds 1 1": "seeds = [1, 1] must be different",
    "--method paper --particles 1": "particles = 1 must lie in [2, 1e+06]",
    "--workers 0": "--workers 0: must be at least 1",
    "--vehicle nowhere.yaml": "'nowhere.yaml' is neither a file nor one of the shipped vehicles",
    "--resume --output nowhere/a.yaml": "nowhere/a.checkpoint: nothing to resume",
    "--scheduler tcp://127.0.0.1:9": "--trust-scheduler",
    "--scheduler tcp://127.0.0.1:9 --trust-scheduler": "127.0.0.1:9: no scheduler answers",
}


@pytest.mark.parametrize("words", WRONG)
def test_a_wrong_option_gives_one_error_line_with_key_value_and_bound(
    words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "scheduler" in words:
        pytest.importorskip("distributed", reason="Dask is an optional extra")
        monkeypatch.setattr("launch_scripts.tuning.workers.CONNECTION_TIMEOUT", 1)
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 2
    said = capsys.readouterr().out
    assert WRONG[words] in said
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_vehicle_file_is_named_with_key_value_and_bound(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from ampc_msgs_config.config import find

    file = tmp_path / "light.yaml"
    file.write_text(find("vehicles", "paper").read_text().replace("mass: 1575.0", "mass: -1.0"))
    assert main(["--vehicle", str(file)]) == 2
    said = capsys.readouterr().out
    assert f"{file}: chassis.mass = -1.0 must lie in [1, 100000] kg" in said


def test_a_checkpoint_gives_back_the_evaluations_bit_for_bit(tmp_path: Path) -> None:
    kept, written = Checkpoints(tmp_path / "c"), record()
    kept.begin({"a": 1}, False)
    kept.save("x", written)
    loaded = kept.load("x")
    assert loaded is not None
    assert np.isinf(written.fitness).any()
    np.testing.assert_array_equal(loaded[0], written.positions)
    np.testing.assert_array_equal(loaded[1], written.fitness)
    assert kept.load("y") is None


def test_a_checkpoint_of_another_task_is_refused_with_the_field_that_differs(
    tmp_path: Path,
) -> None:
    kept, some = Checkpoints(tmp_path / "c"), task("--speeds", "5", "9").describe()
    kept.begin(some, False)
    kept.begin(some, True)
    with pytest.raises(ValueError, match=r"speed = \[5.0, 9.0\], now \[5.0, 8.0\]"):
        kept.begin(task("--speeds", "5", "8").describe(), True)
    with pytest.raises(ValueError, match=r"c: .*--resume"):
        kept.begin(some, False)


def test_a_file_that_is_not_a_checkpoint_is_named(tmp_path: Path) -> None:
    kept = Checkpoints(tmp_path / "c")
    kept.begin({"a": 1}, False)
    for text, cause in (
        ("{", "cannot be read"),
        ("[" * 10**6, "cannot be read"),
        ("[]", "must hold"),
        ("{}", "not a checkpoint"),
        ('{"positions": [[1]], "fitness": [1, 2]}', "not a checkpoint"),
        ('{"positions": [["a"]], "fitness": [1]}', "not a checkpoint"),
    ):
        (kept.folder / "x.json").write_text(text)
        with pytest.raises(ValueError, match=f"x.json: {cause}"):
            kept.load("x")


def test_a_full_disk_keeps_the_previous_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    file = tmp_path / "a.json"
    write_atomically(file, "old")
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(ValueError, match=r"a.json: cannot be written: No space left on device"):
            write_atomically(file, "new")
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]
    write_atomically(file, "new")
    assert file.read_text() == "new"


def test_presets_are_valid_tasks() -> None:
    assert PRESETS.keys() == {*FORMULATIONS}
    assert SEARCH_METHODS.keys() == {*METHOD_NAMES}
    for name in PRESETS:
        chosen = task("--formulation", name)
        tuned = {symbol.removesuffix("/v^2") for symbol, _, _ in chosen.space.bounds}
        assert tuned == set(DEFAULT_TUNED[name])
        assert {key.removesuffix("/v^2") for key in DEFAULT_BOUNDS[name]} == set(SYMBOLS)
        assert chosen == PRESETS[name]._replace(space=chosen.space)
