"""Scenarios: the shipped ones against their definition, and the errors of bad ones."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find, shipped
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.curves import ISO_ENTRY, q
from ampc_msgs_config.paths.path import STAND_OFF, point_at, project
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import (
    POINT_SPACING,
    SPEED_PREVIEW,
    Scenario,
    SpeedPlanner,
    SpeedProfile,
    load_scenario,
    speed_at,
    wind_of_drive,
)
from ampc_msgs_config.scenarios.wind import wind_at, wind_of_steps
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_msgs_config.vehicle_file import load_section

SIZE = load_section(SizeParameters, find("vehicles", "paper"), "size")
many = settings(max_examples=60, deadline=None, derandomize=True)


def shipped_scenario(name: str) -> Scenario:
    """Load a shipped scenario for the paper's car."""
    return load_scenario(name, SIZE)


def tanh_lane_change(X: Array) -> Array:
    """Return Y(X) of sc1_falcone."""
    z1 = 2.4 / 25 * (X - 27.19) - 1.2
    z2 = 2.4 / 21.95 * (X - 56.46) - 1.2
    return np.asarray(4.05 / 2 * (1 + np.tanh(z1)) - 5.7 / 2 * (1 + np.tanh(z2)))


def moves(starts: list[float], lengths: list[float], ends: list[float], X: Array) -> Array:
    """Return Y(X) that moves with q from one place to the next."""
    steps = np.diff(ends, prepend=0.0)
    return np.asarray(
        sum(d * q((X - a) / n) for a, n, d in zip(starts, lengths, steps, strict=True))
    )


def sc3(X: Array) -> Array:
    """Return Y(X) of sc3_constant."""
    starts, lengths = [90.0, 150, 215, 300, 365, 430], [50.0, 60, 70, 85, 50, 40]
    return moves(starts, lengths, [10.0, -8, 15, -15, 5, 0], X)


PATHS: dict[str, Callable[[Array], Array]] = {
    "sc1": lambda X: 3.5 * (q((X - 30) / 30) - q((X - 85) / 30)),
    "sc1_falcone": tanh_lane_change,
    "sc2": lambda X: 3.5 * (q((X - 40) / 30) - q((X - 95) / 30)),
    "sc3_constant": sc3,
    "sc3_varying": sc3,
    "sc3_wind": sc3,
    "sc3_fast_wind": lambda X: sc3(X / 2.6),
    "straight": lambda X: 0.0 * X,
}
SPEEDS: dict[
    str, list[tuple[float, float]]
] = {  # (time, speed) where the profile stands, and half-way between, where q = 1/2
    "sc1": [(0, 9), (17, 9)],
    "sc2": [(0, 9), (2, 9), (4, 12), (6, 15), (8, 15), (10, 10.5), (12, 6), (16, 6)],
    "sc3_constant": [(0, 11), (48, 11)],
    "sc3_varying": [(0, 11), (4, 11), (6, 12), (8, 13), (12, 13), (14, 10.5), (16, 8)],
    "sc3_wind": [(24, 8), (26.5, 10), (29, 12), (34, 12), (36.5, 9), (39, 6), (50, 6)],
    "sc3_fast_wind": [(0, 18), (45, 18)],
}
DURATIONS = {"sc1": 17, "sc1_falcone": 15, "sc2": 16, "sc3_constant": 48, "sc3_varying": 50}
DURATIONS |= {"sc3_wind": 50, "sc3_fast_wind": 45}
DEMANDS = {"sc1": 1.8, "sc1_falcone": 2.2, "sc2": 5.0, "sc3_constant": 7.9, "sc3_varying": 4.9}


