"""Which plots over time a report has, and the lines in them."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ampc_msgs_config import ros
from ampc_msgs_config.types import Array
from launch_scripts.reporting.drive import NO_POINTS, Judged
from launch_scripts.reporting.lines import Series

Lines = Callable[[Judged], Iterator[Series]]


class Axis(NamedTuple):
    """One row of a plot."""

    title: str
    lines: Lines
    log: bool = False
    least: tuple[float, ...] = ()
    """Values that are always seen, so that noise does not fill the plot."""


class Plot(NamedTuple):
    """What a plot is called, what it shows, and its rows."""

    key: str
    title: str
    words: str
    axes: tuple[Axis, ...]


def topic(drive: Judged, name: str) -> Array:
    """Give the rows of a topic, or none."""
    return drive.columns.values.get(name, NO_POINTS)


def cross_track(drive: Judged) -> Iterator[Series]:
    """Distance from the path."""
    if np.isfinite(drive.errors[:, 0]).any():
        yield Series("cross-track error", drive.time, drive.errors[:, 0])


def heading(drive: Judged) -> Iterator[Series]:
    """Direction against the path's."""
    if np.isfinite(drive.errors[:, 1]).any():
        yield Series("heading error", drive.time, np.degrees(drive.errors[:, 1]))


def steering(drive: Judged) -> Iterator[Series]:
    """Command, what the guard made of it, measurement, bounds."""
    speed = drive.states[:, 3]
    for name, bound in (
        ("bound of the controller", drive.known.angle_bound(speed)),
        ("bound of the guard", drive.known.guard_bound(speed)),
    ):
        if bound is not None:
            kind = 3 if name.endswith("guard") else 4
            for sign in (1.0, -1.0):
                yield Series(name, drive.time, sign * np.degrees(bound), kind, bound=True)
    measured = topic(drive, ros.STEERING_STATE)
    if len(measured):
        yield Series("measured", measured[:, 0], np.degrees(measured[:, 1]), 1)
    planned = drive.columns.tick.get("planned_steering", NO_POINTS)
    published = drive.columns.tick.get("steering", planned)
    if len(planned) and not np.array_equal(planned, published):
        yield Series("before the guard", planned[:, 0], np.degrees(planned[:, 1]), 2)
    if len(drive.steering):
        yield Series("command", drive.time, np.degrees(drive.steering), 0)


def speeds(drive: Judged) -> Iterator[Series]:
    """Speed and target."""
    target, odom = topic(drive, ros.TARGET_SPEED), topic(drive, ros.ODOM)
    if len(target):
        yield Series("target", target[:, 0], target[:, 1], 1)
    yield Series("speed", odom[:, 0], odom[:, 4], 0)


def lateral_acceleration(drive: Judged) -> Iterator[Series]:
    """Speed times yaw rate."""
    odom = topic(drive, ros.ODOM)
    yield Series("lateral acceleration", odom[:, 0], odom[:, 4] * odom[:, 6])


def wind(drive: Judged) -> Iterator[Series]:
    """Components in the map's frame."""
    rows = topic(drive, ros.WIND)
    for k, name in enumerate(("to +x of the map", "to +y of the map")):
        if len(rows):
            yield Series(name, rows[:, 0], rows[:, k + 1], k)


def quantities(*labels: tuple[str, str], scale: float = 1.0, first: int = 0) -> Lines:
    """Give the lines of quantities of the controller, each with its label; kinds from `first`."""

    def lines(drive: Judged) -> Iterator[Series]:
        for kind, (name, label) in enumerate(labels, first):
            rows = drive.columns.tick.get(name, NO_POINTS)
            if len(rows):
                yield Series(label, rows[:, 0], scale * rows[:, 1], kind, step=scale == 1.0)

    return lines


PLOTS = (
    Plot(
        "cross_track",
        "Cross-track error",
        "Distance of the centre of gravity from the path, positive to its left.",
        (Axis("error [m]", cross_track, least=(-0.05, 0.05)),),
    ),
    Plot(
        "heading",
        "Heading error",
        "Heading of the car minus that of the path, positive to the left.",
        (Axis("error [deg]", heading, least=(-0.5, 0.5)),),
    ),
    Plot(
        "steering",
        "Steering",
        "Road-wheel angle, positive to the left: commanded, measured, and how far it may go.",
        (Axis("angle [deg]", steering, least=(-1.0, 1.0)),),
    ),
    Plot(
        "speed",
        "Speed",
        "Measured, and what was asked for.",
        (Axis("speed [m/s]", speeds, least=(0.0,)),),
    ),
    Plot(
        "lateral_acceleration",
        "Lateral acceleration",
        "Measured speed times measured yaw rate, positive to the left.",
        (Axis("a_y [m/s\u00b2]", lateral_acceleration, least=(-0.5, 0.5)),),
    ),
    Plot(
        "wind",
        "Wind",
        "Velocity of the air over ground.",
        (Axis("wind [m/s]", wind, least=(-1.0, 1.0)),),
    ),
    Plot(
        "gains",
        "Gains in use",
        "From the gain table, by speed: horizons in ticks, the Laguerre pole, the weights.",
        (
            Axis(
                "ticks",
                quantities(
                    ("prediction_horizon", "horizon N_p"),
                    ("control_horizon", "moves N_c"),
                    ("laguerre_terms", "Laguerre terms N"),
                ),
            ),
            Axis(
                "pole",
                quantities(("laguerre_pole", "Laguerre pole \u03b1"), first=3),
                least=(0.0, 1.0),
            ),
            Axis(
                "weight",
                quantities(
                    ("output_weight", "error Q"), ("increment_weight", "increment R"), first=4
                ),
                log=True,
            ),
        ),
    ),
    Plot(
        "constraints",
        "Constraints",
        "Constraint rows that hold with equality, and how far the soft lane was left.",
        (
            Axis(
                "rows", quantities(("active_constraints", "active constraints")), least=(0.0, 1.0)
            ),
            Axis("slack [m]", quantities(("slack", "slack")), least=(0.0, 0.01)),
        ),
    ),
    Plot(
        "solve_time",
        "Solve time",
        "Wall time of one controller step; the scale is logarithmic.",
        (Axis("time [\u00b5s]", quantities(("solve_time", "solve time"), scale=1e6), log=True),),
    ),
)
