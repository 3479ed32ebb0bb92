"""A drive as a recording of the viewer Rerun, with a layout: map, car, errors, steering, speed."""

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import topics
from ampc_msgs_config.types import Array
from launch_scripts.bags.bag import Bag, open_bag
from launch_scripts.bags.bag_columns import Sample
from launch_scripts.reporting.drive import JudgedDrive

PACKAGE = "rerun-sdk"
MAP_PATH, CAR_PATH = "map", "map/car"
"""Entities of the fixed frame, and of the car's frame."""
TIMELINE = "time"
REFERENCE_RGB, DRIVEN_RGB, PREDICTED_RGB = (230, 159, 0), (86, 180, 233), (240, 228, 66)
"""Colours by Okabe and Ito, which differ from each other and from the dark background."""
DRIVEN_HEIGHT = 0.05
"""Height of the driven path above the reference path [m]."""
ASPECT, OVERVIEW = 2.3, 1.6
"""Width of the view of the road per its height, and height of the eye per extent of the road."""
EYE_BEHIND, LOOK_AHEAD_OF_CAR = (-16.0, 0.0, 11.0), (7.0, 0.0, 0.0)
"""Place of the eye that follows the car, and the point that it looks at, in the car's frame [m]."""
BACKGROUND = (24, 26, 32)
DEGREES = 180.0 / np.pi


class Line(NamedTuple):
    """One line over time."""

    name: str
    topic: str
    column: int
    """Column of the topic's values after the time."""
    factor: float
    rgb: tuple[int, int, int]
    width: float = 1.5


PLOTS: dict[str, tuple[str, tuple[Line, ...]]] = {
    "steering": (
        "Steering [deg]",
        (
            Line("measured", topics.STEERING_STATE, 1, DEGREES, REFERENCE_RGB, 4.0),
            Line("commanded", topics.STEERING_COMMAND, 1, DEGREES, DRIVEN_RGB),
        ),
    ),
    "speed": (
        "Speed [m/s]",
        (
            Line("target", topics.TARGET_SPEED, 1, 1.0, REFERENCE_RGB, 4.0),
            Line("driven", topics.ODOM, 4, 1.0, DRIVEN_RGB),
        ),
    ),
}
"""Title and lines of each chart, by entity."""
ERROR_ENTITY = "error"
"""Entity of the cross-track error, whose chart is in millimetres."""


class Box(NamedTuple):
    """A cuboid of a marker."""

    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    colour: tuple[float, float, float, float]


def load_rerun() -> tuple[Any, Any]:
    """Import the packages `rerun` and `rerun.blueprint`.

    Raises:
        ValueError: One line: the package is not installed.
    """
    try:
        return import_module("rerun"), import_module("rerun.blueprint")
    except ImportError as error:
        raise ValueError(f"--rerun needs the package {PACKAGE}: pip install {PACKAGE}") from error