@pytest.mark.parametrize("name", sorted(shipped("scenarios")))
@pytest.mark.parametrize("vehicle", sorted(shipped("vehicles")))
def test_shipped_scenarios_load_and_their_paths_outlast_the_drive(name: str, vehicle: str) -> None:
    scenario = load_scenario(name, load_section(SizeParameters, find("vehicles", vehicle), "size"))
    path = make_path(scenario.points)
    driven = sum(
        speed_at(scenario.speed, 0.1 * i) * 0.1 for i in range(int(10 * scenario.duration))
    )
    assert path.length > driven + 30.0
    assert all(math.isfinite(value) for value in scenario.start)


@pytest.mark.parametrize("name", PATHS)
def test_path_is_the_defined_one(name: str) -> None:
    X, Y = shipped_scenario(name).points.T
    assert X[0] == 0.0
    np.testing.assert_allclose(Y, PATHS[name](X), atol=1e-12)


@pytest.mark.parametrize("name", SPEEDS)
def test_speed_is_the_defined_one(name: str) -> None:
    profile = shipped_scenario(name).speed
    for time, speed in SPEEDS[name]:
        assert speed_at(profile, time) == pytest.approx(speed)


@pytest.mark.parametrize("name", DURATIONS)
def test_drive_ends_when_it_is_defined_to(name: str) -> None:
    assert shipped_scenario(name).duration == DURATIONS[name]


@pytest.mark.parametrize("name", DEMANDS)
def test_path_demands_the_lateral_acceleration_of_its_definition(name: str) -> None:
    scenario = shipped_scenario(name)
    path, s, demand = make_path(scenario.points), 0.0, 0.0
    for time in np.arange(0.0, scenario.duration, 0.01).tolist():
        v = speed_at(scenario.speed, time)
        demand = max(demand, v**2 * float(abs(point_at(path, s).curvature)))
        s += 0.01 * v
    assert demand == pytest.approx(DEMANDS[name], abs=0.06)


def test_q_rises_from_zero_to_one_with_flat_ends() -> None:
    z = np.linspace(-1.0, 2.0, 3001)
    np.testing.assert_array_equal(q(z[z <= 0]), 0.0)
    np.testing.assert_allclose(q(z[z >= 1]), 1.0)
    inner = np.clip(z, 0.0, 1.0)
    np.testing.assert_allclose(q(z), 10 * inner**3 - 15 * inner**4 + 6 * inner**5, atol=1e-14)
    slope, bend = np.gradient(q(z), z), np.gradient(np.gradient(q(z), z), z)
    assert np.abs(slope[[999, 1001, 1999, 2001]]).max() < 1e-4
    assert np.abs(bend[[999, 1001, 1999, 2001]]).max() < 0.1


def test_wind_of_sc3_is_the_defined_one() -> None:
    wind = shipped_scenario("sc3_wind").wind
    assert shipped_scenario("sc3_fast_wind").wind == wind
    expected = {4.9: 0, 5.75: 7.5, 6.5: 15, 8.1: 0, 12.0: 0, 12.25: 10, 12.5: 20, 17.5: 20}
    expected |= {17.75: 10, 18.0: 0, 24.0: -25, 30.5: -18, 35.5: -18, 36.2: 0, 38.5: 25, 41.0: 0}
    velocity = wind_at(wind, np.array(list(expected)))
    np.testing.assert_array_equal(velocity[:, 0], 0.0)
    np.testing.assert_allclose(velocity[:, 1], list(expected.values()), atol=1e-12)


def test_pieces_of_wind_add_up() -> None:
    wind = shipped_scenario("sc3_wind").wind
    time = np.linspace(0.0, 50.0, 501, dtype=np.float64)
    total = sum(wind_at((piece,), time) for piece in wind)
    np.testing.assert_allclose(wind_at(wind, time), total)


