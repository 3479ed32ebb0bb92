"""Reference paths: heading, curvature, projection of the car, progress along the path."""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.types import Array, VehicleState

FIRST_CATCH = 3.0
"""Where a path passes twice, its first part wins that is at most this much farther away [m]."""
BEHIND, AHEAD = 5.0, 20.0
"""Window of the next projection, from the last one [m]."""
MAX_PROJECTION_DISTANCE = 25.0
"""Distance from the path beyond which the whole path is searched again [m]."""
NOT_CAUGHT = -(2**62)
"""Index before the first projection; -1 is a valid index behind the start of a closed path."""

STAND_OFF = 1.5
"""Distance of the stand from the end of the path: `odom` describes the rear axle, and the centre of
gravity, which is projected onto the path, lies ahead of it [m]."""
END_DECELERATION = 1.5
"""Deceleration at the end of an open path, below that of a stop request [m/s^2]."""


class Path(NamedTuple):
    """Smooth curve, sampled at equal steps of arc length; argument of compiled code."""

    spacing: float
    """Arc length between samples [m]."""
    x: Array
    """(n,) positions [m]."""
    y: Array
    """(n,) positions [m]."""
    heading: Array
    """(n,) tangent direction, continuous (not wrapped) [rad]."""
    curvature: Array
    """(n,) curvature, positive to the left [1/m]."""
    closed: bool
    """Whether the end joins the start; then the last sample equals the first one."""
    noise: float
    """Noise of the points from which the path was made: standard deviation [m]."""
    entry: int = NOT_CAUGHT
    """Sample at which a car that already drives joins this path; NOT_CAUGHT: the first projection
    decides."""

    @property
    def length(self) -> float:
        """Arc length of the whole path [m]."""
        return self.spacing * (len(self.x) - 1)


class PathPoint(NamedTuple):
    """Point of a path."""

    x: float
    y: float
    heading: float
    curvature: float


@compiled
def point_at(path: Path, s: float) -> PathPoint:
    """Return the point at arc length `s` [m]; an open path continues straight beyond its ends."""
    last = len(path.x) - 1
    turned = 0.0
    if path.closed:
        lap = math.floor(s / (last * path.spacing))
        s -= lap * last * path.spacing
        turned = lap * (path.heading[last] - path.heading[0])
    at = s / path.spacing
    i = min(max(int(at), 0), last - 1)
    t = min(max(at - i, 0.0), 1.0)
    heading = path.heading[i] + t * (path.heading[i + 1] - path.heading[i])
    beyond = s - min(max(s, 0.0), last * path.spacing)
    curvature = path.curvature[i] + t * (path.curvature[i + 1] - path.curvature[i])
    return PathPoint(
        path.x[i] + t * (path.x[i + 1] - path.x[i]) + beyond * math.cos(heading),
        path.y[i] + t * (path.y[i + 1] - path.y[i]) + beyond * math.sin(heading),
        heading + turned,
        curvature if beyond == 0.0 else 0.0,
    )


@compiled
def project(path: Path, x: float, y: float, start: int, stop: int) -> float:
    """Return the arc length of the point nearest to (x, y) among samples `start` .. `stop` - 1.

    On a closed path the count of samples continues over the laps, in both directions.

    Returns:
        Arc length [m]; beyond an end of an open path measured along the end's tangent.
    """
    last = len(path.x) - 1
    nearest, best = start, math.inf
    for i in range(start, stop):
        k = i % last if path.closed else i
        distance = (path.x[k] - x) ** 2 + (path.y[k] - y) ** 2
        if distance < best:
            nearest, best = i, distance
    k = nearest % last if path.closed else nearest
    cos, sin = math.cos(path.heading[k]), math.sin(path.heading[k])
    along = (x - path.x[k]) * cos + (y - path.y[k]) * sin
    across = (y - path.y[k]) * cos - (x - path.x[k]) * sin
    bend = max(1.0 - across * path.curvature[k], 0.5)
    ended = not path.closed and ((k == 0 and along < 0) or (k == last and along > 0))
    if not ended:
        along = min(max(along / bend, -path.spacing), path.spacing)
    return float(nearest * path.spacing + along)


@compiled
def cross_track_error(point: PathPoint, x: float, y: float) -> float:
    """Return the signed distance of (x, y) from a path point's tangent, positive: left [m]."""
    return (y - point.y) * math.cos(point.heading) - (x - point.x) * math.sin(point.heading)


