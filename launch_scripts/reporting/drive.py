"""A recorded drive with its metrics and verdicts: `BagColumns` of a bag -> `JudgedDrive`."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path as File
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np

from ampc_msgs_config import topics
from ampc_msgs_config.config import build
from ampc_msgs_config.metrics import Drive, DriveRecord, Value, errors, measure
from ampc_msgs_config.parameters import (
    FRICTION_SHARE,
    GRAVITY,
    ChassisParameters,
    ControllerSettings,
    GuardLimits,
    SizeParameters,
    SteeringParameters,
    cornering_angle,
)
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import RUNGS, Array
from ampc_msgs_config.validation import Checked, number, units_of
from ampc_ros.supervision.guard import bounds
from launch_scripts.bags.bag_columns import BagColumns, answered, read_columns, states_of
from launch_scripts.reporting.completion import incompleteness

T = TypeVar("T", bound=Checked)
NO_POINTS = np.empty((0, 2))
INDEX_RANGE = (-1.0, 1000.0)
"""Range to which indices of rungs, reasons and limits are clipped before they become integers."""
MISSING = {
    topics.STEERING_COMMAND: "no steering_command: no steering metrics, "
    "every state counts as a tick",
    topics.REFERENCE_PATH: "no reference_path: no tracking errors",
    topics.TARGET_SPEED: "no target_speed",
    topics.STEERING_STATE: "no steering_state: no measured angle",
    topics.WIND: "no wind",
}
"""Consequence of each missing topic."""
OUTLINE = SizeParameters(width=1.8, front_overhang=0.9, rear_overhang=1.0)
"""Assumed size of a car that the bag does not describe."""
WHEELBASE = 2.7
"""Assumed wheelbase of a car that the bag does not describe [m]."""
SUMMARY = (
    *("duration", "distance"),
    *("rms_cross_track_error", "p95_cross_track_error", "max_cross_track_error"),
    *("rms_heading_error", "max_lateral_acceleration", "max_steering", "steering_effort"),
    *("steering_reversals", "steering_reversal_rate"),
    *("time_at_limit", "time_constrained", "time_clipped", "ticks", "missed_ticks"),
    *("fall_backs", *(f"rung_{name}" for name in RUNGS), "unsolved_ticks", "stop_requests"),
    *("solve_time_median", "solve_time_p99", "solve_time_max"),
)
"""Keys of the metrics of a report, in the order of its summary."""


@dataclass(frozen=True, kw_only=True)
class Thresholds(Checked):
    """Largest values that pass, SI, with the names of the metrics; `min_`: smallest values."""

    rms_cross_track_error: Annotated[float, number(0.0, math.inf, "m")] = math.inf
    p95_cross_track_error: Annotated[float, number(0.0, math.inf, "m")] = math.inf
    max_cross_track_error: Annotated[float, number(0.0, math.inf, "m")] = math.inf
    rms_heading_error: Annotated[float, number(0.0, math.inf, "rad")] = math.inf
    max_lateral_acceleration: Annotated[float, number(0.0, math.inf, "m/s^2")] = math.inf
    max_steering: Annotated[float, number(0.0, math.inf, "rad")] = math.inf
    steering_effort: Annotated[float, number(0.0, math.inf, "rad per tick")] = math.inf
    steering_reversals: Annotated[float, number(0.0, math.inf, "")] = math.inf
    steering_reversal_rate: Annotated[float, number(0.0, math.inf, "1/s")] = math.inf
    time_at_limit: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    time_constrained: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    time_clipped: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    missed_ticks: Annotated[float, number(0.0, math.inf, "ticks")] = math.inf
    fall_backs: Annotated[float, number(0.0, math.inf, "ticks")] = math.inf
    unsolved_ticks: Annotated[float, number(0.0, math.inf, "ticks")] = math.inf
    stop_requests: Annotated[float, number(0.0, math.inf, "")] = math.inf
    solve_time_median: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    solve_time_p99: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    solve_time_max: Annotated[float, number(0.0, math.inf, "s")] = math.inf
    min_duration: Annotated[float, number(0.0, math.inf, "s")] = 0.0
    min_distance: Annotated[float, number(0.0, math.inf, "m")] = 0.0


class Verdict(NamedTuple):
    """Result of one threshold for one drive."""

    threshold: str
    quantity: str
    limit: float
    at_least: bool
    value: Value
    """None: the bag lacks the data, which fails."""
    unit: str
    """SI."""

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit."""
        if self.value is None or not math.isfinite(self.value):
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    @property
    def measured(self) -> str:
        """The value with its unit, as text."""
        if self.value is None:
            return "not in the bag"
        return f"{self.value:.4g} {self.unit}".strip()

    @property
    def bound(self) -> str:
        """The limit with its relation and unit, as text."""
        sign = "\u2265" if self.at_least else "\u2264"
        return f"{sign} {self.limit:.6g} {self.unit}".strip()


