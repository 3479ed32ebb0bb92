"""The feed-forward of the preview formulation: feasible, and never the whole steering rate."""

import math
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import daqp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import errors
from ampc_msgs_config.parameters import FRICTION_SHARE, ControllerSettings
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import Array, Plan, VehicleState
from ampc_ros.configuration import default_table
from ampc_ros.mpc.gain_table import load_gain_table
from ampc_ros.mpc.internal_model import InternalModel
from ampc_ros.mpc.qp import Qp
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.preview.model import angle_bound
from ampc_ros.preview.nominal_steering import (
    NOMINAL_SHARE,
    Road,
    limit_rate,
    nominal_steering,
    road_angle,
)
from ampc_ros.preview.qp_assembly import steering_rows
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import load_vehicle_file
from tests.filled import laguerre_sequence, running_sum

CARS = {name: load_vehicle_file(find("vehicles", name)) for name in ("paper", "ordinary")}
LIMITS = load(ControllerSettings, find("controllers", "table3"))
many = settings(max_examples=100, deadline=None, derandomize=True)


def controller(car: str, max_rate: float | None = None) -> PreviewMpc:
    """Return the shipped controller of a car, with another steering rate [rad/s] if one is set."""
    chassis, steering = CARS[car].chassis, CARS[car].steering
    steering = steering if max_rate is None else replace(steering, max_rate=max_rate)
    return PreviewMpc(chassis, steering, LIMITS, load_gain_table(default_table("preview", car)))


@cache
def model_of(car: str, max_rate: float | None = None) -> InternalModel:
    """Return the internal model of a car, with another steering rate [rad/s] if one is set."""
    return controller(car, max_rate).model


def with_friction(model: InternalModel, mu_g: float) -> InternalModel:
    """Return a model with another friction limit [m/s^2]."""
    return model._replace(limits=model.limits._replace(mu_g=mu_g))


class Nominal(NamedTuple):
    """Result of `nominal_steering`."""

    angles: Array
    bounds: Array


def nominal_of(model: InternalModel, road: Road, u: float) -> Nominal:
    """Return the angles without correction and their bounds."""
    H = len(road.speed) - 1
    filled = Nominal(np.full(H, np.nan), np.full(H, np.nan))
    nominal_steering(model, road, u, *filled, make_scratch(10 * H + 100))
    return filled


def road_of(curvature: Array, speed: Array) -> Road:
    """Return a road from curvatures of 2 H + 1 steps, the oldest first, and H + 1 speeds."""
    H = len(speed) - 1
    return Road(speed, curvature[H:], np.ascontiguousarray(curvature[:H][::-1]))


def any_road(seed: int, kind: str) -> Road:
    """Create a road: a hairpin, noise, or curvature of the size and smoothness of real roads."""
    rng = np.random.default_rng(seed)
    H = int(rng.integers(1, 40))
    speed = np.maximum(rng.uniform(0, 30) + rng.uniform(-0.3, 0.3) * np.arange(H + 1), 0.0)
    along = np.arange(2 * H + 1)
    if kind == "hairpin":
        start, length = rng.integers(0, 2 * H + 1), rng.integers(1, H + 2)
        inside = (along >= start) & (along < start + length)
        return road_of(rng.choice([-1, 1]) * rng.uniform(0.01, 0.3) * inside, speed)
    if kind == "noise":
        return road_of(rng.uniform(0, 0.3) * rng.standard_normal(2 * H + 1), speed)
    return road_of(1e-3 * np.sin(along * rng.uniform(0, 0.1) + rng.uniform(0, 6)), speed)


roads = st.builds(any_road, st.integers(0, 2**32 - 1), st.sampled_from(["hairpin", "noise"]))
models = st.builds(
    lambda car, rate, mu_g: with_friction(model_of(car, rate), mu_g),
    st.sampled_from(list(CARS)),
    st.sampled_from([0.05, 0.25, 0.7, 3.0]),
    st.sampled_from([1.0, 3.0, 9.0]),
)


