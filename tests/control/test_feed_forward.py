"""The feed-forward with its damped return: eigenvalues, drives alone, limit cases, symmetry."""

import math
from dataclasses import astuple
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array, Diagnosis, Plan, VehicleState
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.mpc.internal_model import Actuator
from ampc_ros.mpc.model import STATES
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.model import SampledModel, sample_model, steady_steering
from ampc_ros.supervision.feed_forward import FeedForward
from sim_vehicle.closed_loop import drive
from tests.workshop.acceptance.road_data import DATA
from tests.workshop.acceptance.trials import (
    Trial,
    assumed_vehicle,
    plant,
    scenario_of,
    with_errors,
)

PATH = make_path([(0.0, 0.0), (1000.0, 0.0)])
PERIOD = 0.1
CARS = ("paper", "ordinary")
every_car = pytest.mark.parametrize("car", CARS)
SIZE = 1e-6
"""Of the differences for the Jacobian."""


@cache
def chassis(car: str) -> ChassisParameters:
    """Load a shipped car."""
    return load_section(ChassisParameters, find("vehicles", car), "chassis")


def alone(car: str) -> FeedForward:
    """Return the feed-forward of a shipped car whose `odom` describes the centre of gravity."""
    return FeedForward(chassis(car), 0.0)


def spectral_radius(car: str, v_x: float, actuator: Actuator) -> float:
    """Largest magnitude of the eigenvalues of model and feed-forward on a straight road.

    Args:
        car: Shipped name.
        v_x: Speed [m/s].
        actuator: Of the car; the feed-forward knows nothing of it.
    """
    A, B_old, B_new, D = np.zeros((STATES, STATES)), *np.zeros((3, STATES))
    model = SampledModel(A, B_old, B_new, D)
    sample_model(astuple(chassis(car)), v_x, PERIOD, actuator, model, make_scratch(400))
    steers = alone(car)

    def tick(z: Array) -> Array:
        x, sent = np.split(z, [STATES])
        state = VehicleState(0, 500.0, x[3], x[1], v_x, x[0], x[2])
        inputs = np.append(sent, steers.steering(state, PATH))
        return np.concatenate((A @ x + B_old * inputs[0] + B_new * inputs[1], inputs[1:]))

    n = STATES + actuator.ticks + 1
    J = np.array([(tick(SIZE * row) - tick(np.zeros(n))) / SIZE for row in np.eye(n)]).T
    return float(np.abs(np.linalg.eigvals(J)).max())


