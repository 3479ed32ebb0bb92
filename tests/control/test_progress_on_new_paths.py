"""Progress along the path survives new paths, new gains and restarts where roads meet themselves.

Each drive is compared with the same drive on a path that is sent once.
"""

import math
from collections.abc import Callable
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.paths.path import Path, Progress, errors_at
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.supervision.progress import PathProgress, continued
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.car import Car
from sim_vehicle.parameters import load_vehicle_file
from tests.supervised import made_for

ALLOWED = 0.05
"""Largest error above that of a path sent once [m]."""
WINDOW = 60.0
"""Length of a rolling window [m]."""


def lissajous(first: float, last: float, size: float = 120.0) -> Array:
    """Return a road that crosses itself at 53 degrees."""
    t = np.arange(first, last, 0.006)
    return size * np.column_stack((np.sin(t), np.sin(2 * t)))


def laps(aside: float = 1.2, count: float = 1.5, radius: float = 40.0) -> Array:
    """Return laps of a circle, each of them farther out by a distance [m]."""
    a = np.arange(0.0, count * math.tau, 0.015)
    r = radius + aside * a / math.tau
    return np.column_stack((r * np.sin(a), radius - r * np.cos(a)))


def hairpin(between: float = 2.0, radius: float = 9.0) -> Array:
    """Return a lane, a turn in the form of a drop, and a lane back beside it."""
    half = between / 2
    # Two arcs outwards, then the turn: the centres of the arcs lie in line with the turn's.
    turn = math.acos((radius + half) / (2 * radius))
    a = np.linspace(0.0, turn, 40)
    out = np.column_stack((radius * np.sin(a), -half - radius * (1 - np.cos(a))))
    centre = np.array([2 * radius * math.sin(turn), 0.0])
    b = np.linspace(-math.pi / 2 - turn, math.pi / 2 + turn, 120)
    drop = centre + radius * np.column_stack((np.cos(b), np.sin(b)))
    straight = np.column_stack((np.arange(-80.0, -0.5, 1.0), np.full(80, -half)))
    road = np.concatenate(
        (straight, out, drop[1:-1], out[::-1] * [1, -1], straight[::-1] * [1, -1])
    )
    return np.asarray(road)


ROADS: dict[str, tuple[Callable[[], Array], float]] = {
    "crossing": (lambda: lissajous(-0.5, math.pi + 0.7, 80.0), 8.0),
    "figure_eight": (lambda: lissajous(math.pi - 0.7, math.tau + 0.7, 60.0), 7.0),
    "parallel_laps": (laps, 8.0),
    "hairpin": (hairpin, 4.0),
}
"""Roads and their speeds [m/s]; each meets itself once."""


class Sending(NamedTuple):
    """How a planner sends the path."""

    every: int = 10**9
    """Ticks between two paths."""
    shift: float = 0.0
    """Largest shift of a whole path [m]."""
    window: bool = False
    """Whether only the part near the car is sent."""
    reload: int = 10**9
    """Ticks between two reconfigurations and restarts of the controller."""


def windowed(road: Path, s: float) -> Array:
    """Return the points of a window that starts behind the car."""
    i = np.arange(max(int((s - 5.0) / road.spacing), 0), len(road.x), 4)[: int(WINDOW)]
    return np.column_stack((road.x[i], road.y[i]))


@cache
def largest_error(name: str, car_name: str, sending: Sending, controller: str = "preview") -> float:
    """Drive a road; return the largest distance from the road, with the true progress [m]."""
    build, v = ROADS[name]
    points = build()
    road, rng = make_path(points), np.random.default_rng(3)
    config = made_for(car_name, controller)
    supervisor, true, worst = Supervisor(config), Progress(road), 0.0
    start = float(road.x[0]), float(road.y[0]), float(road.heading[0])
    car, s = Car(load_vehicle_file(find("vehicles", car_name)), start, v), 0.0
    for tick in range(int((road.length - 2.0) / v / 0.1)):
        now = NANOSECONDS + tick * NANOSECONDS // 10
        state = as_received(car.measure(now))
        centre = at_distance(state, config.base_link_to_cg)
        s = true.advance(centre.x, centre.y, centre.yaw)
        worst = max(worst, abs(errors_at(road, s, centre.x, centre.y, centre.yaw)[0]))
        if tick == 0 or tick % sending.every == 0:
            angle = rng.uniform(0.0, math.tau)
            shift = sending.shift * rng.uniform() * np.array([math.cos(angle), math.sin(angle)])
            sent = windowed(road, s) if sending.window else points
            supervisor.take_path(sent + (tick > 0) * shift, now, now)
        if tick % sending.reload == sending.reload - 1:
            supervisor.reconfigure(config)
            supervisor.restart()
        supervisor.take_state(state, now)
        record = supervisor.tick(now)
        assert record is not None
        car.advance(record.command.steering, v, np.zeros((20, 2)))
    return worst


