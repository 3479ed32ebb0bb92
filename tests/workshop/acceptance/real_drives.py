"""One drive on published points, with its error against the true road."""

import csv
import math
import tempfile
from collections.abc import Callable
from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.metrics import LOST, reversals, rms
from ampc_msgs_config.paths.path import Progress, errors_at
from ampc_msgs_config.paths.path_file import SpeedLimits, from_csv, limited
from ampc_msgs_config.scenarios.scenario import (
    MIN_PREVIEW,
    SPEED_PREVIEW,
    SpeedProfile,
    speed_at,
)
from ampc_msgs_config.types import NANOSECONDS, Array
from ampc_ros.configuration import Choices, configuration
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.car import Car
from sim_vehicle.parameters import load_vehicle_file
from tests.workshop.acceptance.real_roads import Road

LATERAL, LONGITUDINAL = 4.0, 2.0
"""Largest lateral acceleration of a drive, and acceleration and deceleration [m/s^2]."""
PERIOD = 0.1
"""Time between two ticks [s]."""
CALM = np.zeros((20, 2))
"""Wind of one tick: none [m/s]."""
SUDDEN, SLOW = 1e-3, 2.0
"""A car starts with straight wheels: on a curvature above SUDDEN [1/m] at the speed SLOW [m/s]."""
STANDS = 0.05
"""Speed below which a car stands [m/s]."""


class Setup(NamedTuple):
    """Car and speed of a drive."""

    car: str
    speed: float
    """Largest speed; bends lower it [m/s]."""
    guard: str = "road"

    def __str__(self) -> str:
        """Return the name in tables."""
        return f"{self.car} car, {self.speed:g} m/s, guard {self.guard}"


Publisher = Callable[[int, float, Supervisor], Array | None]
"""Function from tick, arc length [m] and supervisor to the points sent at this tick, or None."""


class RoadDrive(NamedTuple):
    """A finished drive."""

    s: Array
    """Arc length of the centre of gravity on the true road (n,) [m]."""
    error: Array
    """Its cross-track error against the true road (n,) [m]."""
    steering: Array
    """Commanded angle (n,) [rad]."""
    unsolved: int
    """Number of QPs that were not solved."""
    rejected: int
    """Number of rejected paths."""
    stands: bool
    """Whether the car stands at the end because of a stop request."""

    @property
    def max(self) -> float:
        """Largest error; infinite where no path was accepted [m]."""
        return float(np.abs(self.error).max(initial=0.0)) if len(self.error) else math.inf

    @property
    def rms(self) -> float:
        """RMS error; infinite where no path was accepted [m]."""
        return rms(self.error) if len(self.error) else math.inf

    @property
    def reversals(self) -> int:
        """Number of steering reversals."""
        return reversals(self.steering)

    def position(self, s: float) -> float:
        """Return the distance of the centre of gravity beyond arc length `s` at the end [m]."""
        return float(self.s[-1] - s) if len(self.s) else math.inf


def drive(
    road: Road,
    setup: Setup,
    publish: Publisher,
    end: float,
    seconds: float,
    *,
    static_path: bool = True,
    brakes: bool = False,
) -> RoadDrive:
    """Drive along a road until arc length `end`, the time is over, or the car stands or is lost.

    Args:
        road: True road, on which the car starts and whose bends limit its speed.
        setup: Car, speed and guard.
        publish: Publisher of the path.
        end: Arc length at which the drive ends [m].
        seconds: Longest duration [s].
        static_path: Whether a path stays valid until the next one.
        brakes: Whether the driver obeys the stop request; otherwise it is ignored.
    """
    config = configuration(
        Choices("preview", setup.car, guard=setup.guard, static_path=static_path)
    )
    path, supervisor = road.path, Supervisor(config)
    profile = speed_profile(road, setup.speed)
    start = float(profile.speed[0]) if abs(path.curvature[0]) < SUDDEN else SLOW
    car = Car(load_vehicle_file(find("vehicles", setup.car)), road.start, start)
    progress, target, rejected, unsolved = Progress(path), start, 0, 0
    rows: list[tuple[float, float, float]] = []
    stands = False
    for tick in range(round(seconds / PERIOD)):
        # Error of the centre of gravity against the true road.
        now = NANOSECONDS + tick * NANOSECONDS // 10
        state = as_received(car.measure(now))
        centre = at_distance(state, config.base_link_to_cg)
        s = progress.advance(centre.x, centre.y, centre.yaw)
        error = errors_at(path, s, centre.x, centre.y, centre.yaw)[0]
        stands = brakes and supervisor.stop_requested and state.v_x < STANDS
        if s > end or stands:
            break

        # Path and state to the controller.
        points = publish(tick, s, supervisor)
        if points is not None:
            try:
                supervisor.take_path(points, now, now)
            except ValueError:
                rejected += 1
        supervisor.take_state(state, now)
        record = supervisor.tick(now)
        if record is None:
            break
        rows.append((s, error, record.command.steering))
        unsolved += record.command.diagnosis.converged == 0
        if abs(error) > LOST:
            break

        # The driver reads the profile ahead, and brakes if a stop is requested.
        if brakes and supervisor.stop_requested:
            target = max(target - LONGITUDINAL * PERIOD, 0.0)
        else:
            ahead = max(SPEED_PREVIEW * speed_at(profile, s), MIN_PREVIEW)
            most = start + LONGITUDINAL * PERIOD * tick if start == SLOW else math.inf
            target = min(speed_at(profile, s + ahead), most)
        car.advance(record.command.steering, target, CALM)
    along, errors, steering = np.array(rows).reshape(-1, 3).T
    return RoadDrive(along, errors, steering, unsolved, rejected, stands)


def speed_profile(road: Road, speed: float) -> SpeedProfile:
    """Return the highest speed along a road within the limits."""
    path = road.path
    limits = SpeedLimits(LATERAL, LONGITUDINAL, speed)
    speeds = limited(np.full(len(path.x), speed), path, limits)
    at: Array = path.spacing * np.arange(len(speeds), dtype=np.float64)
    return SpeedProfile(True, at, speeds, path.length if path.closed else math.inf)


def step_excess(driven: RoadDrive, clean: RoadDrive, reach: float) -> float:
    """Return the largest steering step beyond what the road asks [rad].

    The road asks for the largest step of the clean drive within `reach` [m] of the same place.
    """
    if len(driven.steering) < 2:
        return math.inf
    asked = np.abs(np.diff(clean.steering))
    place = clean.s[1:]
    first = np.searchsorted(place, driven.s[1:] - reach)
    last = np.searchsorted(place, driven.s[1:] + reach)
    steps = np.abs(np.diff(driven.steering))
    most = [asked[i:j].max(initial=0.0) for i, j in zip(first, last, strict=True)]
    return float((steps - most).max())


def lap_time(points: Array, speed: float) -> float:
    """Return the duration that the planner plans for a file of points [s].

    Infinite where the planner rejects the file.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = File(folder) / "road.csv"
        with file.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(("x_m", "y_m"))
            writer.writerows(points.tolist())
        try:
            return from_csv(file, None, SpeedLimits(LATERAL, LONGITUDINAL, speed)).duration
        except ValueError:
            return math.inf
