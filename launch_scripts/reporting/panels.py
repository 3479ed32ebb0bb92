"""Panels of the report: quantities over time, and the events of a drive.

To add a chart, write a function that yields the `Series` of one drive, and append a `Panel` with
this function to `PANELS`:

    def yaw_rate(drive: JudgedDrive) -> Iterator[Series]:
        yield Series("yaw rate", drive.record.time, drive.record.yaw_rate)

    PANELS.append(Panel("yaw_rate", "Yaw rate", "Measured.", (Axis("rate [rad/s]", yaw_rate),)))

The page, the SVG and PDF files, and the text for screen readers follow from this entry. A panel
without data is listed by its title.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config import topics
from ampc_msgs_config.metrics import DEG, missed_before
from ampc_msgs_config.types import LIMITS, MODES, REASONS, RUNGS, Array
from launch_scripts.reporting.drive import INDEX_RANGE, NO_POINTS, JudgedDrive

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito: distinct for colour-blind readers, without the yellow (invisible on white)."""
GREY = "#767676"
INDICES = {
    "rung": ("rung", RUNGS),
    "reason": ("reason", REASONS),
    "clipped": ("guard clips", LIMITS),
    "mode": ("mode", tuple(mode.partition(":")[0] for mode in MODES)),
}
"""Published indices: label, and the names, of which the first is normal."""
FLAGS = {
    "stop_requested": "stop requested",
    "qp_fault": "injected QP fault",
    "outside_table": "outside the gain table",
}
COUNTERS = {"rejected_inputs": "inputs rejected", "resets": "controller reset"}
"""Published counters since the configuration of the controller."""


class Series(NamedTuple):
    """One line of a panel."""

    label: str
    """Displayed quantity; the same for all drives."""
    time: Array
    """(n,) since the first command [s]."""
    values: Array
    """(n,) in the unit of the axis."""
    kind: int = 0
    """Number of the line within its panel: decides its colour or dash."""
    step: bool = False
    """Whether a value holds until the next one."""
    bound: bool = False
    """Whether the line is a limit of the others."""
    wide: bool = False
    """Whether the line is visible behind another one that equals it."""

    def color(self, drive: int, drives: int) -> str:
        """Return the colour: by drive, or by kind where there is only one drive."""
        if self.bound and drives == 1:
            return GREY
        return PALETTE[(drive if drives > 1 else self.kind) % len(PALETTE)]


Lines = Callable[[JudgedDrive], Iterator[Series]]


class Axis(NamedTuple):
    """One row of a panel."""

    title: str
    """With unit."""
    lines: Lines
    log: bool = False
    visible: tuple[float, ...] = ()
    """Values that are always within the range, so that noise does not fill the chart."""


class Panel(NamedTuple):
    """One chart over time; its rows share the time axis."""

    key: str
    """Part of element names and file names."""
    title: str
    description: str
    axes: tuple[Axis, ...]


def error_lines(label: str, column: int, scale: float = 1.0) -> Lines:
    """Return the function that yields a column of the tracking errors in the unit of the axis."""

    def lines(drive: JudgedDrive) -> Iterator[Series]:
        if np.isfinite(drive.errors[:, column]).any():
            yield Series(label, drive.record.time, drive.errors[:, column] * scale)

    return lines


def samples(
    drive: JudgedDrive, name: str, label: str, kind: int = 0, scale: float = 1.0, column: int = 1
) -> Iterator[Series]:
    """Yield a column of a topic or of a published quantity, if it was recorded.

    A quantity in SI holds until its next sample; see `Series` for the other arguments.
    """
    topic = drive.columns.values.get(name)
    rows = drive.record.tick.get(name, NO_POINTS) if topic is None else topic
    if len(rows):
        step = topic is None and scale == 1.0
        yield Series(label, rows[:, 0], scale * rows[:, column], kind, step)


