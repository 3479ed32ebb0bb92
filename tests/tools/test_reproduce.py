"""Page of the reproduction: complete, offline, and every number measured in its run."""

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ampc_ros.mpc.gain_table import Gains, load_gain_table
from ampc_ros.paper.controller import LateralMpc
from launch_scripts.reporting.pages import num, to_json
from launch_scripts.reporting.style import CONTROLLER_STYLES
from launch_scripts.reproduce import main, read_switches
from launch_scripts.study.claims import (
    DIRECTION,
    NO,
    PAPER_MSE,
    YES,
    conclusions,
    ratio_verdict,
    tuned_claim,
    wind_claim,
)
from launch_scripts.study.drives import (
    CONTENDERS,
    FIXED_SPEED,
    STUDY_ROADS,
    TunedGains,
    build_contender,
    drive_contender,
    drive_metrics,
    plant_vehicle,
    study_scenario,
)
from launch_scripts.study.measurements import (
    ABORT_ERROR,
    StudyPlan,
    aborted_mse,
    gain_dimensions,
    gain_fitness,
    gains_from_position,
    swarm_settings,
)
from launch_scripts.study.page import study_page
from launch_scripts.study.switches import DRIVE_SWITCHES, SEARCH_SWITCHES, STUDY_SWITCHES, WEAK
from launch_scripts.study.weak_baselines import measure_weak_baselines
from launch_scripts.tuning.fleet_rows import Entry, drive_fleet
from sim_vehicle.closed_loop import Simulation
from tests.html_pages import (
    CHROMIUM,
    Elements,
    check_that_no_request_leaves,
    check_widths,
    open_browser,
)

