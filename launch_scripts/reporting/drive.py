"""One bag of a report: its drive, judged."""

from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from ampc_msgs_config import ros
from ampc_msgs_config.metrics import Drive, errors
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array, VehicleState
from launch_scripts.bags.bag_columns import BagColumns, read_columns
from launch_scripts.bags.drive_log import answered, states_of
from launch_scripts.reporting.context import ReportInputs, RunContext, run_context_of
from launch_scripts.reporting.summary import Summary, SupervisionSummary, summarize

NO_POINTS = np.empty((0, 2))
WORDS = (-1.0, 1000.0)
"""A quantity that counts words is none beyond these."""
MISSING = {
    ros.STEERING_COMMAND: "no steering_command: steering is left out, and every state is judged",
    ros.REFERENCE_PATH: "no reference_path: errors are left out",
    ros.TARGET_SPEED: "no target_speed",
    ros.STEERING_STATE: "no steering_state: the measured angle is left out",
    ros.WIND: "no wind",
}


class Judged(NamedTuple):
    """A drive and what is to be said about it; times are since the first command [s]."""

    name: str
    columns: BagColumns
    known: RunContext
    time: Array
    """Of the ticks (n,) [s]."""
    states: Array
    """x, y, yaw, v_x, v_y, yaw rate at the ticks (n, 6)."""
    steering: Array
    """Commanded at the ticks (n,) [rad]; empty where the bag has no command."""
    errors: Array
    """Cross-track [m] and heading error [rad] at the ticks (n, 2); nan without a reference."""
    period: float
    """Of the controller [s]."""
    summary: Summary
    notes: list[str]
    """What is missing or odd, each in a sentence."""


def judge_bag(bag: File, name: str, namespace: str | None, given: ReportInputs) -> Judged:
    """Read a bag and judge its drive.

    Raises:
        ValueError: One line that names the bag and what is wrong.
    """
    return judge_columns(read_columns(bag, namespace), name, given)


def judge_columns(columns: BagColumns, name: str, given: ReportInputs) -> Judged:
    """Judge a drive that has been read.

    Raises:
        ValueError: The bag holds less than two states.
    """
    known = run_context_of(columns, given)
    notes = [*columns.notes, *known.notes, *missing(columns)]
    rows, steering = ticks_of(columns, notes)
    if len(rows) < 2:
        raise ValueError(f"{columns.bag}: {len(rows)} usable states, 2 are needed")
    time = rows[:, 0]
    period = known.settings.sample_time if known.settings else float(np.median(np.diff(time)))
    error = errors_of(columns, states_of(rows, columns.start_ns), time, known.to_cg, notes)
    told = SupervisionSummary(time, rows[:, 1:], steering, error, period, columns, known)
    return Judged(
        name, columns, known, time, rows[:, 1:], steering, error, period, summarize(told), notes
    )


def missing(columns: BagColumns) -> list[str]:
    """Say in one sentence which topics are not there."""
    absent = [text for topic, text in MISSING.items() if topic not in columns.values]
    if not columns.tick:
        absent.append("no controller/tick: gains, constraints, solve time and faults are left out")
    elif ros.TICK not in columns.values:
        absent.append("no controller/tick: faults, fall-backs and guard are left out")
    return [f"The bag holds {'; '.join(absent)}."] if absent else []


def ticks_of(columns: BagColumns, notes: list[str]) -> tuple[Array, Array]:
    """Give time and state of each tick (n, 7), and the commanded angle (n,) [rad]."""
    odom = columns.values[ros.ODOM]
    commands = columns.values.get(ros.STEERING_COMMAND, NO_POINTS)
    if not len(commands):
        return odom[np.diff(odom[:, 0], prepend=-np.inf) > 0], np.empty(0)
    rows, steering = answered(odom, commands)
    if len(rows) >= 0.5 * len(commands):
        return rows, steering
    notes.append("Commands do not carry a state's stamp: each is taken for the state before it.")
    commands = commands[commands[:, 0] >= odom[0, 0]]
    before = np.searchsorted(odom[:, 0], commands[:, 0], side="right") - 1
    rows = odom[before]
    rows[:, 0] = commands[:, 0]
    return rows, commands[:, 1]


def errors_of(
    columns: BagColumns, states: list[VehicleState], time: Array, to_cg: float, notes: list[str]
) -> Array:
    """Give the errors of each tick from the path that was in force (n, 2); nan where none was."""
    found = np.full((len(time), 2), np.nan)
    begins = np.array([path.time for path in columns.paths])
    for k, path in enumerate(columns.paths):
        begin = np.searchsorted(time, path.time) if k else 0
        end = np.searchsorted(time, begins[k + 1]) if k + 1 < len(begins) else len(time)
        if begin == end:
            continue
        part = Drive(states[begin:end], time[begin:end], time[:0])
        try:
            found[begin:end] = errors(part, make_path(path.points), to_cg)
        except ValueError as error:
            notes.append(f"The reference at {path.time:.1f} s cannot be used: {error}.")
    return found
