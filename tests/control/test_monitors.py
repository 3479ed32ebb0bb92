"""Monitors of deviation and path end, the empty path, and the stop request that is withdrawn."""

import math
from dataclasses import replace
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import as_received
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import SpeedPlanner
from ampc_msgs_config.types import ERROR, NANOSECONDS, OPTIMAL, WARN, VehicleState
from ampc_ros.configuration import CONTROLLERS, Configuration, from_yaml, to_yaml
from ampc_ros.supervision.fallback import NO_REASON, OFF_PATH, PATH_ENDS, PATH_LOST
from ampc_ros.supervision.health import health, health_numbers
from ampc_ros.supervision.monitors import DeviationMonitor, Motion
from ampc_ros.supervision.progress import Location
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.car import Car
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import load_vehicle_file
from tests.supervised import made_for, supervised
from tests.workshop.acceptance.trials import Trial

ROAD = make_path([(0.0, 0.0), (2000.0, 0.0)])
POINTS = np.array([(x, 0.0) for x in np.arange(0.0, 400.1, 2.0)])
CARS = ("paper", "ordinary")


def state(t: float, x: float, y: float = 0.0, v_x: float = 9.0) -> VehicleState:
    """Return a car on the straight road."""
    return VehicleState(NANOSECONDS + round(t * NANOSECONDS), x, y, 0.0, v_x, 0.0, 0.0)


def with_settings(**values: float) -> Configuration:
    """Return a configuration with other settings."""
    config = made_for(base_link_to_cg=0.0)
    return config._replace(settings=replace(config.settings, **values))  # type: ignore[arg-type]


def detected(errors: Any, period: float = 0.1, bound: float = 1.0) -> list[float]:
    """Return the times at which a course of cross-track errors counts as off the path [s]."""
    monitor, times = DeviationMonitor(), []
    for k, error in enumerate(errors.tolist()):
        motion = Motion(round(k * period * NANOSECONDS), 9.0)
        if monitor.observe(motion, Location(ROAD, 0.0, error, 0.0), bound):
            times.append(k * period)
    return times


TIME = np.arange(0.0, 30.0, 0.1)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_error_beyond_the_bound_is_detected_once_the_car_was_on_its_path(side: float) -> None:
    assert detected(side * 0.2 * TIME)[0] == pytest.approx(5.1, abs=0.11)
    assert not detected(side * 0.99 * np.sin(TIME))


@pytest.mark.parametrize("offset", [1.5, 3.0, 5.0])
def test_approach_is_no_deviation_unless_it_takes_too_long(offset: float) -> None:
    assert not detected(offset * np.exp(-TIME / 3))
    parallel = detected(np.full(len(TIME), offset))
    assert parallel[0] == pytest.approx(4.0 + 2.0 * offset, abs=0.2)


def test_error_that_grows_during_the_approach_is_detected_after_two_seconds() -> None:
    assert detected(3.0 + 0.3 * TIME)[0] == pytest.approx(2.0, abs=0.2)
    turning = np.concatenate((3.0 + 0.5 * TIME[:12], 3.6 * np.exp(-TIME / 3)))
    assert not detected(turning)


