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
REFERENCE_RGB, DRIVEN_RGB, PREDICTED_RGB = (230, 159, 0), (86, 180, 233), (0, 158, 115)
"""Colours by Okabe and Ito, which differ from each other and from the dark background."""
HEIGHT = 0.05
"""Height of the driven path above the reference path [m]."""
OVERVIEW = 1.2
"""Height of the eye above the road, per extent of the road."""
FOLLOWING = (-14.0, -6.0, 10.0)
"""Place of the eye that follows the car, relative to its start [m]."""
PLOTS: dict[str, tuple[str, tuple[tuple[str, str, int, float], ...]]] = {
    "steering": (
        "Steering [deg]",
        (
            ("commanded", topics.STEERING_COMMAND, 1, 180.0 / np.pi),
            ("measured", topics.STEERING_STATE, 1, 180.0 / np.pi),
        ),
    ),
    "speed": (
        "Speed [m/s]",
        (("driven", topics.ODOM, 4, 1.0), ("target", topics.TARGET_SPEED, 1, 1.0)),
    ),
}
"""By entity: title, and for each line its name, topic, column and factor."""


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
    log_lines(rr, stream, f"{MAP_PATH}/reference_path", drive.columns.paths, REFERENCE_RGB, 4.0)
    predicted = drive.columns.predictions
    log_lines(rr, stream, f"{MAP_PATH}/predicted_path", predicted, PREDICTED_RGB, 2.0)
    odom = drive.columns.values[topics.ODOM]
    driven = np.column_stack((odom[:, 1:3], np.full(len(odom), HEIGHT)))
    line = rr.LineStrips3D([driven], colors=[DRIVEN_RGB], radii=rr.Radius.ui_points(1.5))
    stream.log(f"{MAP_PATH}/driven_path", line, static=True)
    # Car
    half = odom[:, 3] / 2
    zero = np.zeros(len(odom))
    quaternions = np.column_stack((zero, zero, np.sin(half), np.cos(half)))
    places = np.column_stack((odom[:, 1:3], zero))
    moves = rr.Transform3D.columns(translation=places, quaternion=quaternions)
    stream.send_columns(CAR_PATH, [rr.TimeColumn(TIMELINE, duration=odom[:, 0])], moves)
    log_car(rr, stream, drive)
    # Lines over time
    log_series(rr, stream, "error/cross_track", drive.record.time, drive.errors[:, 0])
    for entity, (_, lines) in PLOTS.items():
        for name, topic, column, factor in lines:
            rows = drive.columns.values.get(topic, np.empty((0, column + 1)))
            log_series(rr, stream, f"{entity}/{name}", rows[:, 0], factor * rows[:, column])
    for name, rows in drive.columns.tick.items():
        log_series(rr, stream, f"controller/{name}", rows[:, 0], rows[:, 1])
    stream.flush()
    stream.disconnect()


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
                    colors=[[round(255 * part) for part in each.colour] for each in boxes],
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
    """Return the default layout: the road and the car on the left, lines on the right."""
    odom = drive.columns.values[topics.ODOM]
    low, high = odom[:, 1:3].min(axis=0), odom[:, 1:3].max(axis=0)
    (x, y), extent = (low + high) / 2, float(max(*(high - low), 10.0))
    above = rrb.EyeControls3D(
        position=[x, y - 0.01 * extent, OVERVIEW * extent], look_target=[x, y, 0.0]
    )
    start = np.array((*odom[0, 1:3], 0.0))
    behind = rrb.EyeControls3D(
        position=start + FOLLOWING, look_target=start, tracking_entity=CAR_PATH
    )
    road = rrb.Spatial3DView(origin=MAP_PATH, name="Road", eye_controls=above)
    car = rrb.Spatial3DView(origin=MAP_PATH, name="Car", eye_controls=behind)
    plots = [rrb.TimeSeriesView(origin="error", name="Cross-track error [m]")]
    for entity, (title, _) in PLOTS.items():
        plots.append(rrb.TimeSeriesView(origin=entity, name=title))
    left = rrb.Vertical(road, car, row_shares=[2, 3])
    return rrb.Blueprint(rrb.Horizontal(left, rrb.Vertical(*plots)), collapse_panels=True)
