"""Manoeuvre from which a car is identified: bends to both sides at several speeds, with slaloms."""

import math
from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.paths.curves import q
from ampc_msgs_config.types import Array

FULL_SIZE = 2.7
"""Wheelbase from which on the manoeuvre has its full size [m]; a shorter car drives a smaller one,
with speeds that give the same lateral acceleration."""
TIME_STEP = 0.005
"""Step of the integration along the time [s]."""
RAMP = 2.0
"""Time over which one part changes into the next [s]."""
SPEED_CHANGE = 1.0
"""Mean acceleration from part to part, at full size [m/s^2]."""
SHARE_OF_ANGLE = 0.85
"""Share of the largest steering angle that the tightest bend may need."""
LEAST_SIZE = 0.2
"""Size for the smallest cars; smaller, its bends would be shorter than the look-ahead of a
controller that is stable with 0.4 s of delay and lag."""
TURN_RATE = 0.45
"""Largest yaw rate of the bends, for the same reason [rad/s]."""
POINT_DISTANCE = 0.4
"""Distance of the points at full size [m]."""


class ManoeuvrePart(NamedTuple):
    """Bend with a slalom on top of it."""

    duration: float
    """[s]"""
    speed: float
    """At full size [m/s]."""
    bend: float
    """Lateral acceleration of the bend, positive to the left [m/s^2]."""
    slalom: float
    """Amplitude of the lateral acceleration of the slalom [m/s^2]."""
    slow: float
    """Frequency of the slalom at the begin of the part [Hz]."""
    fast: float
    """At its end [Hz]."""


MANOEUVRE = (
    ManoeuvrePart(6.0, 3.3, 0.0, 1.0, 0.45, 0.55),
    ManoeuvrePart(6.2, 4.2, 1.65, 0.2, 0.4, 1.2),
    ManoeuvrePart(15.6, 9.3, 2.35, 0.25, 0.3, 1.5),
    ManoeuvrePart(10.0, 4.2, 1.7, 0.2, 0.4, 1.2),
    ManoeuvrePart(6.8, 4.6, -1.0, 0.2, 0.4, 1.2),
    ManoeuvrePart(15.5, 9.3, -2.35, 0.25, 0.3, 1.5),
)
"""60 s. Durations and bends were found by a search for the smallest square. The first part has a
steering rate of 0.8 rad/s at full size."""
HEADING = 0.349
"""Heading at the begin for which the square is smallest [rad]."""


def identification_points(wheelbase: float, max_angle: float) -> Array:
    """Return the points of the manoeuvre (n, 3): x [m], y [m], speed [m/s].

    It fits into 80 x 80 m for cars whose largest angle allows its bends, and starts inside.

    Args:
        wheelbase: [m].
        max_angle: Largest road-wheel angle [rad].
    """
    time, speed, bend, slalom = programme()
    # Size: that of the car, but no bend tighter than the car can drive
    tightest = float(np.max(np.abs(bend + slalom) / speed**2))
    least = tightest * wheelbase / math.tan(SHARE_OF_ANGLE * max_angle)
    size = max(min(wheelbase / FULL_SIZE, 1.0), LEAST_SIZE, least)
    # Integrate the heading, then the position
    speed = math.sqrt(size) * speed
    turn = np.clip(bend / speed, -TURN_RATE, TURN_RATE) + slalom / speed
    heading = HEADING + np.cumsum(turn) * TIME_STEP
    x, y = (np.cumsum(speed * f(heading)) * TIME_STEP for f in (np.cos, np.sin))
    way = np.cumsum(speed) * TIME_STEP
    at = np.interp(np.arange(way[0], way[-1], POINT_DISTANCE * size), way, time)
    return np.column_stack(
        [np.interp(at, time, each) for each in (x - x.min(), y - y.min(), speed)]
    )


def programme() -> tuple[Array, Array, Array, Array]:
    """Return time [s], speed [m/s], lateral acceleration of bends, of slalom [m/s^2], (n,) each.

    They hold for the full size.
    """
    duration = sum(part.duration for part in MANOEUVRE)
    time: Array = np.arange(0.0, duration, TIME_STEP, dtype=np.float64)
    values: list[Array] = [np.full(len(time), value) for value in MANOEUVRE[0][1:5]]
    speed, bend, slalom, frequency = values
    begin, before = 0.0, MANOEUVRE[0]
    for part in MANOEUVRE:
        rise = np.asarray(q((time - begin) / RAMP + 0.5))
        change = abs(part.speed - before.speed) / SPEED_CHANGE + 0.8
        speed += (part.speed - before.speed) * q((time - begin) / change + 0.5)
        bend += (part.bend - before.bend) * rise
        slalom += (part.slalom - before.slalom) * rise
        inside = (time >= begin) & (time < begin + part.duration)
        share = (time[inside] - begin) / part.duration
        frequency[inside] = part.slow + (part.fast - part.slow) * share
        begin, before = begin + part.duration, part
    phase = math.tau * np.cumsum(frequency) * TIME_STEP
    return time, speed, bend, np.asarray(slalom * np.sin(phase))


def write_manoeuvre(file: File, wheelbase: float, max_angle: float) -> None:
    """Write the manoeuvre as a path file with the columns x_m,y_m,v_mps.

    Raises:
        OSError: The file cannot be written.
    """
    rows = identification_points(wheelbase, max_angle)
    np.savetxt(file, rows, "%.4f", ",", header="x_m,y_m,v_mps", comments="")