def steering(drive: JudgedDrive) -> Iterator[Series]:
    """Yield bounds, measured angle, angle before the guard, and command."""
    time, tick = drive.record.time, drive.record.tick
    for name, kind, bound in (
        ("bound of the controller", 4, drive.record.angle_bound),
        ("bound of the guard", 3, drive.context.guard_bound(drive.record.speed)),
    ):
        if bound is not None:
            for sign in (1.0, -1.0):
                yield Series(name, time, sign * np.degrees(bound), kind, bound=True)
    yield from samples(drive, topics.STEERING_STATE, "measured", 1, DEG)
    planned = tick.get("planned_steering", NO_POINTS)
    if not np.array_equal(planned, tick.get("steering", planned)):
        yield from samples(drive, "planned_steering", "before the guard", 2, DEG)
    if len(drive.record.steering):
        yield Series("command", time, np.degrees(drive.record.steering), 0)


def speeds(drive: JudgedDrive) -> Iterator[Series]:
    """Yield target speed and measured speed."""
    for series in samples(drive, topics.TARGET_SPEED, "target", 4):
        yield series._replace(wide=True)
    yield from samples(drive, topics.ODOM, "speed", column=4)


def lateral_acceleration(drive: JudgedDrive) -> Iterator[Series]:
    """Yield the product of speed and yaw rate."""
    odom = drive.columns.values[topics.ODOM]
    yield Series("lateral acceleration", odom[:, 0], odom[:, 4] * odom[:, 6])


def wind(drive: JudgedDrive) -> Iterator[Series]:
    """Yield both components in the fixed frame."""
    yield from samples(drive, topics.WIND, "to +x of the map", 0, column=1)
    yield from samples(drive, topics.WIND, "to +y of the map", 1, column=2)


def published(*labels: tuple[str, str], scale: float = 1.0, first: int = 0) -> Lines:
    """Return the function that yields quantities by name and label; `first`: kind of the first."""

    def lines(drive: JudgedDrive) -> Iterator[Series]:
        for kind, (name, label) in enumerate(labels, first):
            yield from samples(drive, name, label, kind, scale)

    return lines


HORIZONS = published(
    ("prediction_horizon", "prediction horizon N_p"),
    ("control_horizon", "control horizon N_c"),
    ("laguerre_terms", "Laguerre terms N"),
)
POLE = published(("laguerre_pole", "Laguerre pole \u03b1"), first=3)
WEIGHTS = published(
    ("output_weight", "output weight Q"), ("increment_weight", "increment weight R"), first=4
)
PANELS = [
    Panel(
        "cross_track",
        "Cross-track error",
        "Distance of the centre of gravity from the path, positive to its left.",
        (Axis("error [m]", error_lines("cross-track error", 0), visible=(-0.05, 0.05)),),
    ),
    Panel(
        "heading",
        "Heading error",
        "Heading of the car minus heading of the path, positive to the left.",
        (Axis("error [deg]", error_lines("heading error", 1, DEG), visible=(-0.5, 0.5)),),
    ),
    Panel(
        "steering",
        "Steering",
        "Road-wheel angle, positive to the left: command, measurement and bounds.",
        (Axis("angle [deg]", steering, visible=(-1.0, 1.0)),),
    ),
    Panel(
        "speed",
        "Speed",
        "Measured speed and target speed.",
        (Axis("speed [m/s]", speeds, visible=(0.0,)),),
    ),
    Panel(
        "lateral_acceleration",
        "Lateral acceleration",
        "Measured speed times measured yaw rate, positive to the left.",
        (Axis("a_y [m/s\u00b2]", lateral_acceleration, visible=(-0.5, 0.5)),),
    ),
    Panel(
        "wind",
        "Wind",
        "Velocity of the air over ground.",
        (Axis("wind [m/s]", wind, visible=(-1.0, 1.0)),),
    ),
    Panel(
        "adaptation",
        "Car assumed by the controller",
        "As configured, or as estimated while driving.",
        (
            Axis(
                "latency [ms]",
                published(("steering_latency", "latency of the steering"), scale=1e3),
                visible=(0.0, 100.0),
            ),
            Axis(
                "offset [deg]",
                published(("steering_offset", "offset of the steering"), scale=DEG),
                visible=(-0.5, 0.5),
            ),
            Axis(
                "K [mrad s\u00b2/m]",
                published(("understeer_gradient", "understeer gradient"), scale=1e3),
                visible=(0.0, 1.0),
            ),
            Axis(
                "C_r [kN/rad]",
                published(("rear_cornering_stiffness", "rear cornering stiffness"), scale=1e-3),
                visible=(0.0,),
            ),
        ),
    ),
    Panel(
        "gains",
        "Gains in use",
        "Gain table at the current speed: horizons in ticks, Laguerre pole, weights.",
        (
            Axis("ticks", HORIZONS),
            Axis("pole", POLE, visible=(0.0, 1.0)),
            Axis("weight", WEIGHTS, log=True),
        ),
    ),
    Panel(
        "constraints",
        "Constraints",
        "Constraint rows that hold with equality, and violation of the soft output constraint.",
        (
            Axis("rows", published(("active_constraints", "active constraints")), visible=(0, 1)),
            Axis("slack [m]", published(("slack", "slack")), visible=(0.0, 0.01)),
        ),
    ),
    Panel(
        "solve_time",
        "Solve time",
        "Wall time of one controller step, on a logarithmic scale.",
        (Axis("time [\u00b5s]", published(("solve_time", "solve time"), scale=1e6), log=True),),
    ),
]
"""All charts over time except the events, in the order of the page."""
EVENTS = Panel(
    "events",
    "Faults, fallbacks and guard",
    "Deviations from normal operation; each bar is an interval of ticks.",
    (),
)