@pytest.mark.parametrize("name", ["sc3_wind", "sc1"])
@pytest.mark.parametrize("period_ns", [100_000_000, 30_000_000])
def test_wind_of_a_drive_is_that_of_its_periods_bit_for_bit(name: str, period_ns: int) -> None:
    scenario, step_ns = shipped_scenario(name), 5_000_000
    whole, steps = wind_of_drive(scenario, step_ns, period_ns), period_ns // step_ns
    begins = range(0, round(scenario.duration * NANOSECONDS), period_ns)
    periods = [wind_of_steps(scenario.wind, begin, step_ns, steps) for begin in begins]
    np.testing.assert_array_equal(whole, np.concatenate(periods))
    assert whole.any() == bool(scenario.wind)


@pytest.mark.parametrize("part", [1, 2])
@pytest.mark.parametrize("width", [1.6, 1.82, 2.2])
def test_iso_lanes_follow_from_the_width_of_the_car(part: int, width: float) -> None:
    size = SizeParameters(width=width, front_overhang=0.9, rear_overhang=1.0)
    entry, side, leave = load_scenario(f"iso3888_{part}", size).lanes
    edges = {1: (0, 15, 45, 70, 95, 125), 2: (0, 12, 25.5, 36.5, 49, 61)}[part]
    along = [entry.start, entry.end, side.start, side.end, leave.start, leave.end]
    np.testing.assert_allclose(along, np.add(edges, ISO_ENTRY))
    widths = {
        1: (1.1 * width + 0.25, 1.2 * width + 0.25, 1.3 * width + 0.25),
        2: (1.1 * width + 0.25, width + 1.0, max(1.3 * width + 0.25, 3.0)),
    }[part]
    np.testing.assert_allclose([lane.left - lane.right for lane in (entry, side, leave)], widths)
    assert entry.left == pytest.approx(-entry.right)
    assert leave.right == pytest.approx(entry.right)
    offset = side.right - entry.right if part == 1 else side.right - entry.left
    assert offset == pytest.approx({1: 3.5, 2: 1.0}[part])


@pytest.mark.parametrize("part", [1, 2])
@pytest.mark.parametrize("width", [1.6, 1.82, 2.2])
def test_car_in_the_middle_of_the_iso_path_touches_no_cone(part: int, width: float) -> None:
    size = SizeParameters(width=width, front_overhang=0.9, rear_overhang=1.0)
    scenario = load_scenario(f"iso3888_{part}", size)
    path = make_path(scenario.points)
    for lane in scenario.lanes:
        for X in np.arange(lane.start, lane.end, 0.5).tolist():
            for cone_y, side in ((lane.left, 1.0), (lane.right, -1.0)):
                s = project(path, X, cone_y, 0, len(path.x))
                point = point_at(path, s)
                distance: float = side * (cone_y - point.y) * math.cos(point.heading)
                distance -= side * (X - point.x) * math.sin(point.heading)
                assert distance > width / 2


def test_iso_path_begins_and_ends_in_the_middle_of_its_lanes() -> None:
    for name in ("iso3888_1", "iso3888_2"):
        scenario = shipped_scenario(name)
        X, Y = scenario.points.T
        for lane, place in zip(scenario.lanes, (0, 0.5, 1), strict=True):
            middle = (lane.left + lane.right) / 2
            at = lane.start + place * (lane.end - lane.start)
            assert float(np.interp(at, X, Y)) == pytest.approx(middle, abs=0.02)


def test_stretch_stretches_path_and_lanes_along_x(tmp_path: Path) -> None:
    path = {"kind": "same_as", "scenario": "iso3888_1", "stretch": 2.0}
    stretched, plain = (
        load_scenario(written(tmp_path, path=path, duration=60.0), SIZE),
        shipped_scenario("iso3888_1"),
    )
    for long, short in zip(stretched.lanes, plain.lanes, strict=True):
        assert long == (2 * short.start, 2 * short.end, short.right, short.left)
    X, Y = plain.points[2 * plain.points[:, 0] < stretched.points[-1, 0]].T
    np.testing.assert_allclose(np.diff(stretched.points[:, 0]), POINT_SPACING)
    assert np.ptp(Y) > 3.0
    np.testing.assert_allclose(np.interp(2 * X, *stretched.points.T), Y, atol=0.02)


