"""Controllers drive the simulated car: golden numbers, symmetries, limits, real roads."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.metrics import Drive, errors, evaluate_drive
from ampc_msgs_config.paths.path import Path as ReferencePath
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.paths.path_frame import rotate
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedProfile, load_scenario
from ampc_msgs_config.scenarios.wind import Wind
from ampc_msgs_config.types import Plan, VehicleState
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import load_vehicle_file

PAPER = load_vehicle_file(find("vehicles", "paper"))
TO_CG = PAPER.chassis.cg_to_rear_axle
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
with_data = pytest.mark.skipif(not DATA.is_dir(), reason="../shared/data is not at hand")
LATERAL = ("paper", "classic", "pure_pursuit")
every_controller = pytest.mark.parametrize("controller", LATERAL)


def scenario(name: str) -> Scenario:
    """Load a shipped scenario for the paper's car."""
    return load_scenario(name, PAPER.size)


def driven(route: Scenario, controller: str, step_ns: int = 5_000_000) -> Drive:
    """Drive a scenario from its start to its end."""
    return drive(Simulation(PAPER, route, step_ns), make_controller(Choices(controller)))


def metrics_of(route: Scenario, controller: str, step_ns: int = 5_000_000) -> dict[str, float]:
    """Drive a scenario and give the numbers of the result table."""
    done = driven(route, controller, step_ns)
    return evaluate_drive(done, make_path(route.points), TO_CG, period=0.1)


def mirrored(route: Scenario) -> Scenario:
    """Exchange left and right."""
    wind = tuple(replace(piece, speed=-piece.speed) for piece in route.wind)
    points = route.points * np.array([1.0, -1.0])
    return route._replace(points=points, wind=wind, start_offset=-route.start_offset)


def moved(route: Scenario, turn: float, by: tuple[float, float]) -> Scenario:
    """Turn the path about the origin [rad], then shift it [m]."""
    points = np.array([rotate(x, y, turn) for x, y in route.points]) + np.array(by)
    return route._replace(points=points)


def test_paper_s_controller_drives_sc1_as_an_independent_prototype_does() -> None:
    numbers = metrics_of(scenario("sc1"), "paper")
    assert 0.02 < numbers["mse_m2"] < 0.05
    assert numbers["mse_m2"] == pytest.approx(0.0334, rel=0.1)
    assert numbers["mse_lateral_m2"] == pytest.approx(0.0345, rel=0.1)  # the prototype's


def test_model_at_the_measured_speed_beats_the_fixed_one_threefold_on_sc2() -> None:
    route = scenario("sc2")
    adaptive, fixed = metrics_of(route, "paper"), metrics_of(route, "classic")
    assert fixed["mse_m2"] >= 3.0 * adaptive["mse_m2"]


def test_fixed_model_diverges_in_fast_wind_and_the_adaptive_one_does_not() -> None:
    route = scenario("sc3_fast_wind")
    assert metrics_of(route, "classic")["max_error_m"] > 3.0
    assert metrics_of(route, "paper")["max_error_m"] < 1.5


LIMITS = [  # controller, scenario, largest cross-track error [m] and angle [deg]
    ("paper", "sc1", 0.50, 6.0),
    ("paper", "sc1_falcone", 0.75, 12.0),
    ("paper", "sc2", 0.95, 15.0),
    ("paper", "sc3_constant", 2.60, 30.0),
    ("paper", "sc3_varying", 2.50, 30.0),
    ("paper", "sc3_wind", 2.55, 30.0),
    ("paper", "sine", 0.40, 4.0),
    ("classic", "sc1", 0.50, 6.0),
    ("classic", "sine", 0.40, 4.0),
    ("pure_pursuit", "sc1", 0.40, 8.0),
    ("pure_pursuit", "sc1_falcone", 0.45, 9.0),
    ("pure_pursuit", "sc2", 1.30, 9.0),
    ("pure_pursuit", "sc3_constant", 2.20, 20.0),
    ("pure_pursuit", "sc3_varying", 1.60, 18.0),
    ("pure_pursuit", "sc3_wind", 1.60, 18.0),
    ("pure_pursuit", "sc3_fast_wind", 1.20, 5.0),
    ("pure_pursuit", "sine", 0.20, 4.0),
    ("pure_pursuit", "circle", 0.35, 6.5),
]


@pytest.mark.parametrize(("controller", "name", "error", "angle"), LIMITS)
def test_drive_stays_within_its_limit(
    controller: str, name: str, error: float, angle: float
) -> None:
    numbers = metrics_of(scenario(name), controller)
    assert numbers["max_error_m"] < error
    assert numbers["steering_max_deg"] < angle + 1e-9
    assert numbers["missed_ticks"] == 0


@pytest.mark.parametrize("name", ["sc1", "sc2", "sc3_wind", "straight"])
@every_controller
def test_mirrored_scenario_gives_mirrored_commands(controller: str, name: str) -> None:
    left, right = driven(scenario(name), controller), driven(mirrored(scenario(name)), controller)
    np.testing.assert_allclose(right.steering, -left.steering, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "turn", "by"), [("sc1", math.pi, (0.0, 0.0)), ("sc2", 2.0, (1000.0, -500.0))]
)
@every_controller
def test_place_of_the_path_in_the_map_does_not_matter(
    controller: str, name: str, turn: float, by: tuple[float, float]
) -> None:
    here, there = scenario(name), moved(scenario(name), turn, by)
    expected = driven(here, controller).steering
    np.testing.assert_allclose(driven(there, controller).steering, expected, atol=1e-6)


