"""Read the recording of an identification from a bag, and the vehicle that it starts from."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import ros, topics
from ampc_msgs_config.config import build
from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_msgs_config.types import NANOSECONDS, Array
from ampc_msgs_config.vehicle_file import read_vehicle
from ampc_ros.identification.estimate import Start
from ampc_ros.identification.recording import RecordedDrive, recording_of
from launch_scripts.bags.bag import open_bag
from launch_scripts.bags.bag_columns import BagColumns, read_columns

NO_COMMAND = "no command was recorded: record the topic, or rename it with --namespace"
NEW_CAR = "python launch_scripts/new_car.py --mass KG --wheelbase M --output start.yaml"
LONGEST_ANSWER = 0.5
"""Largest plausible time from a state to its command [s]."""
CHECK_STEP, MOST_CHECKS, LEAST_CHECKS = 0.5, 1_000_000, 10
"""Step of the checks of consistency [s], largest and smallest number of steps."""
CHECK_SPEED, LARGEST_MOVE, MOST_RATIO, LEAST_CORRELATION = 1.0, 50.0, 1.2, 0.6
"""Speed from which speeds are compared [m/s], largest move in a step [m], largest ratio of the
speeds, and correlation of angles that counts."""
LAG_STEP, LAGS = 0.1, 7
"""Step [s] and number of the delays of a response."""
HEIGHT_SHARE = 0.2
"""Height of the centre of gravity, as a share of the wheelbase, where the file states none."""
TRACK_SHARE = 0.57
"""Track width, as a share of the wheelbase, where the file states none."""


class StartVehicle(NamedTuple):
    """Vehicle that the identification starts from."""

    name: str
    """File, or origin."""
    sections: dict[str, dict[str, Any]]
    estimated: dict[str, float]
    chassis: ChassisParameters
    steering: SteeringParameters

    def start(self) -> Start:
        """Return what the estimator needs; usual values replace missing sections."""
        tyre, body, drive = (self.sections.get(name, {}) for name in ("tyre", "body", "powertrain"))
        wheelbase, usual = self.chassis.wheelbase, Start(self.chassis)
        return Start(
            self.chassis,
            self.steering.ratio,
            float(tyre.get("friction", usual.friction)),
            tyre.get("relaxation_length"),
            float(drive.get("front_drive_share", usual.front_drive)),
            float(drive.get("front_brake_share", usual.front_brake)),
            float(drive.get("rolling_resistance", usual.rolling)),
            float(body.get("track", TRACK_SHARE * wheelbase)),
            float(body.get("cg_height", HEIGHT_SHARE * wheelbase)),
            float(body.get("front_roll_share", usual.front_roll_share)),
            float(tyre.get("stiffest_load", usual.stiffest_load)),
        )


def vehicle_of_file(file: Path) -> StartVehicle:
    """Load the start vehicle from a file, which needs the sections chassis and steering.

    Raises:
        ValueError: File, key, value and bound.
    """
    content, user = read_vehicle(file), "the identification"
    return StartVehicle(
        str(file),
        content.sections,
        content.estimated,
        content.section(ChassisParameters, "chassis", user),
        content.section(SteeringParameters, "steering", user),
    )


def vehicle_of_bag(columns: BagColumns) -> StartVehicle:
    """Return the vehicle of the recorded configuration of the controller.

    Raises:
        ValueError: The bag has none; the message names the remedy.
    """
    control = columns.configuration.get("controller", {})
    if "chassis" not in control or "steering" not in control:
        raise ValueError(
            f"{columns.bag}: contains no configuration of a controller: name a start vehicle with "
            f"--vehicle; `{NEW_CAR}` writes one"
        )
    where = f"{columns.bag}: controller/{topics.CONFIGURATION}"
    sections = {key: dict(control[key]) for key in ("chassis", "steering")}
    return StartVehicle(
        where,
        sections,
        {},
        build(ChassisParameters, sections["chassis"], where, "chassis"),
        build(SteeringParameters, sections["steering"], where, "steering"),
    )


def read_recording(
    bag: Path, namespace: str | None, vehicle: StartVehicle | None
) -> tuple[RecordedDrive, StartVehicle, list[str]]:
    """Read a drive from a bag.

    Args:
        bag: Folder, or MCAP file.
        namespace: Namespace of the topics; None: that of the first steering command.
        vehicle: Start vehicle; None: that of the bag.

    Returns:
        RecordedDrive in the units of the steering topics, start vehicle, and notes about the bag.

    Raises:
        ValueError: The bag cannot be read, contains no command, or no vehicle.
    """
    given = vehicle.steering if vehicle else ros.ROAD_WHEEL
    columns = read_columns(bag, namespace, steering=given)
    if topics.STEERING_COMMAND not in columns.values:
        name = f"{columns.namespace}/{topics.STEERING_COMMAND}"
        raise ValueError(f"{bag}: holds no message on {name}: {NO_COMMAND}")
    vehicle = vehicle or vehicle_of_bag(columns)
    recorded = columns.configuration.get("controller", {}).get("steering")
    recorded = recorded or columns.configuration.get("simulator", {}).get("vehicle", {}).get(
        "steering"
    )
    interface = build(SteeringParameters, recorded, str(bag), "steering") if recorded else given
    states = increasing(columns.values[topics.ODOM])
    command = columns.values[topics.STEERING_COMMAND]
    steering = columns.values.get(topics.STEERING_STATE, np.empty((0, 2)))

    def position(rows: Array) -> Array:
        return np.column_stack((rows[:, 0], interface.ratio * (rows[:, 1] - interface.offset)))

    check_consistency(bag, states, command, steering)
    age = ages(bag, f"{columns.namespace}/{topics.ODOM}")
    sent = position(command)
    sent[:, 0] += time_to_answer(ages(bag, f"{columns.namespace}/{topics.STEERING_COMMAND}"))
    recording = recording_of(states[:, :7], sent, position(steering), age)
    return recording, vehicle, columns.notes


def time_to_answer(ages: Array) -> float:
    """Return the median time from the stamp of a command, that of its state, to its sending [s].

    The arrival at the recorder stands for the sending. Clocks that differ give no time: 0.
    """
    median = float(np.median(ages)) if len(ages) else 0.0
    return median if 0.0 <= median <= LONGEST_ANSWER else 0.0


def check_consistency(bag: Path, states: Array, command: Array, steering: Array) -> None:
    """Check that odometry, commands and measured steering describe one motion.

    Args:
        bag: For the message.
        states: (n, >= 7) time, x, y, yaw, v_x, v_y, yaw rate.
        command: (m, >= 2) time and angle.
        steering: (k, >= 2) time and measured angle.

    Raises:
        ValueError: The speed is not that of the position, or angles turn the other way.
    """
    where = f"{bag}: odom: twist.linear.x"
    grid = np.arange(states[0, 0], states[-1, 0], CHECK_STEP) if len(states) else np.empty(0)
    if len(grid) < 2 or len(grid) > MOST_CHECKS:
        return
    x, y, v_x = (np.interp(grid, states[:, 0], states[:, i]) for i in (1, 2, 4))
    moved, meant = np.hypot(np.diff(x), np.diff(y)), CHECK_STEP * v_x[:-1]
    fast = (np.abs(v_x[:-1]) > CHECK_SPEED) & (moved < LARGEST_MOVE)
    if fast.sum() >= LEAST_CHECKS:
        ratio = float(np.median(np.abs(meant[fast]) / np.maximum(moved[fast], 1e-3)))
        if not 1 / MOST_RATIO <= ratio <= MOST_RATIO:
            raise ValueError(f"{where} is {ratio:.3g} times the speed of the position, in m/s?")
    fine = np.arange(states[0, 0], states[-1, 0], LAG_STEP)
    angle = np.interp(fine, command[:, 0], command[:, 1])
    if len(steering):
        measured = np.interp(fine, steering[:, 0], steering[:, 1])
        if is_opposite(angle, measured):
            raise ValueError(f"{bag}: steering_state has the opposite sign of steering_command")
    v_x, yaw_rate = (np.interp(fine, states[:, 0], states[:, i]) for i in (4, 6))
    is_fast = np.abs(v_x) > CHECK_SPEED
    turning = np.where(is_fast, yaw_rate / np.where(is_fast, v_x, 1.0), 0.0)
    if is_opposite(angle, turning):
        raise ValueError(f"{bag}: the car turns against steering_command: left must be positive")


def is_opposite(command: Array, response: Array) -> bool:
    """Return whether a response follows its command, after at most 0.6 s, with the other sign."""
    found = [correlation(command[: len(command) - k], response[k:]) for k in range(LAGS)]
    return -min(found) > max(LEAST_CORRELATION, 1.3 * max(found))


def correlation(a: Array, b: Array) -> float:
    """Return the correlation of two signals; 0 if one is constant."""
    is_constant = len(a) < LEAST_CHECKS or np.ptp(a) == 0.0 or np.ptp(b) == 0.0
    return 0.0 if is_constant else float(np.corrcoef(a, b)[0, 1])


def increasing(rows: Array) -> Array:
    """Return rows of time and values whose times increase."""
    return rows[np.diff(rows[:, 0], prepend=-np.inf) > 0]


def ages(path: Path, topic: str) -> Array:
    """Return arrival minus stamp of the messages of a topic [s]."""
    with open_bag(path) as bag:
        return np.array(
            [
                (message.log_time_ns - ros.nanoseconds(bag.decode(message).header.stamp))
                / NANOSECONDS
                for message in bag.messages({topic})
            ]
        )
