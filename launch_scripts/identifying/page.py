"""Page of an identification: intervals, and measured beside predicted quantities."""

import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from matplotlib.figure import Figure

from ampc_msgs_config import __version__
from ampc_msgs_config.types import Array
from ampc_ros.identification.result import Identification
from launch_scripts.identifying.bag_recording import StartVehicle
from launch_scripts.identifying.files import vehicle_content
from launch_scripts.identifying.tables import notes_of, quantity_rows, unknown_rows
from launch_scripts.reporting.pages import num, render
from launch_scripts.reporting.style import BLUE, FONT, ORANGE, stack, svg

HEIGHTS = (1.7, 1.7, 1.7)
"""Heights of the panels [inch]."""
MOST_POINTS = 1500
"""Points of a line."""
GAP = 0.5
"""Time between two rows from which a line is broken [s]."""
ENLARGED = 8.0
"""Duration of the enlarged part [s]."""


def identification_page(
    result: Identification, vehicle: StartVehicle, notes: Sequence[str], command: str
) -> str:
    """Return the page."""
    content = vehicle_content(result, vehicle)
    before = {"chassis": asdict(vehicle.chassis), "steering": asdict(vehicle.steering)}
    changes = [
        [f"{part}.{key}", *(cell_of(v) for v in (values[key], content[part].get(key, values[key])))]
        for part, values in before.items()
        for key in values
    ]
    begin = busiest(result)
    return render(
        "identifying/identify.html",
        command=command,
        version=__version__,
        start=vehicle.name,
        rows=quantity_rows(result),
        unknown=[
            [title, quantity.reason, quantity.help] for title, quantity in unknown_rows(result)
        ],
        notes=[*notes_of(result), *notes],
        changes=changes,
        whole=svg(draw(result, vehicle, -math.inf, math.inf)),
        part=svg(draw(result, vehicle, begin, begin + ENLARGED)),
        begin=f"{begin:.0f}",
        end=f"{begin + ENLARGED:.0f}",
        residuals=residual_rows(result, vehicle),
    )


def cell_of(value: object) -> object:
    """Return a number as a cell."""
    return num(value, ".4g") if isinstance(value, float) and math.isfinite(value) else str(value)


def residual_rows(result: Identification, vehicle: StartVehicle) -> list[list[str]]:
    """Return RMS of the measured quantity and of the difference to the prediction."""
    rows = []
    for name, unit, factor in (
        ("steering", "deg", degrees_of_steering(result, vehicle)),
        ("yaw_rate", "deg/s", math.degrees(1.0)),
        ("lateral_velocity", "m/s", 1.0),
    ):
        y, y_hat = getattr(result.measured, name), getattr(result.predicted, name)
        if len(y):
            rms, left = (float(np.sqrt(np.mean(e**2))) * factor for e in (y, y - y_hat))
            title = name.replace("_", " ")
            rows.append([title, f"{rms:.3g}", f"{left:.3g}", unit])
    return rows


def degrees_of_steering(result: Identification, vehicle: StartVehicle) -> float:
    """Return degrees of the road wheel per unit of the steering topic."""
    ratio = result.quantities["ratio"]
    return math.degrees(1.0) / (ratio.value if ratio.is_identified else vehicle.steering.ratio)


def busiest(result: Identification) -> float:
    """Return the begin of the part with the largest changes of the yaw rate [s]."""
    time, yaw = result.time.yaw_rate, result.measured.yaw_rate
    change = np.abs(np.diff(np.convolve(yaw, np.ones(5) / 5, "same"), append=yaw[-1]))
    starts = np.unique(np.floor(time))  # of seconds with rows: stamps may jump by years
    total = np.concatenate(([0.0], np.cumsum(change)))
    first, last = (np.searchsorted(time, t) for t in (starts, starts + ENLARGED))
    return float(starts[int(np.argmax(total[last] - total[first]))])


def draw(result: Identification, vehicle: StartVehicle, begin: float, end: float) -> Figure:
    """Return steering, yaw rate and lateral velocity between two times, measured and predicted."""
    has_steering = len(result.measured.steering) > 0
    figure, axes = stack(HEIGHTS if has_steering else HEIGHTS[1:])
    offset = result.quantities["offset"]
    zero = offset.value if offset.is_identified else vehicle.steering.offset
    panels = [
        ("yaw_rate", "yaw rate\n[deg/s]", math.degrees(1.0), 0.0),
        ("lateral_velocity", "lateral velocity\n[m/s]", 1.0, 0.0),
    ]
    if has_steering:
        factor = degrees_of_steering(result, vehicle)
        label = "road-wheel\nangle [deg]"
        panels.insert(0, ("steering", label, factor, math.degrees(zero)))
    for ax, (name, label, factor, shift) in zip(axes, panels, strict=True):
        time = getattr(result.time, name)
        inside = (time >= begin) & (time <= end)
        for source, color, text, width in (
            (result.measured, ORANGE, "measured", 0.7),
            (result.predicted, BLUE, "predicted", 1.1),
        ):
            values = factor * getattr(source, name)[inside] + shift
            ax.plot(*line(time[inside], values), color=color, linewidth=width, label=text)
        ax.set_ylabel(label)
    where = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0)}
    axes[0].legend(ncols=2, frameon=False, fontsize=FONT["font.size"] - 1, **where)
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels(axes)
    return figure


def line(time: Array, values: Array) -> tuple[Array, Array]:
    """Return a thinned line that is broken where rows are missing."""
    every = max(len(time) // MOST_POINTS, 1)
    time, values = time[::every].copy(), values[::every].copy()
    gaps = np.flatnonzero(np.diff(time) > GAP) + 1
    return np.insert(time, gaps, np.nan), np.insert(values, gaps, np.nan)