@pytest.mark.parametrize("radius", [50.0, -20.0])
def test_circle_has_its_radius_to_its_side(radius: float, tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, path={"kind": "circle", "radius": radius}), SIZE)
    np.testing.assert_allclose(np.hypot(*(scenario.points - (0.0, radius)).T), abs(radius))
    assert math.copysign(1.0, radius) * scenario.points[5, 1] > 0


def test_sine_reaches_its_amplitude_to_both_sides() -> None:
    _, Y = shipped_scenario("sine").points.T
    assert (Y.max(), Y.min()) == (pytest.approx(2.0, abs=0.01), pytest.approx(-2.0, abs=0.01))


@pytest.mark.parametrize("offset", [1.5, -1.5])
def test_start_lies_beside_the_first_point_heading_along_the_path(
    offset: float, tmp_path: Path
) -> None:
    content = {"path": {"kind": "circle", "radius": 30.0}, "start_offset": offset}
    x, y, yaw = load_scenario(written(tmp_path, **content), SIZE).start
    assert (x, y, yaw) == pytest.approx((0.0, offset, 0.0), abs=1e-3)


def test_start_of_a_path_that_begins_with_the_same_point_twice_heads_along_it() -> None:
    points = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 10.0], [0.0, 20.0]])
    profile = SpeedProfile(False, np.array([0.0]), np.array([5.0]))
    assert Scenario("up", points, profile, 1.0).start[2] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("turn", [0.0, 0.7, math.pi / 2, -2.5])
@pytest.mark.parametrize("offset", [1.5, -1.5])
def test_start_offset_is_to_the_left_of_a_road_in_any_direction(turn: float, offset: float) -> None:
    along = np.array([math.cos(turn), math.sin(turn)])
    points = np.outer(np.arange(0.0, 50.0, 5.0), along) + np.array([3.0, -4.0])
    profile = SpeedProfile(False, np.array([0.0]), np.array([5.0]))
    x, y, yaw = Scenario("road", points, profile, 1.0, start_offset=offset).start
    assert yaw == pytest.approx(turn)
    assert (x, y) == pytest.approx((3.0 - offset * along[1], -4.0 + offset * along[0]))


def test_sine_begins_without_a_kink_of_heading_and_with_its_full_amplitude_after_a_wave() -> None:
    scenario = shipped_scenario("sine")
    X, Y = scenario.points.T
    assert abs(np.gradient(Y, X)[:3]).max() < 1e-3
    full = X >= 80.0
    np.testing.assert_allclose(Y[full], 2.0 * np.sin(math.tau * X[full] / 80.0), atol=1e-9)


def test_path_of_a_scenario_is_fitted_once_for_equal_points() -> None:
    scenario = shipped_scenario("sc1")
    copy = scenario._replace(points=scenario.points.copy(), duration=1.0)
    assert copy.path is scenario.path
    for cached, fitted in zip(scenario.path, make_path(scenario.points), strict=True):
        np.testing.assert_array_equal(cached, fitted)
    assert scenario._replace(points=scenario.points + 1.0).path is not scenario.path


def test_constant_speed_replaces_the_profile() -> None:
    scenario = load_scenario("sc2", SIZE, speed=4.0)
    assert {speed_at(scenario.speed, t) for t in (0.0, 7.0, 99.0)} == {4.0}


@many
@given(time=st.floats(-10, 100))
def test_speed_over_time_stays_within_its_points_and_its_ends_are_held(time: float) -> None:
    profile = shipped_scenario("sc3_varying").speed
    assert 6.0 <= speed_at(profile, time) <= 13.0
    assert speed_at(profile, -5.0) == 11.0
    assert speed_at(profile, 200.0) == 6.0


def at(time: float, x: float = 0.0) -> VehicleState:
    """Return a car at a time [s] and a place on the x axis [m]."""
    return VehicleState(round(time * NANOSECONDS), x, 0.0, 0.0, 5.0, 0.0, 0.0)


