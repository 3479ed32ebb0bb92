"""Recorded drive as arrays, and the segments of it that a linear-tyre model can explain."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter1d
from scipy.signal import savgol_filter

from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.types import Array

GRID_STEP = 0.01
"""Step of the simulation [s]."""
SMOOTHING = 0.2
"""Standard deviation of the Gaussian that smooths the signals which select rows [s]."""
FIT = 0.8
"""Window in which the speed is a cubic polynomial. A Gaussian would change it by 1 % where the car
begins to accelerate, and with it the curvature of tight bends [s]."""
LEAST_SPEED = 0.7
"""Speed above which rows are used [m/s]."""
LARGEST_LATERAL = 4.0
"""Lateral acceleration above which tyres are not linear enough [m/s^2]."""
HARDEST_BRAKING = 2.5
"""Deceleration above which the brakes change the lateral forces too much [m/s^2]."""
TIME_AROUND = 0.3
"""Time around unusable rows that is left out, too [s]."""
SHORTEST_SEGMENT = 3.0
"""Duration of the shortest segment that is used [s]."""
WASHOUT = 1.0
"""Time from the begin of a segment until its rows are compared [s]."""
LONGEST_GAP = 0.35
"""Longest time between two states, or between a state and the last command before it [s]."""
Mask = NDArray[np.bool_]
RowIndices = NDArray[np.int64]


class RecordedDrive(NamedTuple):
    """Measured drive; times on one clock, angles to the left positive."""

    time: Array
    """(n,) stamps of the states, increasing [s]."""
    x: Array
    """(n,) position of the measured point in a fixed frame [m]."""
    y: Array
    """(n,) [m]"""
    yaw: Array
    """(n,) heading [rad]."""
    v_x: Array
    """(n,) longitudinal velocity [m/s]."""
    v_y: Array
    """(n,) lateral velocity of the measured point [m/s]."""
    yaw_rate: Array
    """(n,) [rad/s]"""
    command_time: Array
    """(m,) stamps of the commands, not decreasing [s]; a command holds until the next."""
    command: Array
    """(m,) commanded steering in units of its topic."""
    steering_time: Array
    """(k,) stamps of the measured steering [s]; empty: not measured."""
    steering: Array
    """(k,) measured steering in the units of the command."""
    age: Array
    """(n,) arrival minus stamp of the states [s]; empty: not known."""


def recording_of(states: Array, command: Array, steering: Array, age: Array) -> RecordedDrive:
    """Return a recording of tables.

    Args:
        states: (n, 7) time and state of the odometry; see RecordedDrive.
        command: (m, 2) time and command.
        steering: (k, 2) time and measured steering.
        age: (n,) arrival minus stamp [s]; empty: not known.
    """
    t, x, y, yaw, v_x, v_y, r = np.ascontiguousarray(states.T)  # one type for compiled code
    sent, commanded = np.ascontiguousarray(command.T)
    seen, angle = np.ascontiguousarray(steering.T)
    return RecordedDrive(t, x, y, yaw, v_x, v_y, r, sent, commanded, seen, angle, age)


class Segment(NamedTuple):
    """Contiguous part of a drive on a regular grid."""

    grid: Array
    """(g,) times [s]."""
    speed: Array
    """(g,) speed without noise [m/s]."""
    acceleration: Array
    """(g,) its derivative [m/s^2]."""
    restart: Array
    """(g,) yaw rate at the begin [rad/s], nan elsewhere."""
    rows: RowIndices
    """States that are compared with the model."""
    steering_rows: RowIndices
    """Measurements of the steering that are compared with the model."""


def usable_rows(recording: RecordedDrive, friction: float) -> tuple[Mask, dict[str, float]]:
    """Return the rows that the model can explain, and the shares of those left out by reason.

    Args:
        recording: The drive.
        friction: Friction of the road, mu.
    """
    t = recording.time
    interval = float(np.median(np.diff(t)))
    width = max(SMOOTHING / interval, 1.0)
    speed = gaussian_filter1d(recording.v_x, width)
    braking = -np.gradient(speed, np.arange(len(t)) * interval)
    lateral = np.abs(gaussian_filter1d(recording.yaw_rate, width) * speed)
    last = np.searchsorted(recording.command_time, t, side="right") - 1
    silence = t - recording.command_time[np.maximum(last, 0)]
    finite = np.isfinite(np.column_stack(recording[:7])).all(axis=1)
    reasons: dict[str, Mask] = {
        "slow, at a standstill or in reverse": ~(speed > LEAST_SPEED),
        "lateral acceleration": lateral > min(LARGEST_LATERAL, 0.5 * friction * GRAVITY),
        "braking": braking > HARDEST_BRAKING,
        "no command": np.asarray((last < 0) | (silence > LONGEST_GAP)),
        "not finite": np.asarray(~finite),
    }
    left_out: Mask = np.zeros(len(t), dtype=bool)
    shares = {}
    for reason, rows in reasons.items():
        shares[reason] = float(np.mean(rows & ~left_out))
        left_out |= rows
    margin = round(TIME_AROUND / interval)
    if margin and left_out.any():
        left_out = binary_dilation(left_out, iterations=margin)
    return ~left_out, {reason: share for reason, share in shares.items() if share > 0}


def segments_of(
    recording: RecordedDrive, friction: float
) -> tuple[list[Segment], dict[str, float]]:
    """Return the usable segments, and the shares of the rows left out by reason.

    A segment ends where rows are unusable, and where stamps jump.
    """
    usable, shares = usable_rows(recording, friction)
    t = recording.time
    jumps = np.diff(t, prepend=t[0]) > LONGEST_GAP
    number = np.cumsum(jumps | (np.diff(usable, prepend=usable[0])))
    segments = []
    for k in np.unique(number[usable]):
        rows = np.flatnonzero(usable & (number == k))
        if t[rows[-1]] - t[rows[0]] >= SHORTEST_SEGMENT:
            segments.append(make_segment(recording, rows))
    used = sum(len(segment.rows) for segment in segments)
    if rest := float(np.mean(usable)) - used / len(t):
        shares["begin of a segment, or too short"] = max(rest, 0.0)
    return segments, shares


def make_segment(recording: RecordedDrive, rows: RowIndices) -> Segment:
    """Return the segment of contiguous rows."""
    t = recording.time[rows]
    grid = np.arange(t[0], t[-1] + GRID_STEP, GRID_STEP)
    measured, window = np.interp(grid, t, recording.v_x[rows]), round(FIT / GRID_STEP) | 1
    restart = np.full(len(grid), np.nan)
    restart[0] = float(np.mean(recording.yaw_rate[rows[:5]]))
    begin = t[0] + WASHOUT
    s = recording.steering_time
    return Segment(
        grid,
        np.asarray(savgol_filter(measured, window, 3), dtype=np.float64),
        np.asarray(savgol_filter(measured, window, 3, deriv=1, delta=GRID_STEP), dtype=np.float64),
        restart,
        rows[t >= begin],
        np.flatnonzero((s >= begin) & (s <= t[-1])),
    )
