"""The shipped tuned tables: their vehicle, their provenance, and their advantage."""

import json
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config import config
from ampc_msgs_config.types import Array
from ampc_ros.configuration import Choices, default_table
from ampc_ros.controller import make_controller
from ampc_ros.mpc.gain_table import gain_table, load_gain_table
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.tune import build_parser
from launch_scripts.tuning.fitness import JUDGED, Node, fitness
from launch_scripts.tuning.task import is_reachable, read_task
from sim_vehicle.parameters import load_vehicle_file

TUNED = {"paper_pso": "paper", "preview_paper": "paper", "preview_ordinary": "ordinary"}


def content(name: str) -> dict[str, object]:
    return config.read(config.find("gains", name))


@pytest.mark.parametrize("name", TUNED)
def test_the_command_in_a_table_describes_the_task_that_made_it(name: str) -> None:
    origin = content(name)["provenance"]
    assert isinstance(origin, dict)
    words = origin["command"].split()
    assert words[:2] == ["python", "launch_scripts/tune.py"]
    described = read_task(build_parser().parse_args(words[2:])).describe()
    assert {key: origin[key] for key in described} == json.loads(json.dumps(described))
    assert origin["vehicle"] == TUNED[name]
    assert len(origin["seeds"]) >= 2


@pytest.mark.parametrize("name", TUNED)
def test_a_shipped_table_is_what_its_verdict_says(name: str) -> None:
    table_file = content(name)
    provenance, table = table_file["provenance"], gain_table(table_file)
    assert isinstance(provenance, dict)
    assert provenance["verdict"].endswith("table written") == (len(set(table.nodes)) > 1)


def test_a_shipped_vehicle_gets_its_own_table_and_any_other_the_one_for_all(tmp_path) -> None:  # type: ignore[no-untyped-def]
    own = tmp_path / "paper.yaml"
    own.write_bytes(config.find("vehicles", "paper").read_bytes())
    assert default_table("preview", "paper") == "preview_paper"
    assert default_table("preview", "ordinary") == "preview_ordinary"
    assert default_table("preview", str(own)) == "preview"
    assert default_table("paper", "paper") == default_table("classic", "paper") == "table3"
    for vehicle, name in (("ordinary", "preview_ordinary"), (str(own), "preview")):
        controller = make_controller(Choices(vehicle=vehicle))
        assert isinstance(controller, PreviewMpc)
        expected = np.array(load_gain_table(name).nodes, dtype=float)
        np.testing.assert_array_equal(controller.table.nodes, expected)


@pytest.mark.parametrize("car", ["paper", "ordinary"])
@pytest.mark.parametrize("v", [6.5, 17.5, 36.5])
def test_the_default_gains_are_better_than_hand_set_ones_at_each_speed(car: str, v: float) -> None:
    node = Node(load_vehicle_file(config.find("vehicles", car)), "preview", "robust", v)
    tables = [load_gain_table(name) for name in (default_table("preview", car), "preview")]
    tuned, hand_set = fitness(node, [table.lookup(v).gains for table in tables])
    assert tuned < 0.95 * hand_set


def proof(name: str) -> dict[str, Any]:
    """Return the proof beside a shipped table."""
    file = config.find("gains", name).with_suffix(".json")
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


@pytest.mark.parametrize("name", TUNED)
def test_the_written_gains_and_the_verdict_are_those_of_the_proof(name: str) -> None:
    shown, file = proof(name), content(name)
    provenance = file["provenance"]
    assert isinstance(provenance, dict)
    assert provenance["verdict"] == shown["verdict"]
    written = shown["candidates"][shown["written"]]["gains"]
    nodes = np.array(gain_table(file).nodes, dtype=float)
    np.testing.assert_array_equal(nodes, written[: len(nodes)])
    is_table = shown["written"].startswith("table")
    assert is_table == shown["verdict"].endswith(": table written")


@pytest.mark.parametrize("name", TUNED)
def test_the_proof_decides_by_the_rule(name: str) -> None:
    shown = proof(name)
    items = shown["candidates"]
    best = {
        kind: min(
            (item for key, item in items.items() if key.startswith(f"{kind}, ")),
            key=lambda item: item["geometric_mean"][0] or np.inf,
        )
        for kind in ("table", "single")
    }
    hand_set = next(item for key, item in items.items() if key.startswith("shipped"))
    table, single = (values(best[kind]["between"]) for kind in ("table", "single"))
    saved = 1.0 - np.exp(np.mean(np.log(table)) - np.mean(np.log(single)))
    ours, other = (values(item["held_out"] + item["between"]) for item in (best["table"], hand_set))
    compared = np.isfinite(other)
    fulfilled = saved >= 0.10 and np.max(ours[compared] / other[compared]) <= 1.02
    assert shown["written"].startswith("table") == fulfilled


def values(numbers: list[float | None]) -> Array:
    """Return the numbers of a proof; null is infinite."""
    return np.array([np.inf if number is None else number for number in numbers])


@pytest.mark.parametrize("name", ["preview_paper", "preview_ordinary"])
def test_the_fitness_in_the_proof_can_be_repeated(name: str) -> None:
    shown = proof(name)
    task = read_task(build_parser().parse_args(content(name)["provenance"]["command"].split()[2:]))  # type: ignore[index]
    item = shown["candidates"][shown["written"]]
    node = task.held_out_nodes()[-1]._replace(kind=JUDGED)
    gains = load_gain_table(name).lookup(node.speed).gains
    assert fitness(node, [gains])[0] == pytest.approx(item["between"][-1], rel=1e-9)


def test_the_tuned_table_of_the_paper_steps_better_than_table_3() -> None:
    task = read_task(build_parser().parse_args(["--formulation", "paper"]))
    ratios = []
    for node in [
        n for n in task.held_out_nodes() if is_reachable(n) and n.reference in (5.0, -10.0)
    ][::4]:
        tables = [load_gain_table(name) for name in ("paper_pso", "table3")]
        gains = [table.lookup(node.speed, node.reference).gains for table in tables]
        tuned, table_3 = fitness(node, gains)
        ratios.append(tuned / table_3)
    assert np.exp(np.mean(np.log(ratios))) < 0.95