def test_share_of_the_rate_is_that_of_the_documentation() -> None:
    assert NOMINAL_SHARE == 0.7


@many
@given(road=roads, model=models, u=st.floats(-0.7, 0.7))
def test_no_correction_is_feasible_and_authority_is_left(
    road: Road, model: InternalModel, u: float
) -> None:
    step = model.limits.Delta_u_max
    angles, bounds = nominal_of(model, road, u)
    increments = np.diff(angles, prepend=u)
    assert np.abs(increments).max() <= NOMINAL_SHARE * step + 1e-12
    N_c = len(angles)
    L = laguerre_sequence(0.3, min(6, N_c), N_c)
    rows = np.zeros((2 * N_c, L.shape[1])), np.zeros(2 * N_c), np.zeros(2 * N_c)
    qp = Qp(np.eye(L.shape[1]), np.zeros(L.shape[1]), *rows)
    steering_rows(qp, L, running_sum(L), angles, bounds, u, step)
    assert (qp.low <= 0.0).all()
    assert (qp.high >= 0.0).all()
    rest = (1.0 - NOMINAL_SHARE) * step - 1e-12
    assert (qp.low[::2] <= -rest).all()
    assert (qp.high[::2] >= rest).all()


@many
@given(road=roads, model=models, u=st.floats(-0.7, 0.7))
def test_angles_stay_within_their_bounds_or_return_to_them(
    road: Road, model: InternalModel, u: float
) -> None:
    angles, bounds = nominal_of(model, road, u)
    before = np.abs(np.append(u, angles[:-1]))
    back = before - NOMINAL_SHARE * model.limits.Delta_u_max
    assert (np.abs(angles) <= np.maximum(bounds, back) + 1e-12).all()
    assert (bounds <= model.limits.u_max).all()


@many
@given(road=roads, model=models, u=st.floats(-0.7, 0.7))
def test_mirrored_roads_have_mirrored_angles(road: Road, model: InternalModel, u: float) -> None:
    mirrored = road._replace(curvature=-road.curvature, behind=-road.behind)
    np.testing.assert_array_equal(
        nominal_of(model, mirrored, -u).angles, -nominal_of(model, road, u).angles
    )


@many
@given(seed=st.integers(0, 2**32 - 1), u=st.floats(-0.02, 0.02), car=st.sampled_from(list(CARS)))
def test_demand_below_the_share_is_followed_bit_for_bit(seed: int, u: float, car: str) -> None:
    road, model = any_road(seed, "smooth"), model_of(car)
    vehicle, T = model.vehicle, model.limits.T
    expected, offset = [], u - road_angle(vehicle, road, 0, T, 0)
    for i in range(1, len(road.speed)):
        a_y = FRICTION_SHARE * model.limits.mu_g
        bound = angle_bound(vehicle, road.speed[i], model.limits.u_max, a_y)
        expected.append(
            min(max(offset + road_angle(vehicle, road, i, T, -len(road.behind)), -bound), bound)
        )
    np.testing.assert_array_equal(nominal_of(model, road, u).angles, expected)


@pytest.mark.parametrize("length", [2, 9, 30])
@pytest.mark.parametrize("height", [0.05, 1.0, 5.0])
def test_limited_angles_are_the_nearest_ones_in_least_squares(length: int, height: float) -> None:
    rng, step = np.random.default_rng(length), 0.3
    for _ in range(20):
        demanded = height * rng.standard_normal(length)
        limited = demanded.copy()
        limit_rate(limited, step, np.zeros(length))
        D = np.diff(np.eye(length), axis=0)
        room, kinds = np.full(length - 1, step), np.zeros(length - 1, np.int32)
        expected, _, flag, _ = daqp.solve(np.eye(length), -demanded, D, room, -room, kinds)
        assert flag == 1
        assert np.abs(limited - expected).max() < 0.01 * max(height, step)
        assert limited.sum() == pytest.approx(demanded.sum(), abs=1e-12 * height * length)


