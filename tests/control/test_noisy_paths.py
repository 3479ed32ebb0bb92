"""Paths whose points are noisy or rounded, driven in closed loop against the true road."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.paths.path import Progress
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array
from ampc_ros.configuration import Choices, configuration
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.car import Car
from sim_vehicle.parameters import load_vehicle_file

LENGTH = 260.0
"""Arc length of the roads [m]."""
WINDOW = 60.0
"""Length of a rolling window [m]."""


def road(kind: str, spacing: float) -> Array:
    """Return points of a straight road, a weave or a bend, turned against the axes (n, 2) [m]."""
    s = np.arange(0.0, LENGTH, spacing)
    x, y = {
        "straight": (s, 0.0 * s),
        "weave": (s, 2.0 * (1.0 - np.cos(s / 15.0))),
        "bend": (60.0 * np.sin(s / 60.0), 60.0 * (1.0 - np.cos(s / 60.0))),
    }[kind]
    c, k = math.cos(0.137), math.sin(0.137)
    return np.column_stack((c * x - k * y, k * x + c * y))


def largest_error(
    kind: str,
    car: str,
    spacing: float,
    change: str,
    window: float | None = None,
    path_noise: float = -1.0,
) -> float:
    """Return the largest error of the centre of gravity from the true road at 9 m/s [m].

    Args:
        kind: Road.
        car: Shipped vehicle.
        spacing: Distance of the points [m].
        change: `noise X` or `grid X`, X in m.
        window: Begin of a window, relative to the car, that is sent with new noise at each tick
            [m]; None: the whole road is sent once.
        path_noise: Setting of the controller [m].
    """
    rng, (how, size) = np.random.default_rng(7), change.split()
    config = configuration(Choices(vehicle=car, static_path=True))
    config = config._replace(settings=replace(config.settings, path_noise=path_noise))
    supervisor, true = Supervisor(config), make_path(road(kind, 0.5))
    progress, points, worst, s = Progress(true), road(kind, spacing), 0.0, 0.0
    start = float(true.x[0]), float(true.y[0]), float(true.heading[0])
    simulated = Car(load_vehicle_file(find("vehicles", car)), start, 9.0)
    for tick in range(250 if window is None else 170):  # a path for each tick takes its time
        now_ns = NANOSECONDS + tick * NANOSECONDS // 10
        state = as_received(simulated.measure(now_ns))
        centre = at_distance(state, config.base_link_to_cg)
        worst = max(worst, abs(progress.errors(centre)[0]))
        s = progress.advance(centre.x, centre.y, centre.yaw)
        if tick == 0 or window is not None:
            along = spacing * np.arange(len(points))
            first = -math.inf if window is None else s + window
            ahead = (along > first) & (along < (first if window else math.inf) + WINDOW)
            clean, unit = points[ahead], float(size)
            if how == "noise":
                sent = clean + unit * rng.standard_normal(clean.shape)
            else:
                sent = np.round(clean / unit) * unit
            supervisor.take_path(sent, now_ns, now_ns)
        supervisor.take_state(state, now_ns)
        record = supervisor.tick(now_ns)
        assert record is not None
        simulated.advance(record.command.steering, 9.0, np.zeros((20, 2)))
    return worst


@pytest.mark.parametrize("car", ["ordinary", "paper"])
@pytest.mark.parametrize("kind", ["straight", "weave", "bend"])
@pytest.mark.parametrize(
    ("change", "spacing", "target"),
    [
        ("noise 0.01", 0.5, 0.12),
        ("noise 0.02", 0.25, 0.15),
        ("noise 0.05", 1.0, 0.30),
        ("grid 0.05", 0.25, 0.20),
        ("grid 0.1", 0.5, 0.35),
    ],
)
def test_noise_of_the_points_costs_no_more_than_the_target(
    change: str, spacing: float, target: float, kind: str, car: str
) -> None:
    assert largest_error(kind, car, spacing, change) < target


@pytest.mark.parametrize(
    ("car", "kind", "window"),
    [("ordinary", "weave", 3.0), ("paper", "weave", -5.0), ("paper", "bend", 3.0)],
)
@pytest.mark.parametrize(("noise", "target"), [("noise 0.02", 0.15), ("noise 0.05", 0.30)])
def test_window_with_new_noise_each_tick_is_followed(
    noise: str, target: float, window: float, kind: str, car: str
) -> None:
    """Without a continuation backwards, the car loses a bend whose window begins 3 m ahead."""
    assert largest_error(kind, car, 1.0, noise, window=window) < target


@pytest.mark.parametrize(
    ("kind", "spacing", "noise", "target"),
    [("weave", 5.0, 0.02, 0.15), ("bend", 3.0, 0.02, 0.15), ("straight", 1.0, 0.5, 0.5)],
)
def test_stated_noise_is_followed(kind: str, spacing: float, noise: float, target: float) -> None:
    change = f"noise {noise:g}"
    assert largest_error(kind, "ordinary", spacing, change, path_noise=noise) < target


def test_noise_stated_as_zero_is_not_smoothed() -> None:
    change = "noise 0.02"
    rough = largest_error("straight", "ordinary", 0.25, change, path_noise=0.0)
    assert rough > 2.0 * largest_error("straight", "ordinary", 0.25, change)
