"""Checks of a path: what the car cannot drive is refused, with place, value and bound."""

import math
import re
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.config import find, shipped
from ampc_msgs_config.parameters import ChassisParameters, SizeParameters, SteeringParameters
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.supervision.checks import check_path, mean_curvature

DATA = File(__file__).resolve().parents[3] / "shared" / "data"
SIDES = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
UP = math.inf
CHASSIS = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
STEERING = load_section(SteeringParameters, find("vehicles", "paper"), "steering")
MAX_ANGLE = STEERING.max_angle
SHARPEST = math.tan(MAX_ANGLE) / CHASSIS.wheelbase


def circle(radius: float, side: float = 1.0, turn: float = 4.0) -> np.ndarray[Any, Any]:
    """Return points of a circle, half a metre apart."""
    angle = np.arange(0.0, turn, 0.5 / radius)
    return radius * np.column_stack((np.sin(angle), side * (1 - np.cos(angle))))


BAD_PATHS: dict[str, Any] = {
    r"path: shape \(0,\) must be": [],
    "1 different points, at least 2": [(1.0, 2.0)],
    "path: 1 different points": [(1.0, 2.0), (1.0, 2.0)],
    r"point 1 = \[nan, 1.0\] must be finite": [(0.0, 0.0), (math.nan, 1.0), (2.0, 0.0)],
    "path: length": [(0.0, 0.0), (3.0e6, 0.0)],
}


@pytest.mark.parametrize("sentence", BAD_PATHS)
def test_points_that_make_no_path_are_refused(sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        check_path(BAD_PATHS[sentence], CHASSIS, MAX_ANGLE)


def test_a_gap_of_more_than_25_metres_is_refused_with_its_place() -> None:
    for gap in (math.nextafter(25.0, 0.0), 25.0):
        check_path([(0.0, 0.0), (gap, 0.0), (30.0, 0.0)], CHASSIS, MAX_ANGLE)
    for gap in (math.nextafter(25.0, UP), 25.1):
        points = [(-9.0, 0.0), (0.0, 0.0), (gap, 0.0), (40.0, 0.0)]
        sentence = f"path: gap between points 1 and 2 = {gap:g} m must be at most 25 m"
        with pytest.raises(ValueError, match=re.escape(sentence)):
            check_path(points, CHASSIS, MAX_ANGLE)
    check_path(points, CHASSIS, MAX_ANGLE, max_gap=25.2)


def test_a_gap_counts_from_three_points_on() -> None:
    check_path([(0.0, 0.0), (25.0, 0.0), (50.0, 0.0)], CHASSIS, MAX_ANGLE)
    with pytest.raises(ValueError, match=r"gap between points 1 and 2 = 25\.1 m"):
        check_path([(0.0, 0.0), (25.0, 0.0), (50.1, 0.0)], CHASSIS, MAX_ANGLE)


def test_two_points_are_a_straight_road_of_any_length() -> None:
    path = check_path([(0.0, 0.0), (300.0, 1.0)], CHASSIS, MAX_ANGLE)
    assert path.length == pytest.approx(300.0, abs=0.1)
    assert check_path([(0.0, 0.0), (0.3, 0.0)], CHASSIS, MAX_ANGLE).length == pytest.approx(0.3)


@SIDES
def test_a_bend_beyond_the_car_is_refused_with_its_place(side: float) -> None:
    points = circle(10.0, side)
    sharpest = float(np.abs(mean_curvature(make_path(points), CHASSIS.wheelbase)).max())
    limit = math.atan(sharpest * CHASSIS.wheelbase)
    path = check_path(points, CHASSIS, limit * (1 + 1e-14))
    assert np.array_equal(path.curvature, make_path(points).curvature)
    sentence = r"path: curvature after .* m = -?0\.1.* 1/m must lie in \[-0\.1.*, 0\.1.*\] 1/m"
    with pytest.raises(ValueError, match=sentence):
        check_path(points, CHASSIS, limit * (1 - 1e-14))


@SIDES
@pytest.mark.parametrize("turn", [4.0, math.tau])
def test_a_car_turns_no_sharper_than_its_steering_lets_it(side: float, turn: float) -> None:
    check_path(circle(1.03 / SHARPEST, side, turn), CHASSIS, MAX_ANGLE)
    with pytest.raises(ValueError, match=r"curvature after .* must lie in"):
        check_path(circle(0.97 / SHARPEST, side, turn), CHASSIS, MAX_ANGLE)


def test_mean_curvature_goes_round_a_closed_path() -> None:
    path = make_path(circle(20.0, turn=math.tau))
    assert path.closed
    bend = mean_curvature(path, 5.0)
    assert len(bend) == len(path.x) - 1
    np.testing.assert_allclose(bend, 1 / 20.0, rtol=0.01)


def test_mean_curvature_of_a_closed_path_is_the_same_however_the_path_is_turned() -> None:
    for turned in (0.0, 1.0, -2.5):
        cos, sin = math.cos(turned), math.sin(turned)
        points = circle(20.0, turn=2 * math.pi) @ np.array([[cos, sin], [-sin, cos]])
        path = make_path([*points.tolist(), points[0].tolist()])
        assert path.closed
        assert mean_curvature(path, CHASSIS.wheelbase) == pytest.approx(0.05, rel=0.02)


def test_points_that_jitter_by_5_centimetres_can_be_driven_and_a_right_angle_cannot() -> None:
    points = circle(50.0)[::2]
    jitter = 0.05 * np.random.default_rng(1).standard_normal(points.shape)
    path = check_path(points + jitter, CHASSIS, MAX_ANGLE)
    assert path.noise == pytest.approx(0.05, rel=0.2)
    assert path.curvature == pytest.approx(1 / 50.0, abs=0.005)
    rough = make_path(points + jitter, path_noise=0.0)
    assert np.abs(rough.curvature).max() > 2 * SHARPEST
    corner = [*((x, 0.0) for x in range(21)), *((20.0, y) for y in range(1, 21))]
    with pytest.raises(ValueError, match=r"path: curvature after 1[78].* m = 0\.[3-7]"):
        check_path(corner, CHASSIS, MAX_ANGLE)


@pytest.mark.parametrize("name", shipped("scenarios"))
@pytest.mark.parametrize("car", shipped("vehicles"))
def test_every_shipped_scenario_can_be_driven(name: str, car: str) -> None:
    chassis = load_section(ChassisParameters, find("vehicles", car), "chassis")
    steering = load_section(SteeringParameters, find("vehicles", car), "steering")
    size = load_section(SizeParameters, find("vehicles", car), "size")
    check_path(load_scenario(name, size).points, chassis, steering.max_angle)


@pytest.mark.skipif(not DATA.is_dir(), reason="../shared/data is not at hand")
@pytest.mark.parametrize("file", sorted(DATA.glob("*/*.csv")), ids=lambda file: file.stem)
def test_every_recorded_road_can_be_driven(file: File) -> None:
    check_path(from_csv(file, 5.0).points, CHASSIS, MAX_ANGLE)