TABLE3 = load_gain_table("table3").nodes[0]
TUNED = TunedGains((0.5, 3.0), TABLE3, TABLE3)
PAPER: frozenset[str] = frozenset()
FIGURES = ("adaptation", "sphere", "tuning", "look_ahead", "sweep", "claim_by_speed")
"""Figures of the page beside one for each road."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("reproduce")
    assert main(["--quick", "--output", str(output)]) == 0
    return output


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    return (folder / "page.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def results(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    return content


def leaves(content: Any) -> Iterator[float]:
    """Yield all numbers of a JSON document."""
    if isinstance(content, dict):
        content = list(content.values())
    if isinstance(content, list):
        for item in content:
            yield from leaves(item)
    elif isinstance(content, (int, float)):
        yield float(content)


def test_every_number_of_the_page_is_in_the_results(page: str, results: dict[str, Any]) -> None:
    known = set(leaves(results))
    shown = [float(a["value"] or "") for tag, a in Elements(page).found if tag == "data"]
    assert len(shown) > 100
    assert set(shown) <= known


def test_numbers_in_tables_of_results_are_measured_ones(page: str) -> None:
    cells = re.findall(r'<td class="n"[^>]*>(.*?)</td>', page)
    assert len(cells) > 100
    for cell in cells:
        words = re.sub(r"<data .*?</data>", "", cell)
        assert not re.search(r"\d", re.sub(r"<[^>]*>", "", words)), cell


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_the_page_is_readable_on_a_phone_a_tablet_and_a_desktop(folder: Path) -> None:
    with open_browser() as browser:
        check_widths(browser, folder / "page.html")


def test_no_request_leaves_the_page(page: str) -> None:
    check_that_no_request_leaves(page)


def test_the_page_is_one_small_file_with_a_described_picture_for_each_figure(page: str) -> None:
    images = [attributes for tag, attributes in Elements(page).found if tag == "img"]
    roads = 2
    assert len(images) == roads + len(FIGURES)
    assert all(image["alt"] for image in images)
    assert len(page.encode()) < 5_000_000


def test_the_results_contain_all_that_is_needed_to_repeat_the_run(results: dict[str, Any]) -> None:
    assert {"command", "date", "seeds", "version", "machine", "packages"} <= set(results["meta"])
    assert "--quick" in results["meta"]["command"]
    assert results["duration_s"] > 0


def test_every_contender_has_a_number_on_every_road_driven(results: dict[str, Any]) -> None:
    for row in results["roads"].values():
        assert set(row) == set(CONTENDERS)
        assert all(measured["mse_m2"] >= 0 for measured in row.values())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--switch", "tire=paper"], "--switch tire=paper: 'tire' must be one of tyre"),
        (["--switch", "tyre=nobody"], "'nobody' must be one of paper, authors_code"),
        (["--switch", "tyre"], "--switch tyre: '' must be one of"),
        (["--sphere-seeds", "0"], "--sphere-seeds 0 must be at least 1"),
        (["--reading", "mine"], "invalid choice: 'mine'"),
        (["--output", __file__], "is a file, must be a folder"),
    ],
)
def test_bad_arguments_give_one_line(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(arguments)
    errors = [line for line in capsys.readouterr().err.splitlines() if "error:" in line]
    assert len(errors) == 1
    assert words in errors[0]


def test_a_switch_overrides_the_reading() -> None:
    assert read_switches("paper", []) == PAPER
    assert read_switches("authors_code", []) == set(STUDY_SWITCHES)
    assert read_switches("weak_baselines", ["tyre=authors_code"]) == {WEAK, "tyre"}
    assert read_switches("authors_code", ["tyre=paper"]) == set(STUDY_SWITCHES) - {"tyre"}
    assert read_switches("paper", ["tyre=authors_code", "tyre=paper"]) == PAPER


@pytest.mark.parametrize("switch", DRIVE_SWITCHES)
def test_a_switch_that_changes_drives_changes_a_drive(switch: str) -> None:
    windy = study_scenario("sc3_constant", duration=25.0)
    driven = [drive_contender("paper", windy, TUNED, frozenset(s)) for s in ((), (switch,))]
    assert not np.array_equal(driven[0].error, driven[1].error)


@pytest.mark.parametrize("switch", SEARCH_SWITCHES)
def test_a_switch_that_changes_searches_changes_one(switch: str) -> None:
    at = np.array([[0.8, 3.0, 10.0, 30.0, 1.0, -2.0]])

    def search(switches: frozenset[str]) -> tuple[Any, ...]:
        settings = swarm_settings(switches, StudyPlan(switches))
        fitness = gain_fitness(False, ("sc1",), switches)
        return settings, gain_dimensions(switches), float(fitness(at)[0])

    assert search(frozenset([switch])) != search(PAPER)


def test_the_adaptive_model_is_the_classic_one_where_speed_is_constant() -> None:
    mse = {
        n: drive_metrics(drive_contender(n, study_scenario("sc1"), TUNED))["mse_m2"]
        for n in ("paper", "classic")
    }
    assert mse["classic"] == pytest.approx(mse["paper"], rel=0.01)


def test_on_varying_speed_the_adaptive_model_is_three_times_better() -> None:
    mse = {
        n: drive_metrics(drive_contender(n, study_scenario("sc2"), TUNED))["mse_m2"]
        for n in ("paper", "classic")
    }
    assert mse["classic"] >= 3 * mse["paper"]


def test_at_18_m_s_the_fixed_model_is_lost_in_wind_and_without_and_the_adaptive_is_not() -> None:
    windy = study_scenario("sc3_fast_wind")
    for scenario in (windy, windy._replace(wind=())):
        assert np.abs(drive_contender("classic", scenario, TUNED).error).max() > 3
        assert np.abs(drive_contender("paper", scenario, TUNED).error).max() < 1.5


@pytest.mark.parametrize(
    ("here", "paper", "lost", "verdict"),
    [
        (4.0, 3.9, False, YES),
        (4.0, 3.9, True, DIRECTION),
        (6.0, 3.9, False, DIRECTION),
        (2.5, 3.9, False, DIRECTION),
        (1.05, 3.9, False, NO),
        (0.2, 3.9, False, NO),
    ],
)
def test_a_ratio_is_judged_by_direction_and_size(
    here: float, paper: float, lost: bool, verdict: str
) -> None:
    assert ratio_verdict(here, paper, lost) == verdict


@pytest.mark.parametrize(
    ("own", "its", "calm", "verdict"),
    [(1.0, 9.0, 1.0, YES), (1.0, 9.0, 9.0, DIRECTION), (1.0, 2.0, 1.0, NO), (5.0, 9.0, 1.0, NO)],
)
def test_wind_counts_as_a_cause_only_if_calm_air_is_harmless(
    own: float, its: float, calm: float, verdict: str
) -> None:
    effect = {
        "paper": {"wind_m": own, "calm_m": 1.0},
        "classic": {"wind_m": its, "calm_m": calm},
    }
    judged = wind_claim({"wind_effect": {"sc3_wind": effect}}, "sc3_wind", "here", "")
    assert judged["verdict"] == verdict


def test_claims_about_roads_that_were_not_driven_are_left_out(results: dict[str, Any]) -> None:
    checked = conclusions(results)["claims"]
    assert checked == results["claims"]
    assert not [claim for claim in checked if "Sc3," in claim["claim"]]


@pytest.mark.parametrize(("factor", "verdict"), [(2.0, NO), (1 / 1.05, NO), (0.5, YES)])
def test_table_tuned_on_a_step_and_set_tuned_on_roads_are_judged_each_by_its_own_errors(
    results: dict[str, Any], factor: float, verdict: str
) -> None:
    for name, condition in (("paper_pso", "table, tuned by a step"), ("paper_one", "one set")):
        roads = {
            road: {**row, name: {"mse_m2": factor * row["paper"]["mse_m2"], "lost": False}}
            for road, row in results["roads"].items()
        }
        (judged,) = (
            claim
            for claim in conclusions({**results, "roads": roads})["claims"]
            if condition in claim["claim"]
        )
        assert judged["verdict"] == verdict
        assert judged["here"][1::2] == pytest.approx([1 / factor] * 2)


def test_one_road_on_which_tuning_helps_is_a_direction(results: dict[str, Any]) -> None:
    roads = {r: {"paper": {"mse_m2": 1.0}, "x": {"mse_m2": 1.0}} for r in ("a", "b")}
    roads["b"]["x"]["mse_m2"] = 0.5
    assert tuned_claim({"roads": roads}, "x", "", "")["verdict"] == DIRECTION


def test_weak_baselines_result_in_the_order_and_the_ratios_of_the_paper() -> None:
    measured = measure_weak_baselines(tuple(STUDY_ROADS), PAPER)
    assert set(measured) == set(PAPER_MSE)
    for row in measured.values():
        assert row["mse_m2"]["paper"] < row["mse_m2"]["classic"] < row["mse_m2"]["pure_pursuit"]
        assert row["order"]
        assert 0.5 < row["ratio"]["classic"] / row["paper_ratio"]["classic"] < 2.0
        # the fixed model with the gains of the AMPC is nearly as good as the AMPC, or better
        assert row["same_gains"] < 1.2


def test_hand_set_gains_of_the_weak_reading_differ_in_the_increment_weight_alone() -> None:
    weights = {}
    for name in ("paper", "classic", "paper_one", "classic_pso"):
        steering = build_contender(name, 9.0, TUNED, frozenset({WEAK}))
        assert isinstance(steering, LateralMpc)
        (row,) = steering.table.nodes
        weights[name] = Gains(*row).increment_weight
        assert Gains(*row)[:5] == TABLE3[:5]
    table3 = TABLE3.increment_weight
    expected = {"paper": 10.0, "classic": 1000.0, "paper_one": table3, "classic_pso": table3}
    assert weights == expected


def test_labels_of_the_weak_reading_name_its_gains(results: dict[str, Any]) -> None:
    figures = dict.fromkeys((*results["roads"], *FIGURES), "")
    weak = {**results["meta"], "reading": WEAK, "quick": False}
    text = study_page({**results, "meta": weak}, figures)
    assert "AMPC, Table 3" not in text
    assert "classic MPC, R = 1000" in text
    assert "set-point matters more" not in text


def test_the_missing_ticks_of_an_aborted_drive_count_with_the_abort_error() -> None:
    scenario = study_scenario("sc1", duration=10.0)
    steering = build_contender("paper", FIXED_SPEED["sc1"], TUNED, PAPER)
    car = Entry(Simulation(plant_vehicle(PAPER), scenario), steering)  # type: ignore[arg-type]
    (driven,) = drive_fleet([car], lost=0.2)
    whole = aborted_mse(driven, car)
    missing = 100 - len(driven.states)
    assert missing > 0
    assert whole == pytest.approx(missing / 100 * ABORT_ERROR**2, rel=0.01)


def test_gains_of_a_particle_keep_the_horizons_in_order() -> None:
    gains = gains_from_position(np.array([0.5, 6.0, 30.0, 5.0, 1.0, -2.0]))
    assert (gains.prediction_horizon, gains.control_horizon, gains.laguerre_terms) == (5, 5, 5)
    assert (gains.output_weight, gains.increment_weight) == pytest.approx((10.0, 0.01))


def test_singular_gains_have_no_fitness() -> None:
    singular = np.array([[0.9, 9.0, 18.0, 55.0, 1.0, -3.0]])
    assert math.isinf(gain_fitness(False, ("sc1",), PAPER)(singular)[0])


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.03344, "0.0334"), (1.8709e-6, "1.87e-6"), (461.2, "461"), (13589.0, "13,600"), (3, "3")],
)
def test_numbers_are_short_and_carry_their_value(value: float, shown: str) -> None:
    assert num(value) == f'<data value="{value!r}">{shown}</data>'


def test_text_of_the_page_is_escaped(results: dict[str, Any]) -> None:
    names = (*results["roads"], *FIGURES)
    meta = {**results["meta"], "command": "<i>command</i>"}
    text = study_page({**results, "meta": meta}, dict.fromkeys(names, ""))
    assert "<i>" not in text
    assert text.count("&lt;i&gt;command&lt;/i&gt;") == 2


def test_every_switch_is_explained_on_the_page(page: str) -> None:
    changes = re.findall(r'<th scope="row">(\w+)</th>.*data-head="changes">(\w+)<', page)
    assert changes == [
        *((name, "drive") for name in DRIVE_SWITCHES),
        *((name, "search") for name in SEARCH_SWITCHES),
    ]


def test_explanations_appear_only_with_a_complete_run_of_the_papers_reading(
    results: dict[str, Any],
) -> None:
    names = (*results["roads"], *FIGURES)
    for quick, authors_code in ((False, []), (True, []), (False, ["tyre"])):
        meta = {**results["meta"], "quick": quick, "authors_code": authors_code}
        text = study_page({**results, "meta": meta}, dict.fromkeys(names, ""))
        explained = not quick and not authors_code
        assert ("set-point matters more" in text) == explained
        assert ("With a tuned look-ahead" in text) == explained


def test_names_fit_together() -> None:
    assert set(PAPER_MSE) <= set(STUDY_ROADS) == set(FIXED_SPEED)
    assert set(CONTROLLER_STYLES) >= {"paper", "classic", "pure_pursuit", "preview"}
    assert to_json({"a": [math.inf, 1.0]}) == {"a": [None, 1.0]}