@every_controller
def test_two_drives_are_the_same_bit_for_bit(controller: str) -> None:
    one, other = driven(scenario("sc2"), controller), driven(scenario("sc2"), controller)
    assert one.states == other.states
    assert one.steering.tobytes() == other.steering.tobytes()


class AtCentreOfGravity:
    """A controller whose odometry describes the centre of gravity."""

    period = 0.1

    def __init__(self, controller: str) -> None:
        """Create the controller by its name."""
        self.controller = make_controller(Choices(controller, base_link_to_cg=0.0))

    def step(self, state: VehicleState, path: ReferencePath) -> Plan:
        """Answer a state of the rear axle, after moving it to the centre of gravity."""
        return self.controller.step(at_distance(state, TO_CG), path)


@every_controller
def test_both_conventions_of_base_link_give_the_same_drive(controller: str) -> None:
    at_axle = driven(scenario("sc2"), controller)
    at_cg = drive(Simulation(PAPER, scenario("sc2")), AtCentreOfGravity(controller))
    np.testing.assert_allclose(at_cg.steering, at_axle.steering, atol=1e-9)


@every_controller
def test_half_the_integration_step_changes_sc1_by_less_than_a_thousandth(controller: str) -> None:
    coarse = metrics_of(scenario("sc1"), controller)["mse_m2"]
    fine = metrics_of(scenario("sc1"), controller, step_ns=2_500_000)["mse_m2"]
    assert fine == pytest.approx(coarse, rel=1e-3)


@pytest.mark.parametrize("offset", [0.0, -1.0])
@every_controller
def test_standing_car_stays_where_it_is_under_finite_commands(
    controller: str, offset: float
) -> None:
    still = SpeedProfile(False, np.array([0.0]), np.array([0.0]))
    route = scenario("sc1")._replace(speed=still, start_offset=offset, duration=5.0)
    done = driven(route, controller)
    assert np.isfinite(done.steering).all()
    start, end = done.states[0], done.states[-1]
    assert math.hypot(end.x - start.x, end.y - start.y) < 0.01
    if offset == 0.0:
        np.testing.assert_allclose(done.steering, 0.0, atol=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
@every_controller
def test_car_drives_off_from_standstill_beside_the_road_and_finds_it(
    controller: str, side: float
) -> None:
    profile = SpeedProfile(False, np.array([0.0, 2.0, 8.0]), np.array([0.0, 0.0, 9.0]))
    route = scenario("straight")._replace(speed=profile, start_offset=0.5 * side, duration=20.0)
    error = errors(driven(route, controller), make_path(route.points), TO_CG)[:, 0]
    assert np.abs(error).max() < 0.6
    assert np.abs(error[-20:]).max() < 0.05


@pytest.mark.parametrize("controller", ["paper", "classic"])
def test_increments_and_angles_of_a_drive_keep_their_bounds(controller: str) -> None:
    steering = driven(scenario("straight"), controller).steering  # limit-cycles at the bounds
    assert np.abs(steering).max() == pytest.approx(math.pi / 6)
    assert np.abs(np.diff(steering, prepend=0.0)).max() <= math.pi / 12 + 1e-12


def constant(file: str, speed: float | None) -> Scenario:
    """Load a real path."""
    return from_csv(DATA / file, speed)


weave = partial(constant, "authors_trajectories/weave_20mps.csv", 9.0)
motorway = partial(constant, "real_drive/comma2k19_example1.csv", None)


@with_data
@pytest.mark.parametrize(
    ("controller", "route", "error"),
    [
        ("paper", weave, 0.55),
        ("pure_pursuit", weave, 0.45),
        ("paper", motorway, 0.1),
        ("pure_pursuit", motorway, 0.2),
    ],
)
def test_real_roads_are_driven_to_their_end(
    controller: str, route: Callable[[], Scenario], error: float
) -> None:
    road = route()
    done = driven(road, controller)
    assert len(done.states) == round(10 * road.duration)
    judgement = errors(done, make_path(road.points), TO_CG)
    assert np.abs(judgement[:, 0]).max() < error
    driven_length = sum(0.1 * state.v_x for state in done.states)
    assert driven_length > 0.95 * make_path(road.points).length


def test_the_wind_of_a_simulation_is_that_of_its_time() -> None:
    gust = Wind(kind="gust", start=0.1, end=1.3, speed=8.0)
    simulation = Simulation(PAPER, scenario("sc1")._replace(wind=(gust,)))
    for time in (0.0, 0.4, 0.7, 1.2, 1.4):
        while simulation.elapsed_ns < round(time * 1e9):
            simulation.advance(0.0, 9.0, simulation.step_ns)
        shape = 1.0 - math.cos(math.tau * (time - 0.1) / 1.2)
        expected = 4.0 * shape if 0.1 < time < 1.3 else 0.0
        assert simulation.wind() == pytest.approx((0.0, expected), abs=1e-9)
