"""Comparison of controllers and scenarios: same car, same noise, visible failures."""

import csv
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import LOWER, METRICS, evaluate_drive
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import Scenario, load_scenario
from ampc_ros.configuration import CONTROLLERS, Choices
from ampc_ros.controller import make_controller
from launch_scripts.compare import main
from launch_scripts.comparing.cells import Cell, Contender, best_of, drive_cell
from launch_scripts.comparing.conditions import COMPARED_METRICS, Conditions
from launch_scripts.comparing.results import three_digits
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file
from tests.html_pages import (
    CHROMIUM,
    Elements,
    check_that_no_request_leaves,
    check_widths,
    open_browser,
)
from tests.tools.test_python_api import blocks

REPEATED = [key for name, key in COMPARED_METRICS.items() if name != "solve_time"]
"""Metrics that every run reproduces."""
PREVIEW = Contender("preview", "preview", "preview_paper")
PAPER = Contender("paper", "paper", "table3")
CALM = Conditions()


def road(name: str, **changes: Any) -> Scenario:
    return load_scenario(name, load_vehicle_file(find("vehicles", "paper")).size)._replace(
        **changes
    )


def repeated(cell: Cell) -> list[float]:
    return [cell.numbers[key] for key in REPEATED]


def compare(folder: Path, *arguments: str) -> dict[str, Any]:
    """Run the command and return the content of its JSON file."""
    assert main([*arguments, "--output", str(folder)]) == 0
    content: dict[str, Any] = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    return content


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("compare")
    gains = output / "mine.yaml"
    gains.write_text(find("gains", "preview").read_text(encoding="utf-8"), encoding="utf-8")
    controllers = ["preview", f"preview={gains}", "paper", "classic", "pure_pursuit"]
    compare(output, "--controllers", *controllers, "--scenarios", "sc1", "sc2", "circle")
    return output


