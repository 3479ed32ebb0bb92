"""Draw the largest error over the noise of the path points, before and after the smoothing.

`python -m tests.workshop.acceptance.path_noise`. `--store-before` measures and stores the curves
"before" in path_noise_before.json; without it, the curves of the present code are added.
"""

import argparse
import json
import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path as File
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampc_msgs_config.metrics import LOST
from launch_scripts.reporting.style import BLUE, FONT, ORANGE, save_png
from tests.workshop.acceptance.real_drives import Setup
from tests.workshop.acceptance.real_paths import (
    CARS,
    WINDOW_STARTS,
    Block,
    drive_static,
    drive_window,
)
from tests.workshop.acceptance.real_roads import TURNED, Disturbance

BEFORE = File(__file__).with_name("path_noise_before.json")
FIGURE = File("ampc_ros/doc/path_noise.png")
COMMAND = "python -m tests.workshop.acceptance.path_noise --store-before"
NOISE = (0.0, 0.005, 0.01, 0.02, 0.03, 0.04, 0.05)
"""Standard deviations [m]."""
ROADS, SPEEDS, SPACING = ("straight", "sc1", "circle"), (9.0, 15.0), 0.5
STATIC, ROLLING = "path sent once", "window of 60 m rolling with the car at 10 Hz"
COLORS = {"paper": ORANGE, "ordinary": BLUE}
TARGETS = {STATIC: ((0.005, 0.01, 0.02, 0.05), (0.12, 0.12, 0.15, 0.30)),
           ROLLING: ((0.02, 0.05), (0.15, 0.30))}  # fmt: skip
"""Targets of the largest error: noise and error [m]."""
SMALLEST = 1e-3
"""Lower end of the axis; smaller errors are drawn there [m]."""


class Curve(NamedTuple):
    """Largest error of one car at one speed over the noise."""

    panel: str
    car: str
    speed: float
    error: tuple[float, ...]
    """Largest error on all roads for each of `NOISE`; infinite: a path was rejected [m]."""


def measure_curve(panel: str, car: str, speed: float) -> Curve:
    """Drive all roads with each noise, each for at most 30 s in a rolling window."""
    return Curve(panel, car, speed, tuple(largest_error(panel, car, speed, n) for n in NOISE))


def largest_error(panel: str, car: str, speed: float, noise: float) -> float:
    """Return the largest error on all roads [m]."""
    errors, disturbance = [], Disturbance(noise)
    for number, name in enumerate(ROADS):
        block = Block(name, Setup(car, speed), SPACING, TURNED[1], 0.0, (number,))
        if panel == STATIC:
            errors.append(drive_static(block, disturbance, 1)[0].max)
        else:
            errors += [drive_window(block, disturbance, at, 1).max for at in WINDOW_STARTS]
    return max(errors)


def measure(workers: int) -> list[Curve]:
    """Measure all curves in parallel."""
    cases = product((ROLLING, STATIC), CARS, SPEEDS)
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(measure_curve, *zip(*cases, strict=True)))


def draw(before: Sequence[Curve], after: Sequence[Curve], file: File) -> None:
    """Draw one panel for a static path and one for rolling windows."""
    with mpl.rc_context(FONT):
        figure = Figure(figsize=(9.5, 4.2), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
    for ax, panel in zip(panels, (STATIC, ROLLING), strict=True):
        for curves, line, label in ((before, "--", "before"), (after, "-", "now")):
            for curve in curves:
                if curve.panel == panel:
                    draw_curve(ax, curve, line, label)
        noise, error = TARGETS[panel]
        ax.plot([100 * n for n in noise], error, "k_", markersize=14, label="target")
        ax.set_title(panel, loc="left", fontweight="bold")
        ax.set_xlabel("standard deviation of the path points [cm]")
        ax.set_yscale("log")
        ax.set_ylim(SMALLEST / 1.3, 2 * LOST)
        ax.axhline(LOST, color="#777777", linewidth=0.8)
        ax.text(0.0, 1.2 * LOST, "lost: the drive ends", fontsize=8, color="#777777")
        ax.grid(alpha=0.25)
    panels[0].set_ylabel("largest error against the true road [m]")
    panels[1].legend(loc="lower right", fontsize=7, ncols=2)
    save_png(figure, file)


def draw_curve(ax: Axes, curve: Curve, line: str, label: str) -> None:
    """Draw one curve; rejected paths and lost cars are at the upper end."""
    error = [min(max(value, SMALLEST), LOST) for value in curve.error]
    marker = "o" if curve.speed == SPEEDS[0] else "s"
    ax.plot(
        [100 * n for n in NOISE],
        error,
        color=COLORS[curve.car],
        linestyle=line,
        marker=marker,
        markersize=4,
        markerfacecolor="none" if label == "before" else None,
        label=f"{label}: {curve.car} car, {curve.speed:g} m/s",
    )


def read(file: File) -> list[Curve]:
    """Read stored curves."""
    rows = json.loads(file.read_text(encoding="utf-8"))["curves"]
    return [Curve(**{**row, "error": tuple(numbers(row["error"]))}) for row in rows]


def numbers(values: Sequence[float | None]) -> list[float]:
    """Return JSON numbers; null is infinite."""
    return [math.inf if value is None else value for value in values]


def write(curves: Sequence[Curve], file: File, command: str) -> None:
    """Write curves as JSON; infinite errors are null."""
    rows: list[dict[str, Any]] = [
        {**c._asdict(), "error": [e if math.isfinite(e) else None for e in c.error]} for c in curves
    ]
    content = {"command": command, "noise": NOISE, "curves": rows}
    file.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the curves and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figure", type=File, default=FIGURE, help="default: %(default)s")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    parser.add_argument("--store-before", action="store_true", help="store the curves 'before'")
    chosen = parser.parse_args(arguments)
    curves = measure(chosen.workers)
    if chosen.store_before:
        write(curves, BEFORE, COMMAND)
    draw(read(BEFORE), [] if chosen.store_before else curves, chosen.figure)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