SENDINGS = {
    "each_second": Sending(10, 0.001),
    "shifted": Sending(10, 0.04),
    "window": Sending(2, 0.001, window=True),
    "reload": Sending(reload=7),
}


@pytest.mark.parametrize(
    ("road", "sending", "car"),
    [
        *product(ROADS, ["shifted", "window", "reload"], ["paper", "ordinary"]),
        ("crossing", "each_second", "ordinary"),
    ],
)
def test_path_sent_again_is_followed_like_a_path_sent_once(
    road: str, sending: str, car: str
) -> None:
    once = largest_error(road, car, Sending())
    again = largest_error(road, car, SENDINGS[sending])
    assert again <= once + ALLOWED, (once, again)


@pytest.mark.parametrize(
    ("road", "car"),
    [("hairpin", "paper"), ("figure_eight", "paper"), ("parallel_laps", "ordinary")],
)
def test_path_sent_at_each_tick_is_followed_like_a_path_sent_once(road: str, car: str) -> None:
    once = largest_error(road, car, Sending())
    again = largest_error(road, car, Sending(1, 0.05))
    assert again <= once + ALLOWED, (once, again)


def test_pure_pursuit_continues_on_its_branch() -> None:
    once = largest_error("parallel_laps", "paper", Sending(), "pure_pursuit")
    again = largest_error("parallel_laps", "paper", SENDINGS["each_second"], "pure_pursuit")
    assert again <= once + ALLOWED


def at(path: Path, s: float, aside: float = 0.0) -> VehicleState:
    """Return a car beside a sample of a path."""
    i = round(s / path.spacing)
    x, y, heading = path.x[i], path.y[i], path.heading[i]
    return VehicleState(
        0, x - aside * math.sin(heading), y + aside * math.cos(heading), heading, 8.0, 0.0, 0.0
    )


def test_laps_on_one_line_continue_by_progress() -> None:
    path = make_path(laps(aside=0.0, count=3.5))
    moved = path._replace(x=path.x + 0.02)
    lap = 40.0 * math.tau
    for s in (30.0, 30.0 + lap, 30.0 + 2 * lap):
        joined = continued(path, s, moved, at(path, s))
        assert joined * moved.spacing == pytest.approx(s, abs=0.5)


def test_rest_of_the_road_continues_by_its_end() -> None:
    points = laps(aside=0.0, count=3.5)
    path, rest = make_path(points), make_path(points[880:])
    s = path.length - rest.length + 40.0
    joined = continued(path, s, rest, at(path, s))
    assert joined * rest.spacing == pytest.approx(40.0, abs=0.5)


def test_same_path_is_handed_on_unchanged() -> None:
    path, progress = make_path(laps()), PathProgress()
    for s in (10.0, 12.0, 14.0):
        location = progress.locate(at(path, s, 0.3), path, renew=False)
        assert location.path is path
        assert location.s == pytest.approx(s, abs=0.1)
        assert location.cross_track_error == pytest.approx(0.3, abs=0.01)


def test_jump_of_the_position_keeps_the_lap() -> None:
    path, progress = make_path(laps()), PathProgress()
    s = 300.0
    index = round(s / path.spacing)
    progress.locate(at(path, 10.0), path, renew=False)
    assert progress.tracker
    progress.tracker.index = index
    progress.relocate(at(path, s + 30.0, 1.0))
    location = progress.locate(at(path, s + 30.0, 1.0), path, renew=True)
    assert location.s == pytest.approx(s + 30.0, abs=0.5)
    assert location.path.entry == progress.tracker.index


def test_a_path_that_the_controller_cannot_follow_when_averaged_is_used_as_it_came() -> None:
    def refuse(path: Path) -> None:
        if len(path.x) != len(new.x):
            raise ValueError("longer than it came")

    a = np.arange(0.0, 2.0, 0.02)
    bend = 50.0 * np.column_stack((np.sin(a), 1.0 - np.cos(a)))
    old, new = make_path(bend), make_path(bend[30:])
    progress = PathProgress()
    progress.locate(at(old, 27.0), old, renew=False)
    assert len(progress.locate(at(old, 27.0), new, refuse, renew=False).path.x) == len(new.x)
    progress = PathProgress()
    progress.locate(at(old, 27.0), old, renew=False)
    assert len(progress.locate(at(old, 27.0), new, renew=False).path.x) > len(new.x)
