"""Shipped cars of other stacks: their numbers follow from the sources, and they drive."""

import math
from functools import cache
from pathlib import Path as File

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.metrics import errors
from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedProfile, load_scenario
from ampc_msgs_config.types import Array
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import Vehicle, load_vehicle_file

ROAD_LENGTH = 153.0
"""Length of the double lane change sc1 that is driven [m]."""
DRIVES = {
    "autoware_sample": (1.0, 9.0, 0.10),
    "carla": (1.0, 9.0, 0.10),
    "gazebo_ackermann": (1.0, 2.0, 0.10),
    "f1tenth": (0.12, 2.0, 0.05),
}
"""Scale of sc1, which is its wheelbase over 2.7 m for the 1:10 car, speed [m/s], and bound of the
largest error [m]. The bounds were fixed before the first drive."""
every_car = pytest.mark.parametrize("car", DRIVES)


def vehicle(car: str) -> Vehicle:
    """Load a shipped vehicle."""
    return load_vehicle_file(find("vehicles", car))


def lane_change(car: str, side: float) -> Scenario:
    """Return sc1 in the scale and at the speed of a car; side -1 exchanges left and right."""
    scale, speed, _ = DRIVES[car]
    road = load_scenario("sc1", vehicle(car).size)
    constant = SpeedProfile(False, np.zeros(1), np.array([speed]))
    return road._replace(
        points=road.points * np.array([scale, side * scale]),
        speed=constant,
        duration=ROAD_LENGTH * scale / speed,
    )


@cache
def errors_of(car: str, side: float) -> Array:
    """Drive the lane change with the default controller; return cross-track errors (n,) [m]."""
    road, to_cg = lane_change(car, side), vehicle(car).chassis.cg_to_rear_axle
    done = drive(Simulation(vehicle(car), road), make_controller(Choices(vehicle=car)))
    return errors(done, make_path(road.points), to_cg)[:, 0]


@every_car
def test_a_lane_change_stays_within_the_bound(car: str) -> None:
    assert np.abs(errors_of(car, 1.0)).max() < DRIVES[car][2]


@every_car
def test_the_page_states_the_largest_error_of_the_lane_change(car: str) -> None:
    page = File(__file__).parents[2] / "ampc_ros" / "doc" / "my_car.md"
    (row,) = (x for x in page.read_text("utf-8").splitlines() if x.startswith(f"| `{car}` |"))
    stated = float(row.split()[-3])
    assert row.endswith(f"{stated:g} mm |")
    assert stated == pytest.approx(1000.0 * np.abs(errors_of(car, 1.0)).max(), abs=0.6)


@every_car
def test_left_and_right_are_mirror_images(car: str) -> None:
    np.testing.assert_allclose(errors_of(car, -1.0), -errors_of(car, 1.0), atol=1e-6)


def stiffness(car: str, front: float, rear: float) -> tuple[float, float]:
    """Return the stiffness of one tyre of both axles from stiffness over load [N/rad]."""
    chassis = vehicle(car).chassis
    load = 0.5 * chassis.mass * GRAVITY / chassis.wheelbase
    return front * load * chassis.cg_to_rear_axle, rear * load * chassis.cg_to_front_axle


def published_stiffness() -> dict[str, tuple[float, float]]:
    """Return the stiffness of one tyre of both axles by the rules of the sources [N/rad]."""
    mu, front, rear = 1.0489, 4.718, 5.4562
    normalised_load = 3.0 / 2.0  # at static load, PhysX: load times 3 / lat_stiff_max_load
    share = normalised_load - normalised_load**2 / 3.0 + normalised_load**3 / 27.0
    return {
        "f1tenth": stiffness("f1tenth", mu * front, mu * rear),
        "carla": stiffness("carla", 17.0 * share, 17.0 * share),
        "gazebo_ackermann": stiffness("gazebo_ackermann", 20.0, 20.0),
        "autoware_sample": (155494.663 / 2.0, 155494.663 / 2.0),
    }


@every_car
def test_cornering_stiffness_follows_from_the_published_numbers(car: str) -> None:
    chassis = vehicle(car).chassis
    actual = chassis.front_cornering_stiffness, chassis.rear_cornering_stiffness
    assert actual == pytest.approx(published_stiffness()[car], rel=1e-3)


def test_yaw_inertia_of_the_robot_is_that_of_its_links() -> None:
    chassis, wheel, link, track = (1.0, 0.481014, 0.8), (2.0, 0.145833), 0.1, 1.0
    robot, base = vehicle("gazebo_ackermann").chassis, 1.7
    bodies = [chassis, *2 * [(*wheel, 0.0)], *2 * [(*wheel, base)], *2 * [(link, 0.0, base)]]
    mass = sum(m for m, _, _ in bodies)
    centre = sum(m * x for m, _, x in bodies) / mass
    beside = [0.0, *6 * [track / 2.0]]
    inertia = sum(
        I_z + m * ((x - centre) ** 2 + y**2) for (m, I_z, x), y in zip(bodies, beside, strict=True)
    )
    assert robot.mass == pytest.approx(mass)
    assert robot.cg_to_rear_axle == pytest.approx(centre, abs=1e-3)
    assert robot.wheelbase == pytest.approx(base)
    assert robot.yaw_inertia == pytest.approx(inertia, rel=2e-3)


def test_steering_of_the_cars_is_the_published_one() -> None:
    assert vehicle("carla").steering.max_angle == pytest.approx(math.radians(70.0), abs=1e-4)
    steering = vehicle("autoware_sample").steering
    assert (steering.delay, steering.lag, steering.max_angle) == (0.24, 0.27, 0.7)
    assert steering.max_rate == pytest.approx(math.radians(40.0), rel=1e-3)
    robot = vehicle("gazebo_ackermann").steering
    assert robot.lag == pytest.approx(1.0 / (0.1 * 10.0))  # gain and rate of the position loop