class Event(NamedTuple):
    """One row of the chart of events for one drive."""

    label: str
    drive: int
    spans: Array
    """(n, 2) begin and end of each interval [s]."""
    ticks: int


def events_of(drives: Sequence[JudgedDrive]) -> list[Event]:
    """Return all events of all drives."""
    return [event for number, drive in enumerate(drives) for event in find_events(drive, number)]


def find_events(drive: JudgedDrive, number: int) -> Iterator[Event]:
    """Yield the events of a drive."""
    tick, time = drive.record.tick, drive.record.time
    active: list[tuple[str, Array, NDArray[np.bool_]]] = []
    for name, (label, words) in INDICES.items():
        rows = tick.get(name, NO_POINTS)
        for value in np.unique(np.clip(rows[:, 1], *INDEX_RANGE)).astype(int).tolist():
            word = words[value] if 0 <= value < len(words) else str(value)
            if value:
                text = f"{label}: {word.replace('_', ' ')}"
                active.append((text, rows[:, 0], rows[:, 1] == value))
    for name, label in FLAGS.items():
        rows = tick.get(name, NO_POINTS)
        active.append((label, rows[:, 0], rows[:, 1] != 0.0))
    for name, label in COUNTERS.items():
        rows = tick.get(name, NO_POINTS)
        active.append((label, rows[1:, 0], np.diff(rows[:, 1]) > 0.0))
    rows = tick.get("converged", NO_POINTS)
    active.append(("QP not solved", rows[:, 0], rows[:, 1] != 1.0))
    for label, stamps, is_active in active:
        if is_active.any():
            edges = np.diff(np.concatenate(([False], is_active, [False])).astype(int))
            begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
            ends = np.minimum(ends, len(stamps) - 1)  # a tick lasts until the next one
            spans = np.column_stack((stamps[begins], stamps[ends]))
            yield Event(label, number, spans, int(is_active.sum()))
    gaps = np.flatnonzero(missed_before(time, drive.record.period))
    if len(gaps):
        spans = np.column_stack((time[gaps], time[gaps + 1]))
        yield Event("missed ticks", number, spans, int(drive.metrics["missed_ticks"] or 0))