def test_standing_car_is_not_expected_to_approach() -> None:
    monitor = DeviationMonitor()
    for k in range(1000):
        motion = Motion(k * NANOSECONDS // 10, 0.0)
        assert not monitor.observe(motion, Location(ROAD, 0.0, 3.0, 0.0), 1.0)


def test_path_that_moves_aside_is_approached_anew() -> None:
    supervisor = Supervisor(with_settings())
    for k in range(20):
        y_path = 3.5 if k >= 10 else 0.0
        supervisor.take_path(POINTS + np.array([0.0, y_path]), NANOSECONDS, NANOSECONDS)
        supervisor.take_state(state(0.1 * k, 0.9 * k), state(0.1 * k, 0.0).stamp_ns)
        supervisor.tick(state(0.1 * k, 0.0).stamp_ns)
        assert not supervisor.stop_requested


@pytest.mark.parametrize("name", CONTROLLERS)
def test_leaving_the_road_requests_a_stop_with_any_controller_and_solved_qps(name: str) -> None:
    config = made_for("ordinary", name, base_link_to_cg=0.0)
    supervisor = Supervisor(config)
    supervisor.take_path(POINTS, NANOSECONDS, NANOSECONDS)
    for k in range(40):
        y = 0.06 * k
        supervisor.take_state(new := state(0.1 * k, 20 + 0.9 * k, y), new.stamp_ns)
        record = supervisor.tick(new.stamp_ns)
        assert record is not None
        assert supervisor.stop_requested == (y > 1.0)
        if y > 1.0:
            assert (record.command.rung, record.command.reason) == (OPTIMAL, OFF_PATH)
            said = health(supervisor, record, new.stamp_ns)
            assert said.level == ERROR
            assert "off_path" in said.sentence
    supervisor.clear_stop()
    assert not supervisor.stop_requested


DRIVES = [
    *(
        Trial("straight", car, v, offset)
        for car in CARS
        for v in (9.0, 20.0)
        for offset in (3.0, 5.0)
    ),
    Trial("iso3888_1", "ordinary"),
    Trial("iso3888_2", "ordinary"),
    *(Trial("sc3_wind", car) for car in CARS),
    Trial("sc3_fast_wind", "ordinary"),
]


@pytest.mark.parametrize("trial", DRIVES, ids=str)
def test_no_stop_is_requested_in_drives_that_stay_on_the_road(trial: Trial) -> None:
    run = supervised(trial, made_for(trial.car))
    assert not max(record.stop_requested for record in run.records)


class Stopped(NamedTuple):
    """A drive towards the end of a path."""

    beyond: float
    """Position of the stop beyond the end [m]."""
    reasons: set[int]
    warned: float
    """Time from the first warning to the request [s]."""


def drive_to_the_end(v: float, controller: str = "preview", length: float = 300.0) -> Stopped:
    """Drive a path to its end; the car brakes with 2 m/s^2 on the request."""
    supervisor = Supervisor(made_for("paper", controller, base_link_to_cg=0.0))
    supervisor.take_path([(0.0, 0.0), (length, 0.0)], NANOSECONDS, NANOSECONDS)
    x, t, reasons, warned, requested = 0.0, 0.0, set[int](), math.nan, math.nan
    while v > 0 and x < 2 * length:
        supervisor.take_state(new := state(t, x, v_x=v), new.stamp_ns)
        record = supervisor.tick(new.stamp_ns)
        assert record is not None
        reasons.add(record.command.reason)
        said = health(supervisor, record, new.stamp_ns)
        if "ends in" in said.sentence and math.isnan(warned):
            assert said.level == WARN
            warned = t
        if supervisor.stop_requested and math.isnan(requested):
            requested = t
        for _ in range(10):
            v = max(v - 0.02, 0.0) if supervisor.stop_requested else v
            x += 0.01 * v
            t += 0.01
    return Stopped(x - length, reasons, requested - warned)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_car_of_a_foreign_planner_stops_at_the_end_of_its_path(controller: str) -> None:
    stopped = drive_to_the_end(8.0, controller)
    assert abs(stopped.beyond) <= 1.0
    assert stopped.reasons == {NO_REASON, PATH_ENDS}
    assert 0.5 <= stopped.warned <= 1.5


@pytest.mark.parametrize("v", [3.0, 15.0, 25.0])
def test_car_stops_at_the_end_from_any_speed(v: float) -> None:
    stopped = drive_to_the_end(v)
    assert -0.1 * v - 0.2 <= stopped.beyond <= 0.2
    assert 0.5 <= stopped.warned <= 1.5


@pytest.mark.parametrize(("v", "ahead", "requested"), [(14.0, 60.0, False), (16.0, 60.0, True)])
def test_rolling_window_must_reach_beyond_the_braking_distance(
    v: float, ahead: float, requested: bool
) -> None:
    supervisor = Supervisor(made_for("paper", base_link_to_cg=0.0))
    for k in range(50):
        x = 0.1 * k * v
        now = state(0.1 * k, 0.0).stamp_ns
        points = np.column_stack((np.arange(x - 5.0, x + ahead + 0.1, 1.0), np.zeros(66)))
        supervisor.take_path(points, now, now)
        supervisor.take_state(state(0.1 * k, x, v_x=v), now)
        record = supervisor.tick(now)
        assert record is not None
        assert record.command.reason == (PATH_ENDS if requested else NO_REASON)
    assert supervisor.stop_requested == requested


def test_closed_path_has_no_end() -> None:
    a = np.linspace(0.0, math.tau, 200)
    supervisor = Supervisor(made_for("paper", base_link_to_cg=0.0))
    supervisor.take_path(30 * np.column_stack((np.sin(a), 1 - np.cos(a))), NANOSECONDS, NANOSECONDS)
    supervisor.take_state(state(0.0, 0.0, v_x=8.0), NANOSECONDS)
    supervisor.tick(NANOSECONDS)
    assert not supervisor.stop_requested


@pytest.mark.parametrize("v", [3.0, 8.0, 20.0])
@pytest.mark.parametrize("name", CARS)
def test_own_planner_brakes_to_stand_at_the_end_without_a_request(
    v: float, name: str, tmp_path: File
) -> None:
    file = tmp_path / "road.csv"
    length = 40.0 + v**2 / 2
    rows = "".join(f"{x:g},0\n" for x in np.arange(0.0, length + 0.1, 1.0))
    file.write_text("x_m,y_m\n" + rows)
    scenario = from_csv(file, v)
    planner, supervisor = SpeedPlanner(scenario), Supervisor(made_for(name))
    supervisor.take_path(scenario.points, NANOSECONDS, NANOSECONDS)
    simulation = Simulation(load_vehicle_file(find("vehicles", name)), scenario)
    car: Car = simulation.car
    for k in range(round(10 * scenario.duration) + 50):
        new = as_received(car.measure(NANOSECONDS + k * NANOSECONDS // 10))
        supervisor.take_state(new, new.stamp_ns)
        record = supervisor.tick(new.stamp_ns)
        assert record is not None
        assert not supervisor.stop_requested
        simulation.advance(record.command.steering, planner.target_speed(new), NANOSECONDS // 10)
    assert abs(car.state[3]) < 0.3
    assert scenario.path.length - 2.0 <= car.state[0] <= scenario.path.length + 0.1


def test_empty_path_requests_a_stop_until_the_next_valid_path() -> None:
    supervisor = Supervisor(with_settings())
    supervisor.take_path([], NANOSECONDS, NANOSECONDS)
    assert supervisor.path is None
    supervisor.take_path(POINTS, NANOSECONDS, NANOSECONDS)
    seen = []
    sent: list[Any] = [POINTS, [], [], POINTS, POINTS + 0.01, np.empty((0, 2))]
    for k, points in enumerate(sent):
        supervisor.take_path(points, NANOSECONDS, NANOSECONDS)
        supervisor.take_state(new := state(0.1 * k, 0.9 * k), new.stamp_ns)
        record = supervisor.tick(new.stamp_ns)
        assert record is not None
        assert record.command.rung == OPTIMAL
        assert record.stop_requested == float(supervisor.stop_requested)
        assert (record.command.reason == PATH_LOST) == supervisor.stop_requested
        said = health(supervisor, record, new.stamp_ns)
        assert ("is empty" in said.sentence) == supervisor.stop_requested
        seen.append(supervisor.stop_requested)
    assert seen == [False, True, True, False, False, True]


@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("lost", ["state", "path"])
def test_stop_due_to_missing_inputs_is_withdrawn_after_two_seconds_if_selected(
    lost: str, resume: bool
) -> None:
    config = with_settings(resume=resume)._replace(static_path=False)
    supervisor, requested = Supervisor(config), []
    for k in range(80):
        now = state(0.1 * k, 0.0).stamp_ns
        silent = 10 <= k < 40
        if not (silent and lost == "path"):
            supervisor.take_path(POINTS, now, now)
        if not (silent and lost == "state"):
            supervisor.take_state(state(0.1 * k, 0.9 * k), now)
        record = supervisor.tick(now)
        requested.append(supervisor.stop_requested)
        assert record is not None
    assert not requested[9]
    assert requested[40]
    assert requested[59]
    assert requested[61:] == [not resume] * 19


def test_stop_of_a_car_that_left_its_path_is_never_withdrawn() -> None:
    supervisor = Supervisor(with_settings(resume=True))
    supervisor.take_path(POINTS, NANOSECONDS, NANOSECONDS)
    for k in range(60):
        y = 1.5 if k == 5 else 0.0 if k > 8 else 0.3 * min(k, 4)
        new = state(0.1 * k, 0.9 * k, y)
        supervisor.replay_state(Received(new, new.stamp_ns, new.stamp_ns), 0)
        supervisor.tick(state(0.1 * k, 0.0).stamp_ns)
    assert supervisor.stop_requested


def test_rough_path_warns_with_its_noise() -> None:
    class Noisy(NamedTuple):
        noise: float

    supervisor = Supervisor(with_settings())
    supervisor.take_path(POINTS, NANOSECONDS, NANOSECONDS)
    supervisor.take_state(state(0.0, 0.0), NANOSECONDS)
    record = supervisor.tick(NANOSECONDS)
    assert supervisor.path
    for noise, sentence in ((0.021, ""), (0.041, "path noise 4.1 cm")):
        supervisor._path = supervisor.path._replace(value=Noisy(noise))  # type: ignore[arg-type]
        said = health(supervisor, record, NANOSECONDS)
        assert (said.level, said.sentence) == (WARN if sentence else 0, sentence)
        assert health_numbers(supervisor, record)["path_noise"] == noise


def test_recording_without_the_monitors_is_repeated_without_path_end() -> None:
    text = to_yaml(made_for(), 1)
    old = "\n".join(
        line
        for line in text.splitlines()
        if not any(key in line for key in ("end_deceleration", "max_deviation", "resume"))
    )
    settings = from_yaml(old, "bag")[0].settings
    assert settings.end_deceleration == math.inf
    assert (settings.max_deviation, settings.resume) == (1.0, False)
    assert from_yaml(text, "bag")[0].settings.end_deceleration == 2.0