def check_thresholds(thresholds: Thresholds, metrics: Mapping[str, Value]) -> list[Verdict]:
    """Return a verdict for each threshold that differs from its default."""
    result, units = [], units_of(Thresholds)
    for item in fields(thresholds):
        limit = getattr(thresholds, item.name)
        if limit != item.default:
            at_least = item.name.startswith("min_")
            name = item.name.removeprefix("min_")
            unit = units[item.name]
            result.append(Verdict(item.name, name, limit, at_least, metrics[name], unit))
    return result


class ReportedCar(NamedTuple):
    """Car of a bag without a configuration."""

    chassis: ChassisParameters
    steering: SteeringParameters
    size: SizeParameters | None


def load_car(file: File) -> ReportedCar:
    """Load the car of a bag from a vehicle file, whose size may be missing.

    Raises:
        ValueError: File, key, value and bound.
    """
    from ampc_msgs_config.vehicle_file import read_vehicle  # few reports need it

    vehicle, user = read_vehicle(file), "the report"
    return ReportedCar(
        vehicle.section(ChassisParameters, "chassis", user),
        vehicle.section(SteeringParameters, "steering", user),
        vehicle.section(SizeParameters, "size", user) if "size" in vehicle.sections else None,
    )


class RunContext(NamedTuple):
    """Controller and car of a drive; None where neither the bag nor the user names them."""

    controller: str
    version: str
    chassis: ChassisParameters | None
    steering: SteeringParameters | None
    settings: ControllerSettings | None
    size: SizeParameters | None
    guard: GuardLimits | None
    to_cg: float
    """Distance from the point that `odom` describes forward to the centre of gravity [m]."""
    notes: list[str]

    @property
    def outline(self) -> Array:
        """Corners (n, 2) of the car from above, about the point that `odom` describes [m]."""
        size, wheelbase, rear_axle = self.size or OUTLINE, WHEELBASE, 0.0
        if self.chassis is not None:
            wheelbase = self.chassis.wheelbase
            rear_axle = self.to_cg - self.chassis.cg_to_rear_axle
        rear, half = rear_axle - size.rear_overhang, size.width / 2
        front = rear_axle + wheelbase + size.front_overhang
        nose = front - 0.35 * size.width  # narrower in front, so that the heading is visible
        right = [(rear, -half), (nose, -half), (front, -0.6 * half)]
        return np.array([*right, *((x, -y) for x, y in reversed(right)), right[0]])

    def angle_bound(self, speed: Array) -> Array | None:
        """Return the controller's bound of the angle at speeds (n,) [m/s], in [rad]."""
        if self.settings is None:
            return None
        largest = self.settings.max_angle
        if self.steering is not None:
            largest = min(largest, self.steering.max_angle)
        if self.chassis is None or self.controller != "preview":
            return np.full(len(speed), largest)
        wheelbase, gradient = self.chassis.wheelbase, self.chassis.understeer_gradient
        most = FRICTION_SHARE * (self.settings.friction * GRAVITY)
        angles = [cornering_angle(wheelbase, gradient, v, most) for v in speed.tolist()]
        return np.minimum(angles, largest)

    def guard_bound(self, speed: Array) -> Array | None:
        """Return the guard's bound of the angle at speeds (n,) [m/s], in [rad]."""
        if self.guard is None or self.chassis is None:
            return None
        limits = (bounds(self.guard, self.chassis, v) for v in speed.tolist())
        return np.array([min(each.angle, each.acceleration) for each in limits])