@compiled
def curvature_between(path: Path, a: float, b: float) -> float:
    """Return the mean curvature from arc length a to b >= a [1/m]."""
    if b - a < path.spacing:
        return point_at(path, (a + b) / 2).curvature
    return (point_at(path, b).heading - point_at(path, a).heading) / (b - a)


@compiled
def errors_at(path: Path, s: float, x: float, y: float, yaw: float) -> tuple[float, float]:
    """Return cross-track error [m] and heading error [rad] of a pose at arc length s [m]."""
    point = point_at(path, s)
    return cross_track_error(point, x, y), wrap_angle(yaw - point.heading)


@compiled
def distance_ahead(path: Path, i: int, x: float, y: float, yaw: float) -> float:
    """Return the distance of sample i [m], infinite where the path leads away from `yaw`."""
    if math.cos(path.heading[i] - yaw) < 0:
        return math.inf
    return math.hypot(path.x[i] - x, path.y[i] - y)


@compiled
def smallest_distance(path: Path, x: float, y: float, yaw: float) -> float:
    """Return the least `distance_ahead` of all samples [m]."""
    smallest = math.inf
    for i in range(len(path.x)):
        smallest = min(smallest, distance_ahead(path, i, x, y, yaw))
    return smallest


@compiled
def first_catch(path: Path, x: float, y: float, yaw: float) -> int:
    """Return the nearest sample of the first part of the path that is near the car.

    Args:
        path: The path.
        x: Position [m].
        y: Position [m].
        yaw: Heading [rad]; parts in the opposite direction are ignored unless all are; nan: not
            available.
    """
    smallest = smallest_distance(path, x, y, yaw)
    if smallest == math.inf:
        yaw = math.nan
        smallest = smallest_distance(path, x, y, yaw)
    nearest, best = 0, math.inf
    for i in range(len(path.x)):
        distance = distance_ahead(path, i, x, y, yaw)
        if distance > smallest + FIRST_CATCH:
            if best < math.inf:
                break
        elif distance < best:
            nearest, best = i, distance
    return nearest


@compiled
def project_near(path: Path, index: int, x: float, y: float) -> float:
    """Return the arc length of the point nearest to (x, y) in the window about a sample [m]."""
    start = index - math.ceil(BEHIND / path.spacing)
    stop = index + math.ceil(AHEAD / path.spacing) + 1
    if not path.closed:
        start, stop = max(start, 0), min(stop, len(path.x))
    return project(path, x, y, start, stop)


@compiled
def advance(path: Path, index: int, x: float, y: float, yaw: float) -> tuple[float, int]:
    """Project a car onto a path; where the path crosses itself, progress decides.

    The whole path is searched once; later calls search a window of constant size.

    Args:
        path: The path.
        index: Index that the last call returned, or NOT_CAUGHT.
        x: Position [m].
        y: Position [m].
        yaw: Heading [rad]; the first projection is onto a part in the car's direction; nan: not
            available.

    Returns:
        Arc length [m], and the index of the nearest sample, whose count continues over the laps.
    """
    if index == NOT_CAUGHT:
        index = first_catch(path, x, y, yaw)
    s = project_near(path, index, x, y)
    point = point_at(path, s)
    if math.hypot(point.x - x, point.y - y) > MAX_PROJECTION_DISTANCE:
        index = first_catch(path, x, y, yaw)
        s = project_near(path, index, x, y)
    index = round(s / path.spacing)
    if not path.closed:
        index = min(max(index, 0), len(path.x) - 1)
    return s, index


class Progress:
    """Progress of a car along a path."""

    def __init__(self, path: Path) -> None:
        """Start on `path` at its entry, or at the first projection where it has none."""
        self.path = path
        self.index = path.entry

    def advance(self, x: float, y: float, yaw: float = math.nan) -> float:
        """Return the arc length of a car at (x, y) [m]; see `advance`."""
        s, self.index = advance(self.path, self.index, x, y, yaw)
        return s

    def errors(self, state: VehicleState) -> tuple[float, float]:
        """Return cross-track error [m] and heading error [rad] of a state; store the progress."""
        s = self.advance(state.x, state.y, state.yaw)
        return errors_at(self.path, s, state.x, state.y, state.yaw)
