"""Training of learned schedules, and their comparison with tables."""

import math
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config.config import read
from ampc_ros.mpc.gain_schedule import Anfis, Network, Situation, scheduled_gains
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from launch_scripts import tune
from launch_scripts.study import learned_schedule
from launch_scripts.study.learned_schedule import DrivenGains, judge_at, main, verdict
from launch_scripts.tuning import learning
from launch_scripts.tuning.choices import SCHEDULES
from launch_scripts.tuning.drives import STRAIGHT_CURVATURE
from launch_scripts.tuning.fitness import JUDGED, fitness
from launch_scripts.tuning.learning import Learned, Target, fit_schedule, situations
from launch_scripts.tuning.task import read_task

TASK = read_task(tune.build_parser().parse_args(["--vehicle", "ordinary"]))


def targets() -> list[Target]:
    """Return targets on a smooth function of the situation."""
    return [
        Target(Situation(v, curvature, latency), gains_at(v, curvature, latency), 1.0)
        for v in (3.0, 6.0, 11.0, 20.0, 40.0)
        for curvature in (3.0e-4, 3.0e-3, 0.03)
        for latency in (0.0, 0.2)
    ]


def gains_at(v: float, curvature: float, latency: float) -> Gains:
    """Return gains that depend smoothly on the situation."""
    pole = 0.5 + 0.1 * math.log10(v) + latency - 0.02 * math.log10(curvature / 3.0e-4)
    return Gains(25, 20, 3, pole, 10.0, 0.5 * v**2 * (1.0 + latency))


@pytest.mark.parametrize("kind", SCHEDULES)
def test_a_fit_meets_smooth_targets_and_repeats_bit_for_bit(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learning, "FIT_STARTS", 1)
    monkeypatch.setattr(learning, "MOST_FIT_STEPS", 12)
    schedule, residual = fit_schedule(kind, targets(), 1)
    assert isinstance(schedule, Network if kind == "network" else Anfis)
    assert residual < 0.1
    for target in targets():
        gains = scheduled_gains(schedule, target.situation)
        assert gains
        assert gains.laguerre_pole == pytest.approx(target.gains.laguerre_pole, abs=0.03)
        ratio = gains.increment_weight / target.gains.increment_weight
        assert abs(math.log10(ratio)) < 0.15
    if kind == "network":  # the targets are too few to determine the slopes of an ANFIS
        between = scheduled_gains(schedule, Situation(13.0, 0.002, 0.1))
        assert between
        wanted = gains_at(13.0, 0.002, 0.1)
        assert between.laguerre_pole == pytest.approx(wanted.laguerre_pole, abs=0.08)
    assert fit_schedule(kind, targets(), 1) == (schedule, residual)


def test_situations_cover_straight_and_bent_roads_at_all_speeds_with_the_training_cars() -> None:
    places = situations(TASK)
    assert len(places) == 9 * len(TASK.speeds)
    for situation, node in places:
        names = {plant.road for plant in node.plants}
        assert (
            names == {"lane change", "joining"}
            if situation.curvature <= STRAIGHT_CURVATURE
            else names
        )
        assert all(plant.known_delay == plant.known_lag == 0.0 for plant in node.plants)
        assert situation.curvature <= max(2.5 / situation.speed**2, STRAIGHT_CURVATURE) * (
            1 + 1e-12
        )
    assert {round(at.latency, 9) for at, _ in places} == {0.0, 0.1, 0.2}


def test_the_command_writes_a_file_that_loads_and_states_its_origin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for key, value in {"FIT_STARTS": 1, "MOST_FIT_STEPS": 3, "ADDED_LATENCIES": (0.0, 0.1)}.items():
        monkeypatch.setattr(learning, key, value)
    monkeypatch.setattr(learning, "SHARES", (1.0,))
    file = tmp_path / "mine.yaml"
    options = ["--speeds", "8", "15", "--evaluations", "12", "--seeds", "3", "--workers", "1"]
    assert tune.main([*options, "--schedule", "network", "--output", str(file)]) == 0
    table, origin = load_gain_table(str(file)), read(file)["provenance"]
    assert isinstance(table.schedule, Network)
    assert len(table.nodes) == 1
    assert table.schedule.speed == (8.0, 15.0)
    assert (origin["schedule"], origin["seeds"], origin["targets"]) == ("network", [3], 4)
    assert "--schedule network" in origin["command"]
    assert not file.with_suffix(".checkpoint").exists()


@pytest.mark.parametrize(
    "options", [["--formulation", "paper"], ["--speeds", "9"]], ids=["paper", "one speed"]
)
def test_what_cannot_be_learned_is_a_wrong_option(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = ["--output", str(tmp_path / "mine.yaml")]
    assert tune.main([*options, "--schedule", "anfis", *output]) == tune.WRONG
    assert "error: --schedule: needs" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


def test_drives_in_python_have_the_fitness_of_the_fleet() -> None:
    node = TASK.nodes((9.5,))[0]._replace(kind=JUDGED)
    gains = load_gain_table("preview").lookup(9.5).gains
    table = GainTable([9.5], [0.0], [gains])
    assert judge_at(node, table) == pytest.approx(fitness(node, [gains])[0], rel=1e-9)


def test_a_schedule_may_become_the_default_only_if_it_saves_enough() -> None:
    values = {"single": 1.2, "table": 1.0, "network": 0.96, "anfis": 1.1}
    driven = [DrivenGains(name, np.full(3, value), 0.0) for name, value in values.items()]
    assert "network saves 4.0% against the table: it does not reach the 5%" in verdict("x", driven)
    driven[2] = DrivenGains("network", np.array([0.9, 0.95, 0.99]), 0.0)
    assert "it reaches the 5%" in verdict("x", driven)


def test_the_page_has_a_row_for_each_candidate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learning, "FIT_STARTS", 1)
    monkeypatch.setattr(learning, "MOST_FIT_STEPS", 1)
    fitted = {kind: fit_schedule(kind, targets(), 1) for kind in SCHEDULES}
    single = gains_at(9.0, 0.01, 0.0)
    learned = {
        kind: Learned(kind, item, single, targets(), 0.5) for kind, (item, _) in fitted.items()
    }
    monkeypatch.setattr(learned_schedule, "learn_both", lambda *_: learned)
    fake = {"single": 1.1, "table": 1.0, "network": 1.02, "anfis": 0.99}
    judged = lambda name, table, task: DrivenGains(name, np.full(9, fake[name]), 0.0)  # noqa: E731
    monkeypatch.setattr(learned_schedule, "judge_gains", judged)
    page = tmp_path / "page.md"
    assert main(["--update", str(page), "--vehicles", "paper"]) == 0
    text = page.read_text(encoding="utf-8")
    assert [line.split(" | ")[1] for line in text.splitlines() if line.startswith("| `")] == [*fake]
    assert "the anfis saves 1.0% against the table: it does not reach the 5%" in text