class JudgedDrive(NamedTuple):
    """A recorded drive with metrics and verdicts; times are since the first command [s]."""

    name: str
    columns: BagColumns
    context: RunContext
    record: DriveRecord
    """Time, steering and further quantities at the ticks."""
    states: Array
    """x, y, yaw, v_x, v_y, yaw rate at the ticks (n, 6)."""
    errors: Array
    """Cross-track [m] and heading error [rad] at the ticks (n, 2); nan without a reference."""
    metrics: dict[str, Value]
    """By key of `SUMMARY`; None where the bag lacks the data."""
    verdicts: list[Verdict]
    """Result of each threshold that was set."""
    notes: list[str]
    """Missing or unusual data, one sentence each."""
    path_noise: float
    """Largest noise of the points of a reference path [m]; nan without one."""
    incomplete: str = ""
    """Why the drive did not reach its end; empty: it did, or is unknown."""

    @property
    def centres(self) -> Array:
        """Positions of the centre of gravity at all ticks (n, 2) [m]."""
        x, y, yaw = self.states[:, :3].T
        to_cg = self.context.to_cg
        return np.column_stack((x + to_cg * np.cos(yaw), y + to_cg * np.sin(yaw)))


def judge_bag(
    bag: File,
    name: str,
    namespace: str | None = None,
    vehicle: ReportedCar | None = None,
    thresholds: Thresholds | None = None,
    odom: str | None = None,
) -> JudgedDrive:
    """Read a bag and compute the metrics of its drive.

    Args:
        bag: Folder of the bag, or one MCAP file.
        name: Name in tables and legends.
        namespace: Prefix of the topics; default: see `read_columns`.
        vehicle: Car of a bag without a configuration.
        thresholds: Limits of the metrics.
        odom: Topic of the odometry; default: see `read_columns`.

    Raises:
        ValueError: Names the bag and the cause in one line.
    """
    steering = {"steering": vehicle.steering} if vehicle else {}
    columns = read_columns(bag, namespace, odom, **steering)
    return judge_columns(columns, name, run_context_of(columns, vehicle), thresholds)


def judge_columns(
    columns: BagColumns, name: str, context: RunContext, thresholds: Thresholds | None = None
) -> JudgedDrive:
    """Compute the metrics of a drive; for the arguments see `judge_bag`.

    Raises:
        ValueError: The bag contains fewer than two states.
    """
    notes = [*columns.notes, *context.notes, *missing(columns)]
    rows, steering = tick_rows(columns, notes)
    if len(rows) < 2:
        raise ValueError(f"{columns.bag}: {len(rows)} usable states, 2 are needed")
    time, states = rows[:, 0], rows[:, 1:]
    error, noise = errors_of(columns, rows, context, notes)
    valid = error[np.isfinite(error[:, 0])]
    tick = {"stop_requested": columns.values.get(topics.STOP_REQUEST, NO_POINTS), **columns.tick}
    record = DriveRecord(
        time,
        context.settings.sample_time if context.settings else float(np.median(np.diff(time))),
        valid[:, 0],
        valid[:, 1],
        speed=states[:, 3],
        yaw_rate=states[:, 5],
        steering=steering,
        angle_bound=context.angle_bound(states[:, 3]),
        solve_time=tick.get("solve_time", NO_POINTS)[:, 1],
        tick=tick,
    )
    metrics = measure(SUMMARY, record)
    numbers = columns.tick.get("commands", NO_POINTS)[:, 1]
    if lost := lost_ticks(numbers, notes):  # the controller has not missed them
        metrics["missed_ticks"] = max((metrics["missed_ticks"] or 0) - lost, 0)
    verdicts = check_thresholds(thresholds, metrics) if thresholds else []
    if incomplete := incompleteness(columns, record, error):
        notes.append(f"Not completed: {incomplete}.")
    return JudgedDrive(
        name, columns, context, record, states, error, metrics, verdicts, notes, noise, incomplete
    )


def lost_ticks(numbers: Array, notes: list[str]) -> int:
    """Return how many ticks the recorder has lost between others; note these and a late begin.

    Args:
        numbers: (n,) number of each tick since the controller's process began.
        notes: Receives one sentence each.
    """
    if len(numbers) and numbers[0] > 1:
        notes.append(f"The bag begins at tick {numbers[0]:.0f}: the drive began earlier.")
    steps = np.diff(numbers)
    gaps = np.flatnonzero(steps > 1)
    lost = int((steps[gaps] - 1).sum())
    if lost:
        first = f"{lost} ticks are missing in the bag, the first is tick {numbers[gaps[0]] + 1:.0f}"
        notes.append(f"{first}: the recorder has lost them.")
    return lost


def missing(columns: BagColumns) -> list[str]:
    """Return one sentence that lists the missing topics, or nothing."""
    absent = [text for topic, text in MISSING.items() if topic not in columns.values]
    if not columns.tick:
        absent.append("no controller/tick: no gains, constraints, solve time and faults")
    elif topics.TICK not in columns.values:
        absent.append("no controller/tick: no faults, fallbacks and guard")
    return [f"The bag contains {'; '.join(absent)}."] if absent else []


