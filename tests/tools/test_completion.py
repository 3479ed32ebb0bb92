"""Whether a drive reached its end: distance of the plan, cause of a stop, car beside its path."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.config import find, shipped
from ampc_msgs_config.metrics import DriveRecord, distance_driven, ticks
from ampc_msgs_config.paths.path_file import Route, choose_scenario
from ampc_msgs_config.scenarios.scenario import Scenario, load_scenario
from ampc_msgs_config.scenarios.scenario_yaml import scenario_content
from ampc_msgs_config.types import REASONS, Array
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from launch_scripts.bags.bag_columns import BagColumns
from launch_scripts.reporting.completion import MISSING_SHARE, incompleteness, scenario_distance
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import load_vehicle_file

CAR = load_vehicle_file(find("vehicles", "ordinary"))
TIME: Array = np.array([k / 10 for k in range(200)])
OFF_PATH, STATE_LOST = REASONS.index("off_path"), REASONS.index("state_lost")


def missing_share(scenario: Scenario) -> float:
    """Return the share of the plan that a drive in lock-step does not cover."""
    driven = drive(Simulation(CAR, scenario), make_controller(Choices("pure_pursuit")))
    distance = distance_driven(ticks(driven), np.array([s.v_x for s in driven.states]))
    planned = scenario_distance(scenario_content(scenario))
    return (planned - distance) / planned


@pytest.mark.parametrize("name", shipped("scenarios"))
def test_a_drive_of_a_shipped_scenario_covers_the_distance_of_its_plan(name: str) -> None:
    assert abs(missing_share(load_scenario(name, CAR.size))) < 0.02


X = np.arange(0.0, 81.0, 2.0)
RING = np.arange(0.0, 2 * np.pi, 0.05)
ROADS: dict[str, tuple[Any, Any, Any, int]] = {
    "constant speed": (X, np.sin(X / 15), np.full(len(X), 7.0), 1),
    "from a standstill": (X, np.sin(X / 15), np.minimum(np.sqrt(3.0 * X), 8.0), 1),
    "through a standstill": (X, np.sin(X / 15), np.where(X == 40.0, 0.0, 6.0), 1),
    "into a standstill": (X, np.sin(X / 15), np.where(X >= 40.0, 0.0, 6.0), 1),
    "three laps": (30 * np.sin(RING), 30 - 30 * np.cos(RING), 7 + 2 * np.sin(RING), 3),
}


@pytest.mark.parametrize("name", ROADS)
def test_a_drive_along_a_file_covers_the_distance_of_its_plan(name: str, tmp_path: Path) -> None:
    x, y, v, laps = ROADS[name]
    rows = "".join(f"{a},{b},{c}\n" for a, b, c in zip(x, y, v, strict=True))
    (tmp_path / "road.csv").write_text("x_m,y_m,v_mps\n" + rows, encoding="utf-8")
    route = Route(path=str(tmp_path / "road.csv"), laps=laps)
    assert abs(missing_share(choose_scenario(route, CAR.size))) < MISSING_SHARE


def judged(speed: Array, *, scenario: str = "straight", error: float = 0.0, **tick: Array) -> str:
    """Return why a drive is not complete: speed at 10 Hz [m/s], final error [m], quantities."""
    content = scenario_content(load_scenario(scenario, CAR.size)) if scenario else None
    configuration: dict[str, Any] = {"planner": {"scenario": content}} if content else {}
    time = TIME[: len(speed)]
    quantities = {name: np.column_stack((time, values)) for name, values in tick.items()}
    columns = BagColumns(Path("bag"), "", 0, {}, quantities, [], [], configuration, [])
    errors = np.zeros((len(speed), 2))
    errors[-1, 0] = error
    return incompleteness(columns, DriveRecord(time, 0.1, speed=speed), errors)


def braked(at: float) -> Array:
    """Return the speed of a drive at 9 m/s that stops with 2 m/s^2 from a time on [s]."""
    return np.asarray(np.clip(9.0 - 2.0 * np.maximum(TIME[:150] - at, 0.0), 0.0, 9.0))


def on_from(time: float, value: float = 1.0) -> Array:
    """Return a quantity that is zero before a time [s]."""
    return np.where(TIME[:150] >= time, value, 0.0)


def test_a_complete_drive_is_complete_also_with_a_stop_request_after_its_end() -> None:
    assert judged(np.full(150, 9.0)) == ""
    stop: dict[str, Any] = {"stop_requested": on_from(14.8), "reason": on_from(14.8, STATE_LOST)}
    assert judged(np.full(150, 9.0), **stop) == ""


@pytest.mark.parametrize("at", [0.8, 3.0, 6.0, 10.0])
def test_a_car_that_stopped_is_named_with_distance_and_cause(at: float) -> None:
    stop: dict[str, Any] = {"stop_requested": on_from(at), "reason": on_from(at, OFF_PATH)}
    distance = 9.0 * at + 81.0 / 4.0
    said = judged(braked(at), **stop)
    assert said == (
        f"the car stopped after {distance:.0f} m of 135 m: a stop was requested (off_path)"
    )
    assert judged(braked(at)) == said.partition(":")[0]
    assert judged(braked(at), scenario="", **stop) == said.replace(" of 135 m", "")


def test_a_drive_that_ends_early_or_beside_its_path_is_not_complete() -> None:
    assert judged(np.full(80, 9.0)) == "the drive ended after 71 m of 135 m"
    said = judged(np.full(150, 9.0), error=-31.0)
    assert said == "the car is 31 m beside its path after 134 m of 135 m"


def test_without_a_plan_a_standing_car_alone_is_no_fault() -> None:
    assert judged(braked(3.0), scenario="") == ""
    after: dict[str, Any] = {"stop_requested": on_from(9.0), "reason": on_from(9.0, STATE_LOST)}
    assert judged(braked(3.0), scenario="", **after) == ""