def test_planner_reads_time_from_its_first_state_and_ahead_by_the_preview() -> None:
    scenario = shipped_scenario("sc2")
    planner = SpeedPlanner(scenario)
    for time in (0.0, 3.0, 9.0):
        expected = speed_at(scenario.speed, time + SPEED_PREVIEW)
        assert planner.target_speed(at(1000.0 + time)) == expected


def over_distance(speeds: list[float]) -> SpeedPlanner:
    """Return a planner of a straight road with these speeds every 10 m."""
    place = np.arange(0.0, 10.0 * len(speeds), 10.0, dtype=np.float64)
    points = np.column_stack((place, 0.0 * place))
    profile = SpeedProfile(True, place, np.array(speeds))
    return SpeedPlanner(Scenario("road", points, profile, 10.0))


def test_planner_reads_distance_ahead_by_what_the_car_drives_in_the_preview() -> None:
    planner = over_distance([4.0, 8.0, 8.0, 2.0, 2.0, 2.0])
    assert planner.target_speed(at(0.0, 5.0)) == pytest.approx(4.0 + 0.4 * (5.0 + 6.0 * 0.5))
    assert planner.target_speed(at(0.1, 15.0)) == pytest.approx(8.0)
    assert planner.target_speed(at(0.2, 29.0)) == pytest.approx(2.0, abs=0.1)


def test_car_leaves_a_standstill_that_the_profile_begins_with_and_stands_at_its_end() -> None:
    planner, x, v = over_distance([0.0, 5.0, 5.0, 0.0]), 0.0, 0.0
    fastest = 0.0
    for i in range(400):
        v += 0.1 * (planner.target_speed(at(0.1 * i, x)) - v) / SPEED_PREVIEW
        x, fastest = x + 0.1 * v, max(fastest, v)
    assert fastest == pytest.approx(5.0, rel=0.05)
    assert x == pytest.approx(30.0 - STAND_OFF, abs=0.5)
    assert v == pytest.approx(0.0, abs=0.01)


def test_profile_of_a_circuit_begins_anew_with_each_lap() -> None:
    profile = SpeedProfile(True, np.array([0.0, 10.0, 40.0]), np.array([4.0, 8.0, 4.0]), 40.0)
    for place, speed in ((5.0, 6.0), (25.0, 6.0), (45.0, 6.0), (-15.0, 6.0), (80.0, 4.0)):
        assert speed_at(profile, place) == pytest.approx(speed)


def written(folder: Path, **changes: Any) -> str:
    """Write a good scenario with some keys changed, None removes one; gives its name."""
    good = {"path": {"kind": "straight"}, "speed": [[0.0, 5.0]], "duration": 5.0}
    content = {key: value for key, value in {**good, **changes}.items() if value is not None}
    file = folder / "mine.yaml"
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    return str(file)


