"""Progress along the reference path, which survives a new path and a restart of the controller.

A controller projects the car onto its path in a window about the last projection. On a new path
object it would have to search the whole path, where the nearest branch may be the wrong one: roads
cross themselves, laps run side by side. The supervisor therefore owns the progress, and hands each
path to the controllers with its `entry`, the sample at which the car joins it.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from ampc_msgs_config.paths.path import NOT_CAUGHT, Path, Progress, errors_at
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.supervision.path_fusion import MAX_BLENDED, extended, fused, samples_at

GATE = 5.0
"""A branch is a candidate if it is at most this much farther away than the nearest one [m]."""
SEPARATION = 2.0
"""Least arc length between two candidates [m]."""
BEHIND, AHEAD, STEP = 20.0, 30.0, 1.0
"""Range and step of the comparison of two branches, from the car [m]."""
ALONG_WEIGHT = 0.3
"""Weight of an offset along the path: the arc lengths of noisy paths differ."""
SIMILAR = 0.3
"""Branches whose differences from the driven one differ by less are equally good [m]."""
BLEND_TIME = 0.5
"""Time constant with which a small shift of a new path reaches the controllers [s]."""
SAME_END = 1.0
"""Distance within which two ends of paths are the same place [m]."""


class Location(NamedTuple):
    """Position of the car relative to its path."""

    path: Path
    """Path with its entry, for the controllers."""
    s: float
    """Arc length of the centre of gravity [m]."""
    cross_track_error: float
    """Signed distance from the path, positive to its left [m]."""
    step: float
    """Change of that distance by a new path at this instant [m]."""
    blended: float = 0.0
    """Part of that distance, due to shifts of new paths, that controllers do not see yet [m]."""

    def seen(self, car: VehicleState) -> VehicleState:
        """Return the state with the cross-track error that controllers see."""
        if not self.blended:
            return car
        dx, dy = math.sin(car.yaw) * self.blended, -math.cos(car.yaw) * self.blended
        return car._replace(x=car.x + dx, y=car.y + dy)


def no_check(path: Path) -> None:
    """Accept every path."""


class PathProgress:
    """Owner of the progress along the path in use."""

    def __init__(self) -> None:
        """Start without a path."""
        self.forget()

    def forget(self) -> None:
        """Forget path and progress: the next path is searched as a first one."""
        self.source: Path | None = None
        self.tracker: Progress | None = None
        self.blended = 0.0
        self.stamp_ns = self.path_ns = 0

    def relocate(self, car: VehicleState) -> None:
        """Continue after a jump of the position, on the nearest branch that is next in progress."""
        self.blended = 0.0
        if self.tracker is None or self.tracker.index == NOT_CAUGHT:
            return
        path = self.tracker.path
        lap = len(path.x) - 1
        places = candidates(path, car)
        apart = places - self.tracker.index
        if path.closed:
            apart = (apart + lap // 2) % lap - lap // 2
        self.tracker.index = int(self.tracker.index + apart[np.argmin(np.abs(apart))])

    def locate(
        self,
        car: VehicleState,
        source: Path,
        check: Callable[[Path], None] = no_check,
        *,
        renew: bool,
    ) -> Location:
        """Project the car onto the path; on a new path, continue on the branch that it drives.

        Args:
            car: State of the centre of gravity.
            source: Path as it was received; the controller can follow it.
            check: Raises a ValueError where the controller cannot follow a path.
            renew: Whether the controller has no memory of its place on the path.
        """
        before = None
        if self.tracker is None or self.source is None:
            self.tracker = Progress(source)
            s = self.tracker.advance(car.x, car.y, car.yaw)
            if s < 0.0 and not source.closed:
                self.follow(extended(source, s), source, check)
            self.path_ns = car.stamp_ns
        elif source is not self.source:
            s, before = advance_errors(self.tracker, car)
            plain = source._replace(entry=continued(self.tracker.path, s, source, car))
            elapsed = max(car.stamp_ns - self.path_ns, 0) / NANOSECONDS
            s_new = Progress(plain).advance(car.x, car.y, car.yaw)
            self.follow(fused(self.tracker.path, s, source, s_new, elapsed), plain, check)
            self.path_ns = car.stamp_ns
        elif renew:
            s, _ = advance_errors(self.tracker, car)
            plain = source._replace(entry=continued(self.tracker.path, s, source, car))
            self.follow(self.tracker.path._replace(entry=self.tracker.index), plain, check)
        self.source = source
        s, error = advance_errors(self.tracker, car)
        step = 0.0 if before is None else error - before
        self.blend(step, car.stamp_ns)
        return Location(self.tracker.path, s, error, step, self.blended)

    def follow(self, path: Path, plain: Path, check: Callable[[Path], None]) -> None:
        """Follow an averaged or continued path, or the plain one where the controller cannot."""
        try:
            check(path)
        except ValueError:
            path = plain
        self.tracker = Progress(path)

    def blend(self, step: float, stamp_ns: int) -> None:
        """Let the shift of a new path reach the controllers gradually, unless it is large.

        A planner that sends its path again, each time with other errors of localisation, would
        otherwise make the controllers steer after each of them.

        Args:
            step: Change of the cross-track error by a new path [m].
            stamp_ns: Time of the state [ns].
        """
        elapsed = max(stamp_ns - self.stamp_ns, 0) / NANOSECONDS
        self.stamp_ns = stamp_ns
        self.blended = self.blended * math.exp(-elapsed / BLEND_TIME) + step
        if abs(self.blended) > MAX_BLENDED:
            self.blended = 0.0


def advance_errors(tracker: Progress, car: VehicleState) -> tuple[float, float]:
    """Return arc length and cross-track error of a state [m]; store the progress."""
    s = tracker.advance(car.x, car.y, car.yaw)
    return s, errors_at(tracker.path, s, car.x, car.y, car.yaw)[0]


def candidates(path: Path, car: VehicleState) -> NDArray[np.int64]:
    """Return the samples nearest to the car on each branch near it, in the car's direction.

    Branches that lead the other way are ignored unless all do.
    """
    last = len(path.x) - 1 if path.closed else len(path.x)
    distance = np.hypot(path.x[:last] - car.x, path.y[:last] - car.y)
    away = np.cos(path.heading[:last] - car.yaw) < 0
    if not away.all():
        distance[away] = math.inf
    reach = max(round(SEPARATION / path.spacing), 1)
    least = minimum_filter1d(distance, 2 * reach + 1, mode="wrap" if path.closed else "nearest")
    near = (distance == least) & (distance <= distance.min() + GATE)
    return np.flatnonzero(near).astype(np.int64)


def continued(old: Path, s: float, new: Path, car: VehicleState) -> int:
    """Return the sample at which the car joins a new path: on the branch that it drives.

    The branches near the car are compared with the path driven so far, behind and ahead. Among
    equally good ones, such as laps on one line, the progress decides; without a common end of both
    paths the first one wins.

    Args:
        old: Path driven so far.
        s: Arc length of the car on it [m].
        new: New path.
        car: State of the centre of gravity.
    """
    places = candidates(new, car)
    if len(places) == 1:
        return int(places[0])
    arc = np.multiply(places, new.spacing, dtype=np.float64)
    difference = branch_differences(old, s, new, arc)
    similar = places[difference <= difference.min() + SIMILAR]
    expected = expected_progress(old, s, new)
    if expected is None:
        return int(similar[0])
    return int(similar[np.argmin(np.abs(similar * new.spacing - expected))])


def branch_differences(old: Path, s: float, new: Path, places: Array) -> Array:
    """Return the RMS distance of branches of a new path from the driven path (n,) [m].

    Args:
        old: Path driven so far.
        s: Arc length of the car on it [m].
        new: New path.
        places: Arc lengths of the branches (n,) [m].
    """
    offsets = np.arange(-BEHIND, AHEAD + STEP / 2, STEP, dtype=np.float64)
    driven, branch = samples_at(old, s + offsets), samples_at(new, places[:, None] + offsets)
    dx, dy = branch.x - driven.x, branch.y - driven.y
    cos, sin = np.cos(driven.heading), np.sin(driven.heading)
    across, along = dy * cos - dx * sin, dx * cos + dy * sin
    compared = driven.exists & branch.exists
    squares = np.where(compared, across**2 + (ALONG_WEIGHT * along) ** 2, 0.0)
    count = compared.sum(axis=1)
    return np.asarray(np.sqrt(squares.sum(axis=1) / np.maximum(count, 1)) + GATE * (count == 0))


def expected_progress(old: Path, s: float, new: Path) -> float | None:
    """Return the arc length on a new path that shares an end with the old one; None: no end."""
    if old.closed:
        s %= old.length
    if distance(old, -1, new, -1) <= SAME_END:
        return new.length - (old.length - s)
    return s if distance(old, 0, new, 0) <= SAME_END else None


def distance(a: Path, i: int, b: Path, k: int) -> float:
    """Return the distance between a sample of one path and a sample of another [m]."""
    return math.hypot(a.x[i] - b.x[k], a.y[i] - b.y[k])
