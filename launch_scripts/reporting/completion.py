"""Whether a recorded drive reached its end, and why not: in one sentence."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ampc_msgs_config import topics
from ampc_msgs_config.metrics import LOST, DriveRecord, distance_driven
from ampc_msgs_config.paths.path import END_DECELERATION, STAND_OFF
from ampc_msgs_config.types import REASONS, Array
from launch_scripts.bags.bag_columns import BagColumns

SLOWEST_SECTION = 0.5
"""Speed that is assumed where a profile over the distance touches zero [m/s]..."""
STOP_LENGTH = 0.5
"""... over less than this length; where it stays zero, the drive ends [m]."""
MISSING_SHARE, MISSING_DISTANCE = 0.1, 5.0
"""A drive is complete if it lacks no more than this share of its distance, or this distance [m]. A
car that was stopped before its end may lack no more than the distance."""
STOPPED_BELOW = 0.5
"""Speed below which a car counts as stopped [m/s]."""


def incompleteness(columns: BagColumns, record: DriveRecord, errors: Array) -> str:
    """Return why a drive did not reach its end, in one sentence; empty: it did, or is unknown.

    Args:
        columns: Content of the bag, with the configuration of planner or simulator.
        record: Quantities at the ticks.
        errors: Cross-track [m] and heading error [rad] at the ticks (n, 2); nan without a path.
    """
    driven, planned = distance_driven(record.time, record.speed), planned_distance(columns)
    cause = stop_cause(columns, record)
    known = errors[np.isfinite(errors[:, 0]), 0]
    of_all = f" of {planned:.0f} m" if planned is not None else ""
    if len(known) and abs(known[-1]) > LOST:
        return f"the car is {abs(known[-1]):.0f} m beside its path after {driven:.0f} m{of_all}"
    is_stopped = bool(record.speed[-1] < STOPPED_BELOW)
    if planned is None:
        is_short = is_stopped and bool(cause)
    else:
        share = 0.0 if is_stopped and cause else MISSING_SHARE
        is_short = planned - driven > max(share * planned, MISSING_DISTANCE)
    if not is_short:
        return ""
    what = "the car stopped" if is_stopped else "the drive ended"
    return f"{what} after {driven:.0f} m{of_all}{': ' if cause else ''}{cause}"


def stop_cause(columns: BagColumns, record: DriveRecord) -> str:
    """Return the request that stopped the car, with its reason; empty: there was none.

    A request after the standstill, such as that at the end of the controller, is no cause.
    """
    for rows in (columns.tick.get("stop_requested"), columns.values.get(topics.STOP_REQUEST)):
        if rows is None or not len(rows) or not rows[-1, 1] > 0:
            continue
        first = len(rows) - int(np.argmin(np.append(rows[::-1, 1] > 0, False)))
        if np.interp(rows[first, 0], record.time, record.speed) < STOPPED_BELOW:
            continue
        # Ticks without a new state have equal stamps: their order decides.
        reasons = columns.tick.get("reason", np.empty((0, 2)))
        is_same = len(reasons) == len(rows)
        begin = first if is_same else int(np.searchsorted(reasons[:, 0], rows[first, 0]))
        at = reasons[begin:, 1][reasons[begin:, 1] > 0]
        if not len(at) or not 0 < at[0] < len(REASONS):
            return "a stop was requested"
        return f"a stop was requested ({REASONS[int(at[0])]})"
    return ""


def planned_distance(columns: BagColumns) -> float | None:
    """Return the distance of the scenario in a bag [m]; None: the bag names none.

    A standstill on purpose and the end of the path are part of the plan.
    """
    for node in ("planner", "simulator"):
        scenario = columns.configuration.get(node, {}).get("scenario")
        if isinstance(scenario, Mapping):
            try:
                return scenario_distance(scenario)
            except (KeyError, TypeError, ValueError):
                continue
    return None


def scenario_distance(scenario: Mapping[str, Any]) -> float:
    """Return the distance that a car covers with the speed profile in the duration [m].

    Args:
        scenario: YAML values, as `scenario_content` writes them.

    Raises:
        KeyError, TypeError, ValueError: It was written by another program.
    """
    profile, duration = scenario["speed"], float(scenario["duration"])
    at, speed = numbers(profile["at"]), numbers(profile["speed"])
    if not profile["over_distance"]:
        time = np.linspace(0.0, duration, 10_001)
        values = np.interp(time, at, speed)
        return float(np.sum(np.diff(time) * (values[1:] + values[:-1]) / 2))
    x, y = numbers(scenario["points"]["x"]), numbers(scenario["points"]["y"])
    length, lap = float(np.hypot(np.diff(x), np.diff(y)).sum()), float(profile["period"])
    reach = max(length - STAND_OFF, 0.0) if math.isinf(lap) else length
    s = np.linspace(0.0, reach, 10_001)
    values = np.interp(s, at, speed)
    if math.isinf(lap):
        values = np.minimum(values, np.sqrt(2 * END_DECELERATION * (reach - s)))
    step = s[1] - s[0]
    stays = int(STOP_LENGTH / step) + 1 if step > 0 else 1
    middle = (values[1:] + values[:-1]) / 2
    time = np.append(0.0, np.cumsum(step / np.maximum(middle, SLOWEST_SECTION)))
    is_zero = np.convolve(values <= 0.0, np.ones(stays), "valid") >= stays
    if is_zero[:-1].any():
        return float(min(np.interp(duration, time, s), s[int(np.argmax(is_zero))]))
    if math.isinf(lap):
        return float(np.interp(duration, time, s))
    return duration / float(time[-1]) * lap


def numbers(text: str) -> Array:
    """Return the numbers of a row of a configuration."""
    return np.array([float(word) for word in text.split()])
