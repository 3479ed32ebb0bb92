"""A simulated drive as text is restored bit for bit; errors name key and value."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.paths.path_file import Route, choose_scenario
from ampc_msgs_config.scenarios.scenario import Scenario, load_scenario
from ampc_msgs_config.scenarios.scenario_yaml import document, read_scenario, scenario_content
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.configuration import (
    SimulatorConfiguration,
    read_simulator,
    simulation_of,
    simulator_text,
)
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file

NOISE = load(MeasurementNoise, find("noise", "x1"))
WHERE = "run/bag: simulator/configuration"


def made_of(scenario: str, vehicle: str = "paper", **options: Any) -> SimulatorConfiguration:
    """Return the configuration of a shipped scenario and car."""
    car = load_vehicle_file(find("vehicles", vehicle))
    return SimulatorConfiguration(car, load_scenario(scenario, car.size), **options)


def same_bits(a: Scenario, b: Scenario) -> bool:
    """Return whether two scenarios are equal in every bit."""
    rows = [(a.points, b.points), (a.speed.at, b.speed.at), (a.speed.speed, b.speed.speed)]
    rest = [(s.name, s.duration, s.wind, s.lanes, s.start_offset, s.start) for s in (a, b)]
    kinds = [(s.speed.over_distance, s.speed.period) for s in (a, b)]
    equal = all(x.tobytes() == y.tobytes() and x.shape == y.shape for x, y in rows)
    return equal and rest[0] == rest[1] and kinds[0] == kinds[1]


@pytest.mark.parametrize("vehicle", shipped("vehicles"))
@pytest.mark.parametrize("scenario", shipped("scenarios"))
def test_every_shipped_drive_comes_back_from_its_text_bit_for_bit(
    scenario: str, vehicle: str
) -> None:
    config = made_of(scenario, vehicle, friction=0.7, noise=NOISE, seed=7, lock_step=False)
    again = read_simulator(simulator_text(config), WHERE)
    assert same_bits(again.scenario, config.scenario)
    assert again._replace(scenario=config.scenario) == config
    assert simulator_text(again) == simulator_text(config)


def test_a_path_of_a_user_with_laps_needs_its_file_no_more(tmp_path: Path) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 60)
    rows = "".join(f"{40 * np.sin(a)},{40 - 40 * np.cos(a)}\n" for a in angles)
    file = tmp_path / "circle.csv"
    file.write_text("x_m,y_m\n" + rows, encoding="utf-8")
    car = load_vehicle_file(find("vehicles", "paper"))
    route = Route(path=str(file), lateral_acceleration=3.0, laps=2)
    config = SimulatorConfiguration(car, choose_scenario(route, car.size))
    text = simulator_text(config)
    file.unlink()
    again = read_simulator(text, WHERE)
    assert again.scenario.speed.period < np.inf
    assert same_bits(again.scenario, config.scenario)


@pytest.mark.parametrize("noise", [None, NOISE])
def test_a_drive_with_the_car_read_back_gives_the_same_bits(
    noise: MeasurementNoise | None,
) -> None:
    config = made_of("sc3_wind", friction=0.6, noise=noise, seed=3)
    given = config.vehicle, config.scenario
    rng = np.random.default_rng(3)
    before = Simulation(*given, friction=0.6, noise=noise, rng=rng)
    after = simulation_of(simulator_text(config), WHERE)
    drives = [drive(car, make_controller(Choices())) for car in (before, after)]
    assert drives[0].states == drives[1].states
    assert drives[0].steering.tolist() == drives[1].steering.tolist()


def test_the_planner_tells_its_scenario_in_the_same_way() -> None:
    scenario = made_of("iso3888_1").scenario
    content = yaml.safe_load(document({"scenario": scenario_content(scenario)}))
    assert content["number"] == 1
    assert same_bits(read_scenario(content["scenario"], "planner"), scenario)


WRONG: dict[str, tuple[tuple[str, ...], Any, str]] = {
    "no car": (("vehicle",), None, "vehicle = None must be a mapping of keys"),
    "no section": (("vehicle", "tyre"), ..., "vehicle: missing key 'tyre'"),
    "mass": (("vehicle", "chassis", "mass"), -1.0, "vehicle.chassis.mass = -1.0 must lie in [1,"),
    "unknown": (("weather",), "rain", "unknown key 'weather'"),
    "no seed": (("seed",), ..., "missing key 'seed'"),
    "seed": (("seed",), -1, "seed = -1 must lie in [0,"),
    "friction": (("friction",), 9.0, "friction = 9.0 must lie in [0.01, 3]"),
    "noise": (("noise",), {"position": -1.0}, "noise.position = -1.0 must lie in [0, 100] m"),
    "step": (("step_ns",), 0, "step_ns = 0 must lie in [10000, 2e+07] ns"),
    "mode": (("lock_step",), "yes please", "lock_step = 'yes please' must be true or false"),
    "scenario": (("scenario",), [], "scenario = [] must be a mapping of keys"),
    "nan": (("scenario", "points", "y"), "0 nan", "scenario.points.y[1] = nan must be finite"),
    "word": (
        ("scenario", "points", "x"),
        "0 one",
        "scenario.points.x: could not convert string",
    ),
    "list": (("scenario", "points", "x"), [0], "scenario.points.x = [0] must be text"),
    "empty": (("scenario", "points", "x"), "", "x has 0 numbers, must have 2 to 1000000"),
    "shorter": (
        ("scenario", "points", "x"),
        "0 1",
        "numbers, the row before it 2",
    ),
    "point": (("scenario", "points"), {"x": "1 1", "y": "0 0"}, "at least 2 are needed"),
    "no points": (
        ("scenario", "points"),
        {"x": "0", "y": "0"},
        "points.x has 1 numbers, must have",
    ),
    "no y": (("scenario", "points"), {"x": "0 1"}, "scenario.points: missing key 'y'"),
    "profile": (
        ("scenario", "speed", "speed"),
        "101",
        "scenario.speed[0] = 101.0 must lie in [0,",
    ),
    "times": (
        ("scenario", "speed", "at"),
        "0 1",
        "speed.speed has 1 numbers, the row before it 2",
    ),
    "kind": (("scenario", "speed", "over_distance"), 1, "over_distance = 1 must be true or false"),
    "period": (
        ("scenario", "speed", "period"),
        0.0,
        "scenario.speed.period = 0.0 must lie in [0.001, inf] m",
    ),
    "duration": (("scenario", "duration"), 0.0, "scenario.duration = 0.0 must lie in [0.1,"),
    "wind": (
        ("scenario", "wind"),
        [{"kind": "storm", "start": 0, "end": 9, "speed": 1}],
        "scenario.wind[0].kind = 'storm' must be one of gust, block",
    ),
    "lanes": (("scenario", "lanes"), {}, "scenario.lanes = {} must be a list"),
    "lane": (("scenario", "lanes"), [{"start": 0.0}], "scenario.lanes[0]: missing key 'end'"),
    "offset": (("scenario", "start_offset"), 1e3, "scenario.start_offset = 1000.0 must lie in"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_in_a_configuration_is_named_with_place_key_and_value(case: str) -> None:
    keys, value, sentence = WRONG[case]
    content = yaml.safe_load(simulator_text(made_of("sc1")))
    section = content
    for key in keys[:-1]:
        section = section[key]
    section[keys[-1]] = value
    if value is ...:
        del section[keys[-1]]
    with pytest.raises(ValueError, match="simulator/configuration") as error:
        simulation_of(yaml.safe_dump(content), WHERE)
    assert str(error.value).startswith(WHERE)
    assert sentence in str(error.value)
    assert str(error.value).count(WHERE) == 1
