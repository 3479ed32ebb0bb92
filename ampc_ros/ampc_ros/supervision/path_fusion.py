"""Fusion of a new path with the one driven so far.

A planner that sends a window of the road at each tick sends other errors with each of them, and may
begin ahead of the car. Where the new path agrees with the driven one, both are averaged; where it
begins ahead of the car, the driven one continues it backwards.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.paths.path import Path, project_near
from ampc_msgs_config.types import Array

FUSION_TIME = 0.8
"""Time constant of the average of successive paths [s]."""
MAX_BLENDED = 0.3
"""Distance of two paths near the car from which the new one replaces the old one at once [m]."""
AGREEMENT_BEHIND, AGREEMENT_AHEAD = 5.0, 30.0
"""Range in which two paths are compared, from the car [m]."""
REACH, FADE = 60.0, 20.0
"""Range of the average from the car, and distance over which it fades to the new path [m]."""
RUN_IN = 20.0
"""Distance behind the car from which an open path exists [m]."""
MAX_LEAD = 20.0
"""Longest distance from the car to the start of a path that is continued backwards [m]."""
START = 5.0
"""Length of the beginning of a path whose curvature continues it backwards [m]."""


class Samples(NamedTuple):
    """Samples of a path at given arc lengths."""

    x: Array
    """Positions [m]."""
    y: Array
    """Positions [m]."""
    heading: Array
    """Tangent directions [rad]."""
    curvature: Array
    """Curvatures [1/m]."""
    exists: NDArray[np.bool_]
    """Whether the arc length lies on the path."""


def samples_at(path: Path, s: Array) -> Samples:
    """Interpolate a path linearly at arc lengths of any shape [m]; headings may differ by turns."""
    last = len(path.x) - 1
    at = s / path.spacing
    exists = np.ones(at.shape, bool) if path.closed else (at >= 0.0) & (at <= last)
    at = at % last if path.closed else np.clip(at, 0.0, last)
    i = np.minimum(at.astype(np.int64), last - 1)
    t = at - i
    x, y, heading, curvature = (
        each[i] + t * (each[i + 1] - each[i])
        for each in (path.x, path.y, path.heading, path.curvature)
    )
    return Samples(x, y, heading, curvature, exists)


def fused(old: Path, s_old: float, new: Path, s_new: float, elapsed: float) -> Path:
    """Return the average of a new path and the one driven so far, joined at the car.

    Args:
        old: Path driven so far.
        s_old: Arc length of the car on it [m].
        new: New path.
        s_new: Arc length of the car on that; negative before its start [m].
        elapsed: Time since the old path came [s].
    """
    here = min(max(round(s_new / new.spacing), 0), len(new.x) - 1)
    near = round((s_old + here * new.spacing - s_new) / old.spacing)
    if not old.closed:
        near = min(max(near, 0), len(old.x) - 1)
    origin = project_near(old, near, new.x[here], new.y[here]) - here * new.spacing
    reach = round(REACH / new.spacing)
    if new.closed:  # no place of a lap is averaged twice
        reach = min(reach, (len(new.x) - 1) // 2)
    first, stop = here - reach, here + reach
    if not new.closed:
        first, stop = max(first, 0), min(stop, len(new.x))
    count = np.arange(first, stop, dtype=np.int64)
    driven = samples_at(old, np.add(origin, new.spacing * count, dtype=float))
    path = average(new, count, here, driven, math.exp(-elapsed / FUSION_TIME))
    return extended(path, s_new, old, origin)


def average(new: Path, count: NDArray[np.int64], here: int, old: Samples, share: float) -> Path:
    """Return a new path of which a part is averaged with the driven one.

    Args:
        new: New path.
        count: Samples of the new path in that part (n,); on a lap the count continues.
        here: Sample at the car.
        old: Driven path at these samples (n,).
        share: Weight of the driven path.
    """
    i = count % (len(new.x) - 1) if new.closed else count
    heading = new.heading[i]
    across = (old.y - new.y[i]) * np.cos(heading) - (old.x - new.x[i]) * np.sin(heading)
    along = new.spacing * (count - here)
    compared = old.exists & (along >= -AGREEMENT_BEHIND) & (along <= AGREEMENT_AHEAD)
    if not compared.any() or np.abs(across[compared]).max() > MAX_BLENDED:
        return new
    ends = np.flatnonzero(old.exists)[[0, -1]]
    inside = np.minimum(along - along[ends[0]], along[ends[1]] - along)
    if count[ends[0]] == 0 and not new.closed:
        inside = along[ends[1]] - along  # the driven path continues it backwards
    t = np.clip(inside / FADE, 0.0, 1.0)
    weight = share * t * t * (3.0 - 2.0 * t) * old.exists
    shift = weight * across
    x, y, headings, curvature = (np.array(each) for each in new[1:5])
    x[i] -= shift * np.sin(heading)
    y[i] += shift * np.cos(heading)
    headings[i] += np.gradient(shift, new.spacing)
    curvature[i] += weight * (old.curvature - curvature[i])
    if new.closed:
        for each in (x, y, curvature):
            each[-1] = each[0]
        headings[-1] = headings[0] + new.heading[-1] - new.heading[0]
    return new._replace(x=x, y=y, heading=headings, curvature=curvature)


def extended(path: Path, s: float, old: Path | None = None, origin: float = 0.0) -> Path:
    """Return an open path that exists from `RUN_IN` behind the car, with the car's sample as entry.

    Args:
        path: Path of the car.
        s: Arc length of the car [m].
        old: Path driven so far, whose curvature is used where it exists; elsewhere that of the
            beginning of the path.
        origin: Arc length of its place at the start of the path [m].
    """
    if path.closed:
        return path._replace(entry=round(s / path.spacing))
    if s < -MAX_LEAD:  # the path is elsewhere
        return path._replace(entry=0)
    missing = max(math.ceil((RUN_IN - s) / path.spacing), 0)
    entry = min(round(s / path.spacing), len(path.x) - 1) + missing
    if not missing:
        return path._replace(entry=entry)
    first = max(min(round(START / path.spacing), len(path.x) - 1), 1)
    bend = (path.heading[first] - path.heading[0]) / (first * path.spacing)
    curvature: Array = np.full(missing, bend)
    if old is not None:
        offsets: Array = path.spacing * np.arange(missing, 0, -1, dtype=np.float64)
        behind = samples_at(old, origin - offsets)
        curvature = np.asarray(np.where(behind.exists, behind.curvature, bend))
    after = np.append(curvature[1:], path.curvature[0])
    steps = path.spacing * (curvature + after) / 2
    heading = path.heading[0] - np.cumsum(steps[::-1])[::-1]
    middle = heading + steps / 2
    x = path.x[0] - path.spacing * np.cumsum(np.cos(middle)[::-1])[::-1]
    y = path.y[0] - path.spacing * np.cumsum(np.sin(middle)[::-1])[::-1]
    return path._replace(
        x=np.concatenate((x, path.x)),
        y=np.concatenate((y, path.y)),
        heading=np.concatenate((heading, path.heading)),
        curvature=np.concatenate((curvature, path.curvature)),
        entry=entry,
    )