def test_a_step_of_the_demand_becomes_a_ramp_about_it() -> None:
    angles = np.where(np.arange(41) < 20, 0.0, 1.0)
    limit_rate(angles, 0.1, np.zeros(41))
    np.testing.assert_allclose(angles, np.clip((np.arange(41) - 14.5) / 10, 0.0, 1.0), atol=1e-3)


def test_angles_whose_increments_are_small_enough_are_not_changed() -> None:
    angles = np.cumsum(np.random.default_rng(1).uniform(-0.1, 0.1, 50))
    limited = angles.copy()
    limit_rate(limited, 0.1, np.zeros(50))
    np.testing.assert_array_equal(limited, angles)


@pytest.mark.parametrize("u", [-0.3, 0.0, 0.3])
def test_standing_car_on_a_straight_holds_its_angle(u: float) -> None:
    road = road_of(np.zeros(41), np.zeros(21))
    np.testing.assert_array_equal(nominal_of(model_of("paper"), road, u).angles, u)


def test_on_low_friction_the_angle_returns_to_the_bound_at_the_share() -> None:
    model = with_friction(model_of("ordinary", 0.3), 2.0)
    angles, bounds = nominal_of(model, road_of(np.zeros(41), np.full(21, 20.0)), 0.2)
    step = NOMINAL_SHARE * model.limits.Delta_u_max
    expected = np.maximum(0.2 - step * np.arange(1, 21), bounds)
    np.testing.assert_allclose(angles, expected, atol=1e-12)


class Counting:
    """Controller that counts the QPs without a solution."""

    def __init__(self, controller: PreviewMpc) -> None:
        """Wrap a controller."""
        self.controller, self.period, self.unsolved = controller, controller.period, 0

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Answer a state."""
        answer = self.controller.step(state, path)
        self.unsolved += answer.diagnosis.converged == 0.0
        return answer


def largest_error(car: str, points: Array, true: Array, v: float, rate: float | None) -> float:
    """Drive along points with a steering rate [rad/s]; return the largest error from a path [m]."""
    vehicle, path = CARS[car], make_path(true)
    if rate is not None:
        vehicle = vehicle._replace(steering=replace(vehicle.steering, max_rate=rate))
    scenario = load_scenario("straight", vehicle.size, v)._replace(
        points=points, start_offset=0.0, duration=(path.length - 20.0) / v
    )
    steered = Counting(controller(car, rate))
    finished = drive(Simulation(vehicle, scenario), steered)
    assert steered.unsolved == 0
    return float(np.abs(errors(finished, path, vehicle.chassis.cg_to_rear_axle)[:, 0]).max())


def hairpin(radius: float, straight: float = 40.0) -> Array:
    """Return the points of a hairpin between two straights, 0.25 m apart."""
    s = np.arange(0.0, 2 * straight + math.pi * radius, 0.25)
    angle = np.clip((s - straight) / radius, 0.0, math.pi)
    along = np.minimum(s, straight) - np.maximum(s - straight - math.pi * radius, 0.0)
    return np.column_stack((along + radius * np.sin(angle), radius * (1 - np.cos(angle))))


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize(("rate", "bar"), [(0.3, 0.20), (0.25, 0.40)])
def test_a_hairpin_is_driven_with_slow_steering(car: str, rate: float, bar: float) -> None:
    """With steps clipped one by one: 0.84 and 0.61 m (ordinary), 0.59 and 0.63 m (paper)."""
    points = hairpin(8.0)
    assert largest_error(car, points, points, 5.0, rate) < bar


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("noise", [0.01, 0.02])
def test_noisy_points_are_followed(car: str, noise: float) -> None:
    """With a feed-forward at the full rate: 14 to 32 m (ordinary), 0.03 to 1.2 m (paper)."""
    x, rng = np.arange(0.0, 250.0, 0.25), np.random.default_rng(1)
    true = np.column_stack((x, np.zeros(len(x))))
    points = true + noise * rng.standard_normal(true.shape)
    assert largest_error(car, points, true, 9.0, None) < 0.12