GUST = {"kind": "gust", "start": 1.0, "end": 3.0, "speed": 10.0}
MOVE = {"start": 30.0, "over": 30.0, "by": 3.5}
BAD: dict[str, dict[str, Any]] = {
    "missing key 'path'": {"path": None},
    "missing key 'speed'": {"speed": None},
    "missing key 'duration'": {"duration": None},
    "unknown key 'sped'; known are path, speed": {"sped": 1},
    r"duration = 0 must lie in \[0.1, 100000\]": {"duration": 0},
    r"duration = nan must lie in": {"duration": math.nan},
    r"duration = True must be a number": {"duration": True},
    r"start_offset = '1' must be a number in \[-100, 100\]": {"start_offset": "1"},
    r"path = 'straight' must be a mapping": {"path": "straight"},
    r"path: missing key 'kind'": {"path": {}},
    r"path.kind = 'spiral' must be one of moves, .*same_as": {"path": {"kind": "spiral"}},
    r"path: unknown key 'raduis'": {"path": {"kind": "circle", "raduis": 3.0}},
    r"path: unknown key 'radius'; known are kind, amp": {"path": {"kind": "sine", "radius": 3}},
    r"path: missing key 'radius'": {"path": {"kind": "circle"}},
    r"path.radius = 0.5 must be at least 1 m": {"path": {"kind": "circle", "radius": 0.5}},
    r"path.part = 3 must lie in \[1, 2\]": {"path": {"kind": "iso3888", "part": 3}},
    r"path.moves = 5 must be a list": {"path": {"kind": "moves", "moves": 5}},
    r"path.moves\[0\] = 'left' must be a mapping": {"path": {"kind": "moves", "moves": ["left"]}},
    r"path.moves\[0\].over = 0 must lie in \[0.1": {
        "path": {"kind": "moves", "moves": [{**MOVE, "over": 0}]}
    },
    r"path.moves\[0\].by = 'far' must be a number": {
        "path": {"kind": "moves", "moves": [{**MOVE, "by": "far"}]}
    },
    r"path.stretch = -1 must lie": {"path": {"kind": "same_as", "scenario": "sc1", "stretch": -1}},
    r"'sc9' is neither a file nor": {"path": {"kind": "same_as", "scenario": "sc9"}},
    r"speed = 9 must be a list": {"speed": 9},
    r"speed\[0\]\[1\] = 'fast' must be a number": {"speed": [[0, "fast"]]},
    r"speed\[1\] = \[2\] must be a list of 2 entries": {"speed": [[0, 1], [2]]},
    r"speed = \[\] must be a list of 1 to": {"speed": []},
    r"speed\[0\]\[1\] = nan must lie in": {"speed": [[0, math.nan]]},
    r"speed\[2\]: time 1 must be greater than 2": {"speed": [[0, 5], [2, 5], [1, 5]]},
    r"speed\[1\]: time 2 must be greater than 2": {"speed": [[2, 5], [2, 6]]},
    r"speed\[0\]\[1\] = 101 must lie in \[0, 100\] m/s": {"speed": [[0, 101]]},
    r"speed\[0\]\[1\] = -1 must lie in \[0, 100\] m/s": {"speed": [[0, -1]]},
    r"wind = 3 must be a list": {"wind": 3},
    r"wind\[0\].kind = 'storm' must be one of gust, block": {"wind": [{**GUST, "kind": "storm"}]},
    r"wind\[0\]: unknown key 'form'": {"wind": [{**GUST, "form": 1}]},
    r"wind\[0\].end = 1.5 must be at least 2": {"wind": [{**GUST, "end": 1.5}]},
    r"wind\[0\].speed = 99 must lie in \[-80, 80\]": {"wind": [{**GUST, "speed": 99}]},
}


@pytest.mark.parametrize("complaint", BAD)
def test_bad_scenario_is_refused_with_file_key_value_and_bound(
    complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=f"mine.yaml: .*{complaint}"):
        load_scenario(written(tmp_path, **BAD[complaint]), SIZE)


@pytest.mark.parametrize("key", ["path", "speed", "wind"])
def test_scenario_that_refers_to_itself_is_refused(key: str, tmp_path: Path) -> None:
    file = str(tmp_path / "mine.yaml")
    itself = {"kind": "same_as", "scenario": file} if key == "path" else {"same_as": file}
    with pytest.raises(ValueError, match=rf"mine.yaml: {key} refers to another scenario"):
        load_scenario(written(tmp_path, **{key: itself}), SIZE)


def test_good_scenario_of_a_user_loads(tmp_path: Path) -> None:
    path = {"kind": "moves", "moves": [MOVE]}
    scenario = load_scenario(written(tmp_path, path=path, wind=[GUST]), SIZE)
    assert (scenario.name, scenario.duration, scenario.wind[0].speed) == ("mine", 5.0, 10.0)