class Lonely:
    """A feed-forward that steers alone, within the angle of its car."""

    period = PERIOD

    def __init__(self, car: str) -> None:
        """Begin at rest."""
        vehicle = assumed_vehicle(Trial(car=car))
        self.most = vehicle.steering.max_angle
        self.steers = FeedForward(vehicle.chassis, vehicle.chassis.cg_to_rear_axle)

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Answer one state."""
        angle = min(max(self.steers.steering(state, path), -self.most), self.most)
        return Plan(state.stamp_ns, angle, 0.0, Diagnosis())


@cache
def error(trial: Trial) -> Array:
    """Drive a trial by feed-forward alone; gives the cross-track error at each tick [m]."""
    vehicle = assumed_vehicle(trial)
    scenario = scenario_of(trial, vehicle)
    done = drive(plant(trial, vehicle, scenario), Lonely(trial.car))
    return with_errors(done, scenario, vehicle).error


def circling(radius: float, v_x: float, car: str) -> VehicleState:
    """Return the centre of gravity of a car in steady motion on a circle about (0, radius)."""
    m, _, l_f, l_r, _, C_r = astuple(chassis(car))
    slip = l_r / radius - l_f * m * v_x**2 / (2 * C_r * (l_f + l_r) * radius)
    return VehicleState(0, 0.0, 0.0, -slip, v_x, v_x * slip, v_x / radius)


@every_car
@pytest.mark.parametrize("v_x", [3.0, 5.0, 9.0, 15.0, 20.0, 27.0, 33.0, 40.0])
@pytest.mark.parametrize("actuator", [Actuator(0, 0.0, 0.0), Actuator(1, 0.0, 0.0),
                                      Actuator(2, 0.0, 0.0), Actuator(1, 0.0, 0.1)])  # fmt: skip
def test_loop_is_stable_with_margin_under_a_delay_that_it_does_not_know(
    car: str, v_x: float, actuator: Actuator
) -> None:
    assert spectral_radius(car, v_x, actuator) < 0.97


@every_car
@pytest.mark.parametrize("v_x", [0.5, 1.0, 2.0])
def test_slow_car_returns_within_metres_and_not_seconds(car: str, v_x: float) -> None:
    for ticks in (0, 1, 2, 3):
        radius = spectral_radius(car, v_x, Actuator(ticks, 0.0, 0.0))
        assert radius < 1.0 - 0.4 * v_x * PERIOD / 4.0


@every_car
@pytest.mark.parametrize("v_x", [9.0, 27.0, 40.0])
def test_loop_bears_a_delay_of_300_ms(car: str, v_x: float) -> None:
    assert spectral_radius(car, v_x, Actuator(3, 0.0, 0.0)) < 0.98


ALONE = [  # scenario, speed [m/s], largest error [m], of the last 3 s; 100 ms of unknown delay
    ("sc1", 3.0, 0.05, 0.05),
    ("sc1", 9.0, 0.20, 0.06),
    ("sc1", 15.0, 0.50, 0.01),
    ("sc1", 20.0, 0.90, 0.01),
    ("circle", 3.0, 0.05, 0.01),
    ("circle", 9.0, 0.20, 0.01),
    ("circle", 12.0, 0.50, 0.10),
    ("sine", 3.0, 0.03, 0.03),
    ("sine", 9.0, 0.10, 0.10),
    ("sine", 15.0, 0.30, 0.30),
    ("sine", 20.0, 0.75, 0.75),
    ("straight", 27.0, 0.01, 0.01),
]


@every_car
@pytest.mark.parametrize(("name", "speed", "largest", "last"), ALONE)
def test_it_drives_alone_with_100_ms_of_unknown_delay(
    car: str, name: str, speed: float, largest: float, last: float
) -> None:
    off = np.abs(error(Trial(name, car, speed, delay=0.1)))
    assert off.max() < largest
    assert off[-30:].max() < last


@every_car
def test_it_survives_sc1_at_27_m_s_which_takes_three_quarters_of_the_grip(car: str) -> None:
    off = np.abs(error(Trial("sc1", car, 27.0, delay=0.1)))
    assert off.max() < 2.2
    assert off[-30:].max() < 0.02


@every_car
@pytest.mark.skipif(not DATA.is_dir(), reason="no roads: make data")
@pytest.mark.parametrize(
    "file", sorted(str(f.relative_to(DATA)) for f in DATA.glob("*/*.csv")), ids=lambda f: f[:20]
)
def test_it_drives_roads_from_files_alone(car: str, file: str) -> None:
    off = error(Trial(file, car, delay=0.1))
    assert np.abs(off).max() < 0.75
    assert math.sqrt(np.mean(off**2)) < 0.30


@every_car
@pytest.mark.parametrize("speed", [3.0, 9.0, 15.0, 27.0])
@pytest.mark.parametrize("friction", [0.3, 0.9])
def test_it_comes_back_from_5_m_without_swinging_over(
    car: str, speed: float, friction: float
) -> None:
    off = error(Trial("straight", car, speed, offset=5.0, delay=0.1, friction=friction))
    assert off.max() < 5.05
    assert off.min() > -0.05
    assert abs(off[-1]) < 0.8
    assert (np.diff(off[10:]) < 0.001).all()


@every_car
@given(radius=st.floats(60.0, 1000.0), v_x=st.floats(3.0, 30.0), side=st.sampled_from([1.0, -1.0]))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_car_on_its_steady_circle_gets_the_steady_angle(
    car: str, radius: float, v_x: float, side: float
) -> None:
    turn = np.linspace(-1.5, 2.0, 1500)
    path = make_path(np.column_stack((radius * np.sin(turn), side * radius * (1 - np.cos(turn)))))
    angle = alone(car).steering(circling(side * radius, v_x, car), path)
    wanted = steady_steering(astuple(chassis(car)), v_x, side / radius)
    assert angle == pytest.approx(wanted, rel=0.02)


@cache
def waves(side: float) -> Path:
    """Return a path along a sine that first bends to one side."""
    return make_path(np.array([(s, side * 3.0 * math.sin(s / 20.0)) for s in range(0, 200, 2)]))


@every_car
@given(
    x=st.floats(0.0, 150.0), y=st.floats(-8.0, 8.0), yaw=st.floats(-3.1, 3.1),
    v_x=st.floats(-0.3, 40.0), v_y=st.floats(-2.0, 2.0), r=st.floats(-1.0, 1.0),
)  # fmt: skip
@settings(max_examples=200, deadline=None, derandomize=True)
def test_mirrored_states_get_mirrored_angles_exactly(
    car: str, x: float, y: float, yaw: float, v_x: float, v_y: float, r: float
) -> None:
    left = alone(car).steering(VehicleState(0, x, y, yaw, v_x, v_y, r), waves(1.0))
    mirrored = VehicleState(0, x, -y, -yaw, v_x, -v_y, -r)
    assert alone(car).steering(mirrored, waves(-1.0)) == -left
    assert math.isfinite(left)


@pytest.mark.parametrize("v_x", [0.0, 0.3, 1.0, 5.0, 30.0])
def test_pull_does_not_grow_beyond_a_metre(v_x: float) -> None:
    def angle(y: float) -> float:
        return alone("paper").steering(VehicleState(0, 100.0, y, 0.0, v_x, 0.0, 0.0), PATH)

    assert angle(0.5) == pytest.approx(angle(1.0) / 2)
    assert angle(1.0) == angle(5.0) == angle(20.0) < 0.0
    assert abs(angle(5.0)) < 0.25


def test_where_odom_describes_does_not_matter() -> None:
    bend = waves(1.0)
    for x in (10.0, 40.0, 90.0):
        car = VehicleState(NANOSECONDS, x, 1.0, 0.1, 12.0, 0.2, 0.1)
        behind = FeedForward(chassis("paper"), 1.6)
        angle = behind.steering(at_distance(car, -1.6), bend)
        assert angle == pytest.approx(alone("paper").steering(car, bend), abs=1e-12)


def test_reset_forgets_the_place_on_a_path_that_crosses_itself() -> None:
    angle = np.linspace(0.0, math.tau, 400)
    eight = make_path(np.column_stack((40 * np.sin(angle), 20 * np.sin(angle) * np.cos(angle))))
    out = VehicleState(0, 0.0, 0.0, math.atan(0.5), 5.0, 0.0, 0.0)
    steers = alone("paper")
    first = steers.steering(out, eight)
    assert abs(steers.steering(out._replace(yaw=math.pi - out.yaw), eight)) > 0.5
    steers.reset()
    assert abs(steers.steering(out._replace(yaw=math.pi - out.yaw), eight)) < 0.05
    assert abs(first) < 0.05