def tick_rows(columns: BagColumns, notes: list[str]) -> tuple[Array, Array]:
    """Return time and state of each tick (n, 7), and the commanded angle (n,) [rad]."""
    odom = columns.values[topics.ODOM]
    commands = columns.values.get(topics.STEERING_COMMAND, NO_POINTS)
    if not len(commands):
        return odom[np.diff(odom[:, 0], prepend=-np.inf) > 0], np.empty(0)
    rows, steering = answered(odom, commands)
    if len(rows) >= 0.5 * len(commands):
        return rows, steering
    notes.append("Commands carry no stamp of a state: each is assigned to the state before it.")
    commands = commands[commands[:, 0] >= odom[0, 0]]
    before = np.searchsorted(odom[:, 0], commands[:, 0], side="right") - 1
    rows = odom[before]
    rows[:, 0] = commands[:, 0]
    return rows, commands[:, 1]


def errors_of(
    columns: BagColumns, rows: Array, context: RunContext, notes: list[str]
) -> tuple[Array, float]:
    """Return the errors of each tick from the path valid at its time (n, 2), nan without a path.

    The second value is the largest noise of a path in use [m], nan without one.
    """
    known = context.settings.known_path_noise if context.settings else None
    noises = [math.nan]
    time, states = rows[:, 0], states_of(rows, columns.start_ns)
    result = np.full((len(time), 2), np.nan)
    begins = [0, *(int(np.searchsorted(time, path.time)) for path in columns.paths[1:]), len(time)]
    for path, begin, end in zip(columns.paths, begins, begins[1:], strict=False):
        if begin == end:
            continue
        part = Drive(states[begin:end], time[begin:end], time[:0])
        try:
            reference = make_path(path.points, known)
            result[begin:end] = errors(part, reference, context.to_cg)
            noises.append(reference.noise)
        except ValueError as error:
            notes.append(f"The reference path at {path.time:.1f} s is unusable: {error}.")
    return result, float(np.nanmax(noises)) if len(noises) > 1 else math.nan


def run_context_of(
    columns: BagColumns,
    vehicle: ReportedCar | None = None,
    settings: ControllerSettings | None = None,
    controller: str = "",
) -> RunContext:
    """Return controller and car from the configuration in a bag.

    Args:
        columns: Content of the bag.
        vehicle: Car, used where the bag has no configuration of it.
        settings: Settings of the controller, used likewise.
        controller: Name of the controller, used likewise.
    """
    control = columns.configuration.get("controller", {})
    simulated = columns.configuration.get("simulator", {}).get("vehicle", {})
    notes: list[str] = []
    if not control:
        source = "are unknown" if vehicle is None else "are those named for this report"
        notes.append(
            f"The bag contains no controller/configuration: vehicle, settings and bounds {source}."
        )
    chassis = read_section(ChassisParameters, control, "chassis", notes)
    steering = read_section(SteeringParameters, control, "steering", notes)
    size = read_section(SizeParameters, simulated, "size", notes)
    if vehicle is not None:
        chassis, steering = chassis or vehicle.chassis, steering or vehicle.steering
        size = size or vehicle.size
    if size is None:
        notes.append("The bag contains no size of the car: its outline on the map is assumed.")
    versions = np.unique(columns.tick.get("configuration", np.zeros((1, 2)))[:, 1])
    if len(versions) > 1:
        notes.append(
            f"The configuration was changed {len(versions) - 1} times: the last one is shown."
        )
    to_cg = control.get("base_link_to_cg")
    if not (isinstance(to_cg, (int, float)) and to_cg >= 0):
        to_cg = chassis.cg_to_rear_axle if chassis else 0.0
        if chassis is None:
            notes.append(
                "Errors are those of the point that odom describes (centre of gravity unknown)."
            )
    return RunContext(
        str(control.get("controller", controller)),
        str(control.get("version", "")),
        chassis,
        steering,
        read_section(ControllerSettings, control, "settings", notes) or settings,
        size,
        read_section(GuardLimits, control, "guard", notes),
        float(to_cg),
        notes,
    )


def read_section(cls: type[T], content: Any, name: str, notes: list[str]) -> T | None:
    """Return one section of a configuration; append a note and return None where it is invalid."""
    if not isinstance(content, Mapping) or name not in content:
        return None
    try:
        return build(cls, content[name], f"configuration: {name}")
    except ValueError as error:
        notes.append(f"Ignored: {error}.")
        return None