def write_rerun(file: Path, drive: JudgedDrive) -> None:
    """Write a drive as a recording of Rerun.

    Args:
        file: File to write, such as `drive.rrd`.
        drive: The drive; its bag is read again for the markers.

    Raises:
        ValueError: `rerun-sdk` is not installed, or the bag is damaged.
        OSError: The file cannot be written.
    """
    rr, rrb = load_rerun()
    file.parent.mkdir(parents=True, exist_ok=True)
    stream = rr.RecordingStream("ampc_ros", recording_id=drive.name)
    stream.save(str(file), default_blueprint=layout(rrb, drive))
    stream.log(MAP_PATH, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    # Road and driven path
    log_lines(rr, stream, f"{MAP_PATH}/reference_path", drive.columns.paths, REFERENCE_RGB, 7.0)
    predicted = drive.columns.predictions
    log_lines(rr, stream, f"{MAP_PATH}/predicted_path", predicted, PREDICTED_RGB, 2.0)
    odom = drive.columns.values[topics.ODOM]
    driven = np.column_stack((odom[:, 1:3], np.full(len(odom), DRIVEN_HEIGHT)))
    strip = rr.LineStrips3D([driven], colors=[DRIVEN_RGB], radii=rr.Radius.ui_points(1.0))
    stream.log(f"{MAP_PATH}/driven_path", strip, static=True)
    # Car
    half = odom[:, 3] / 2
    zero = np.zeros(len(odom))
    quaternions = np.column_stack((zero, zero, np.sin(half), np.cos(half)))
    places = np.column_stack((odom[:, 1:3], zero))
    moves = rr.Transform3D.columns(translation=places, quaternion=quaternions)
    stream.send_columns(CAR_PATH, [rr.TimeColumn(TIMELINE, duration=odom[:, 0])], moves)
    log_car(rr, stream, drive)
    # Lines over time
    for entity, time, values, line in chart_lines(drive):
        style = rr.SeriesLines(colors=[line.rgb], names=[line.name], widths=[line.width])
        stream.log(entity, style, static=True)
        log_series(rr, stream, entity, time, values)
    for name, rows in drive.columns.tick.items():
        log_series(rr, stream, f"controller/{name}", rows[:, 0], rows[:, 1])
    stream.flush()
    stream.disconnect()


def chart_lines(drive: JudgedDrive) -> Iterator[tuple[str, Array, Array, Line]]:
    """Return entity, time (n,) [s], values (n,) and style of each line of the charts."""
    error = Line("cross-track error", "", 0, 1e3, DRIVEN_RGB)
    yield f"{ERROR_ENTITY}/cross_track", drive.record.time, 1e3 * drive.errors[:, 0], error
    for entity, (_, lines) in PLOTS.items():
        for number, line in enumerate(lines):  # drawn in the order of their entities
            rows = drive.columns.values.get(line.topic, np.empty((0, line.column + 1)))
            values = line.factor * rows[:, line.column]
            yield f"{entity}/{number}_{line.name}", rows[:, 0], values, line


def log_lines(
    rr: Any, stream: Any, entity: str, paths: list[Sample], colour: tuple[int, ...], width: float
) -> None:
    """Log paths, each from its time on; `width` is half of that on the screen [points]."""
    for path in paths:
        stream.set_time(TIMELINE, duration=path.time)
        points = np.column_stack((path.points, np.zeros(len(path.points))))
        line = rr.LineStrips3D([points], colors=[colour], radii=rr.Radius.ui_points(width / 2))
        stream.log(entity, line)


def log_series(rr: Any, stream: Any, entity: str, time: Array, values: Array) -> None:
    """Log finite values (n,) over time (n,) [s]."""
    finite = np.isfinite(values)
    if finite.any():
        index = rr.TimeColumn(TIMELINE, duration=time[finite])
        stream.send_columns(entity, [index], rr.Scalars.columns(scalars=values[finite]))


def log_car(rr: Any, stream: Any, drive: JudgedDrive) -> None:
    """Log the boxes of the markers in a bag, or the outline of the car where it has none."""
    has_boxes = False
    with open_bag(drive.columns.bag) as bag:
        for time, entity, boxes in marker_boxes(bag, drive):
            has_boxes = True
            stream.set_time(TIMELINE, duration=time)
            stream.log(
                entity,
                rr.Boxes3D(
                    centers=[each.centre for each in boxes],
                    sizes=[each.size for each in boxes],
                    quaternions=[rr.Quaternion(xyzw=each.quaternion) for each in boxes],
                    colors=[[round(255 * part) for part in each.colour[:3]] for each in boxes],
                    fill_mode="solid",
                ),
            )
    if not has_boxes:
        corners = np.column_stack((drive.context.outline, np.full(len(drive.context.outline), 0.1)))
        stream.log(f"{CAR_PATH}/outline", rr.LineStrips3D([corners]), static=True)


def marker_boxes(bag: Bag, drive: JudgedDrive) -> Iterator[tuple[float, str, list[Box]]]:
    """Return time [s], entity and cuboids of each namespace of markers in a bag."""
    topic = f"{drive.columns.namespace}/{topics.MARKERS}"
    odometry = f"{drive.columns.namespace}/{topics.ODOM}"
    if not {topic, odometry} <= bag.topics.keys():
        return
    fixed = bag.decode(next(bag.messages([odometry]))).header.frame_id
    for message in bag.messages([topic]):
        groups: dict[str, list[Box]] = {}
        for each in bag.decode(message).markers:
            if each.type == each.CUBE and each.action == each.ADD:
                parent = MAP_PATH if each.header.frame_id == fixed else CAR_PATH
                groups.setdefault(f"{parent}/{each.ns}", []).append(box_of(each))
        stamp_ns = message.log_time_ns
        for entity, boxes in groups.items():
            yield (stamp_ns - drive.columns.start_ns) / 1e9, entity, boxes


def box_of(marker: Any) -> Box:
    """Unpack a cube."""
    at, turned, size = marker.pose.position, marker.pose.orientation, marker.scale
    colour = marker.color
    return Box(
        (at.x, at.y, at.z),
        (size.x, size.y, size.z),
        (turned.x, turned.y, turned.z, turned.w),
        (colour.r, colour.g, colour.b, colour.a),
    )


def layout(rrb: Any, drive: JudgedDrive) -> Any:
    """Return the default layout: the road and the car on the left, charts on the right."""
    odom = drive.columns.values[topics.ODOM]
    low, high = odom[:, 1:3].min(axis=0), odom[:, 1:3].max(axis=0)
    (x, y), (width, depth) = (low + high) / 2, high - low
    eye = OVERVIEW * max(float(width) / ASPECT, float(depth), 10.0)
    above = rrb.EyeControls3D(position=[x, y - 0.01 * eye, eye], look_target=[x, y, 0.0])
    behind = rrb.EyeControls3D(
        position=EYE_BEHIND, look_target=LOOK_AHEAD_OF_CAR, eye_up=(0.0, 0.0, 1.0)
    )
    contents, background = f"/{MAP_PATH}/**", rrb.Background(color=BACKGROUND)
    road = rrb.Spatial3DView(
        origin=MAP_PATH, name="Road", eye_controls=above, background=background, line_grid=False
    )
    car = rrb.Spatial3DView(
        origin=CAR_PATH, contents=contents, name="Car", eye_controls=behind, background=background
    )
    charts = [rrb.TimeSeriesView(origin=ERROR_ENTITY, name="Cross-track error [mm]")]
    for entity, (title, _) in PLOTS.items():
        lines = [values for name, _, values, _ in chart_lines(drive) if name.startswith(entity)]
        axis = rrb.ScalarAxis(range=range_of(np.concatenate(lines)))
        charts.append(rrb.TimeSeriesView(origin=entity, name=title, axis_y=axis))
    left = rrb.Vertical(road, car, row_shares=[2, 3])
    panel = rrb.TimePanel(state="collapsed", timeline=TIMELINE)
    parts = rrb.Horizontal(left, rrb.Vertical(*charts)), panel
    return rrb.Blueprint(
        *parts, rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden")
    )


def range_of(values: Array) -> tuple[float, float]:
    """Return a range that contains zero and all values (n,), at least 1 on each used side."""
    finite = values[np.isfinite(values)]
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=1.0))
    return 1.1 * min(low, -1.0) if low < -0.05 else -0.1 * high, 1.1 * high