@pytest.fixture(scope="module")
def content(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    return found


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    return (folder / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("contender", [PREVIEW, PAPER, Contender("pp", "pure_pursuit", "")])
def test_a_cell_has_the_numbers_of_a_single_drive(contender: Contender) -> None:
    vehicle, scenario = load_vehicle_file(find("vehicles", "paper")), road("sc2")
    choices = Choices(contender.controller, gain_table=contender.gain_table)
    alone = drive(Simulation(vehicle, scenario), make_controller(choices))
    path = make_path(scenario.points)
    expected = evaluate_drive(alone, path, vehicle.chassis.cg_to_rear_axle, 0.1)
    cell = drive_cell(contender, scenario, CALM)
    shared = set(REPEATED) & set(expected)
    assert len(shared) >= 4
    assert {key: cell.numbers[key] for key in shared} == {key: expected[key] for key in shared}


def test_all_cells_of_a_road_get_the_same_noise_and_the_error_is_that_of_the_car() -> None:
    noisy = Conditions(noise="x1", seed=7)
    scenario, vehicle = road("sc1"), load_vehicle_file(find("vehicles", "paper"))
    noise = load(MeasurementNoise, find("noise", "x1"))
    measured = drive(
        Simulation(vehicle, scenario, noise=noise, rng=np.random.default_rng(7)),
        make_controller(Choices(gain_table="preview_paper")),
    )
    cell = drive_cell(PREVIEW, scenario, noisy)
    assert cell.driven is not None
    assert np.array_equal(cell.driven.drive.steering, measured.steering)
    deviation = [m.x - s.x for m, s in zip(measured.states, cell.driven.drive.states, strict=True)]
    assert np.std(deviation) == pytest.approx(noise.position, rel=0.2)


def test_the_same_seed_gives_the_same_numbers_and_another_one_others() -> None:
    scenario = road("sc1")
    first, again, other = (
        repeated(drive_cell(PREVIEW, scenario, Conditions(noise="x1", seed=seed)))
        for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_a_mirrored_road_is_driven_as_well_as_the_road() -> None:
    scenario = road("sc2")
    mirrored = scenario._replace(points=scenario.points * (1.0, -1.0))
    for contender in (PREVIEW, PAPER):
        numbers = [repeated(drive_cell(contender, s, CALM)) for s in (scenario, mirrored)]
        assert numbers[0] == pytest.approx(numbers[1], rel=1e-3)


@pytest.mark.parametrize(
    "worse", [CALM._replace(friction=0.3), CALM._replace(delay=0.2)], ids=["friction", "delay"]
)
def test_what_the_controller_does_not_know_makes_the_drive_worse(worse: Conditions) -> None:
    key, scenario = "rms_error_m", road("sc2")
    good, bad = (drive_cell(PREVIEW, scenario, c).numbers[key] for c in (CALM, worse))
    assert bad > 2 * good


def test_a_controller_that_refuses_a_path_is_a_cell_with_the_reason() -> None:
    cell = drive_cell(PAPER, road("circle"), CALM)
    assert (cell.outcome, cell.numbers, cell.kept) == ("refused", {}, False)
    assert "turns by 180 degrees against its chord" in cell.reason


def test_small_values_of_all_compared_metrics_are_better() -> None:
    assert {METRICS[key].direction for key in COMPARED_METRICS.values()} == {LOWER}


def test_a_lost_car_is_called_lost_and_is_never_the_best() -> None:
    lost = drive_cell(Contender("classic", "classic", "table3"), road("sc2"), CALM)
    assert lost.outcome.startswith("lost at ")
    small = dict.fromkeys(lost.numbers, 0.0)
    kept = Cell("preview", "sc2", dict.fromkeys(lost.numbers, 1.0))
    assert best_of([lost._replace(numbers=small), kept], "rms_error_m") == {"preview"}


def test_the_best_share_their_mark_and_where_all_are_alike_nobody_has_it() -> None:
    def cells(*values: float) -> list[Cell]:
        return [Cell(str(i), "sc1", {"mse_m2": value}) for i, value in enumerate(values)]

    assert best_of(cells(1.0, 1.004, 1.1), "mse_m2") == {"0", "1"}
    assert best_of(cells(1.0, 1.0), "mse_m2") == set()
    assert best_of(cells(0.0, 1.0), "mse_m2") == {"0"}
    assert best_of([], "mse_m2") == set()


def test_every_pair_has_one_cell_and_all_that_repeats_the_run_stands_beside_it(
    content: dict[str, Any],
) -> None:
    names = ["preview", "preview=mine", "paper", "classic", "pure_pursuit"]
    pairs = [(cell["scenario"], cell["controller"]) for cell in content["cells"]]
    assert pairs == [(s, name) for s in ("sc1", "sc2", "circle") for name in names]
    assert {"version", "command", "machine", "conditions"} <= set(content)
    assert content["conditions"]["seed"] == 0
    gains = {c["label"]: c["gains"] for c in content["controllers"]}
    assert gains["preview=mine"] == find("gains", "preview").read_text(encoding="utf-8")
    assert gains["preview"] == find("gains", "preview_paper").read_text(encoding="utf-8")
    assert gains["pure_pursuit"] == ""
    fates = {(c["scenario"], c["controller"]): c["fate"] for c in content["cells"]}
    assert fates["circle", "paper"] == "refused"
    assert fates["sc2", "classic"].startswith("lost")


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_the_page_is_readable_on_a_phone_a_tablet_and_a_desktop(folder: Path) -> None:
    with open_browser() as browser:
        check_widths(browser, folder / "page.html")


def test_the_page_loads_nothing_and_is_small(page: str) -> None:
    check_that_no_request_leaves(page)
    assert len(page.encode()) < 1_500_000
    images = [attributes for tag, attributes in Elements(page).found if tag == "img"]
    assert len(images) == 1 + 3
    assert all(image["alt"] for image in images)


def test_the_page_shows_every_number_that_was_driven_on_the_road(
    page: str, content: dict[str, Any]
) -> None:
    shown = [float(a["value"] or "") for tag, a in Elements(page).found if tag == "data"]
    known = [
        cell[key]
        for key in COMPARED_METRICS.values()
        for cell in content["cells"]
        if cell["fate"] == "driven"
    ]
    assert shown == known


def test_markdown_and_terminal_name_best_and_reason(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (folder / "compare.md").read_text(encoding="utf-8")
    assert re.search(r"\| sc2 \| \*\*0\.01\d\d\*\* \|", text)
    assert "* circle, paper: refused: reference_path: turns by 180 degrees" in text
    compare(folder / "again", "--scenarios", "circle", "--controllers", "pure_pursuit", "paper")
    said = capsys.readouterr().out
    assert "0.204 *" in said
    assert "circle, paper: refused: reference_path: turns by 180 degrees" in said


def test_a_users_road_is_a_scenario(tmp_path: Path) -> None:
    file = tmp_path / "bend.csv"
    rows = [f"{x},{4 * math.sin(x / 30)}" for x in range(0, 121, 2)]
    file.write_text("\n".join(["x_m,y_m", *rows]) + "\n", encoding="utf-8")
    found = compare(tmp_path / "out", "--scenarios", str(file), "--speed", "8")
    assert list(found["scenarios"]) == ["bend"]
    assert [cell["fate"] for cell in found["cells"]] == ["driven"] * len(CONTROLLERS)


def test_further_formats_hold_the_same_numbers(tmp_path: Path) -> None:
    arguments = ("--controllers", "preview", "paper", "--scenarios", "circle", "sc1")
    found = compare(tmp_path, *arguments, "--format", "csv", "svg", "pdf")
    with (tmp_path / "compare.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    heads = {key: f"{key} [{METRICS[key].unit}]" for key in COMPARED_METRICS.values()}
    assert [row["outcome"] for row in rows] == ["driven", "refused", "driven", "driven"]
    for row, cell in zip(rows, found["cells"], strict=True):
        assert (row["scenario"], row["controller"]) == (cell["scenario"], cell["controller"])
        for key, head in heads.items():
            assert row[head] == ("" if cell["fate"] == "refused" else repr(cell[key]))
    figures = {"compare.svg", "compare_circle.svg", "compare_sc1.svg"}
    assert {file.name for file in tmp_path.glob("*.svg")} == figures
    assert (tmp_path / "compare.pdf").read_bytes().startswith(b"%PDF")


def test_a_controller_of_a_user_is_compared_and_named_by_its_class(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "my_file.py"
    file.write_text(blocks("my_controller.md")[0], encoding="utf-8")
    arguments = ("--controllers", "preview", f"{file}:Stanley", "--scenarios", "sc1")
    content = compare(tmp_path / "out", *arguments)
    cells = {cell["controller"]: cell for cell in content["cells"]}
    assert [cell["fate"] for cell in cells.values()] == ["driven", "driven"]
    assert 0.01 < cells["Stanley"]["rms_error_m"] < 0.5
    assert content["controllers"][1]["controller"] == f"{file}:Stanley"
    assert "Stanley" in capsys.readouterr().out
    assert "Stanley" in (tmp_path / "out" / "page.html").read_text(encoding="utf-8")


def test_roads_on_which_nobody_drives_are_drawn_as_such(tmp_path: Path) -> None:
    found = compare(tmp_path, "--controllers", "paper", "--scenarios", "circle", "sine")
    assert [cell["fate"] for cell in found["cells"]] == ["refused", "driven"]
    assert "No controller completed this scenario." in (tmp_path / "page.html").read_text(
        encoding="utf-8"
    )
    compare(tmp_path, "--controllers", "paper", "--scenarios", "circle")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--controllers", "lqr"], "--controllers lqr: "),
        (["--controllers", "preview=x.yaml"], "--controllers preview=x.yaml: 'x.yaml' is neither"),
        (["--controllers", "preview="], "--controllers preview=: '' is neither a file nor one of"),
        (["--controllers", "pure_pursuit=preview"], "pure_pursuit has no gains"),
        (["--controllers", "paper", "paper"], "--controllers: 'paper' occurs twice"),
        (["--controllers", "absent.py:Stanley"], "--controllers absent.py:Stanley: "),
        (["--controllers", f"{__file__}:Absent"], "test_compare.py:Absent: "),
        (["--controllers", f"{__file__}:Contender=preview"], "Contender has no gains"),
        (["--controllers", f"paper={__file__}"], "test_compare.py: not YAML"),
        (["--scenarios", "sc9"], "--scenarios sc9: 'sc9' is neither a file nor one of the shipped"),
        (["--scenarios", "no.csv"], "--scenarios no.csv: no.csv: cannot be read"),
        (["--scenarios", "sc1", "sc1"], "--scenarios: 'sc1' occurs twice"),
        (["--vehicle", "lorry"], "--vehicle: 'lorry' is neither a file nor one of the shipped"),
        (["--settings", "fast"], "--settings: 'fast' is neither a file"),
        (["--noise", "x9"], "--noise: 'x9' is neither a file nor one of the shipped noise: x1"),
        (["--friction", "9"], "--friction = 9.0 must lie in [0.01, 3]"),
        (["--delay", "-1"], "--delay: delay = -1.0 must lie in [0, 2] s"),
        (["--seed", "-1"], "--seed = -1 must lie in [0, "),
        (["--laps", "0"], "--laps = 0 must lie in [1, "),
        (["--speed", "400"], "speed"),
        (["--output", __file__], "cannot create this folder"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_before_anything_is_driven(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["--output", str(tmp_path), *arguments]) == 2
    said = capsys.readouterr().out
    assert said.startswith("error: ")
    assert said.count("\n") == 1
    assert words in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0330, "0.0330"), (1.87e-6, "1.87e-06"), (14.04, "14.0"), (123.4, "123"), (0.0, "0")],
)
def test_numbers_have_three_digits(value: float, shown: str) -> None:
    assert three_digits(value) == shown


def test_controller_that_fails_ends_its_drive_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bodies = {
        "Raising": ("raise RuntimeError('boom')", "boom"),
        "NotFinite": ("return float('nan')", "not finite"),
        "Silent": ("pass", ""),
    }
    file = tmp_path / "mine.py"
    lines = [
        f"class {name}:\n    period = 0.1\n    def step(self, state, path):\n        {body}\n"
        for name, (body, _) in bodies.items()
    ]
    file.write_text("\n".join(lines))
    words = ("--controllers", "pure_pursuit", *(f"{file}:{name}" for name in bodies))
    content = compare(tmp_path / "out", *words, "--scenarios", "sc1")
    output = capsys.readouterr().out
    cells = {cell["controller"]: cell for cell in content["cells"]}
    assert cells.pop("pure_pursuit")["fate"] == "driven"
    for name, (_, text) in bodies.items():
        assert cells[name]["fate"] in ("gave up", "refused")
        assert text in cells[name]["reason"]
        assert text in output
