"""The fault matrix as a table for the terminal, as Markdown, JSON and a heat map."""

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
from PIL import Image
from rich.table import Table
from rich.text import Text

from ampc_msgs_config import __version__
from ampc_msgs_config.metrics import LOST
from ampc_msgs_config.types import RUNGS
from launch_scripts.reporting.heat_map import HeatCell, draw_heat_map
from launch_scripts.reporting.style import save_png
from launch_scripts.run.machine import describe_machine
from tests.workshop.fault_matrix.inject_cases import CASES
from tests.workshop.fault_matrix.inject_cells import EXTRA, NEAR, Cell, Conditions, Course

MARGIN = 3.4
"""Of the heat map, for the names of the faults [inch]."""
COLORS = 96
"""Of the picture."""
FINEST = 0.01
"""Smaller errors have one colour [m]."""


class Report(NamedTuple):
    """All that was driven."""

    command: str
    conditions: Conditions
    courses: Sequence[Course]
    cases: Sequence[str]
    cells: Sequence[Cell]
    """Case after case, the roads of each in order."""

    @property
    def roads(self) -> list[str]:
        """Names of the roads."""
        return [course.scenario.name for course in self.courses]

    def rows(self) -> Iterator[tuple[str, Sequence[Cell]]]:
        """Give each case with its cells."""
        count = len(self.courses)
        for i, case in enumerate(self.cases):
            yield case, self.cells[i * count : (i + 1) * count]


def shared(conditions: Conditions) -> str:
    """Say in words what all cells share."""
    vehicle = Path(conditions.vehicle).stem
    driver = (
        "the driver brakes when asked to" if conditions.obey else "nobody obeys the stop request"
    )
    return (
        f"{conditions.controller}, vehicle {vehicle}, guard {Path(conditions.guard).stem}, "
        f"{driver}, seed {conditions.seed}"
    )


def legend() -> str:
    """Say what the numbers are."""
    return (
        "largest cross-track error from the start of the fault on [m], and time from its end until "
        f"the car is within {NEAR:g} m of its path (or {EXTRA:g} m more than without the fault) "
        f"and steered by the top of the ladder for good; lost: more than {LOST:g} m off the path"
    )


def summary(cell: Cell) -> str:
    """Give error and recovery."""
    return f"{cell.max_error:.2f} m, {cell.outcome}" if cell.kept else cell.outcome


def remarks(report: Report) -> list[str]:
    """Say which cells are no recovery, and why."""
    return [
        f"{cell.case}, {cell.scenario}: {cell.outcome}, largest error {cell.max_error:.2f} m: "
        f"{cell.allowed_reason or 'must not be'}"
        for cell in report.cells
        if not cell.kept
    ]


def table_of(report: Report) -> Table:
    """Lay the matrix out for the terminal."""
    caption = "\n".join([legend(), *remarks(report)])
    table = Table(title=Text(shared(report.conditions)), caption=Text(caption))
    table.title_justify = table.caption_justify = "left"
    table.add_column("fault", no_wrap=True)
    for road in report.roads:
        table.add_column(Text(road), justify="right")
    free = [f"{_free(course):.2f} m" for course in report.courses]
    table.add_row("no fault", *free, style="dim", end_section=True)
    for case, cells in report.rows():
        table.add_row(case, *(Text(summary(each), style=_style(each)) for each in cells))
    return table


def _free(course: Course) -> float:
    """Largest error without a fault, from where the faults begin [m]."""
    log = course.free
    return float(abs(log.error[log.time >= course.start]).max())


def _style(cell: Cell) -> str:
    return "red" if cell.fails else "yellow" if not cell.kept else ""


def markdown(report: Report) -> str:
    """Write matrices and causes."""
    cells = report.cells
    lines = [
        "# Faults and scenarios",
        "",
        f"`{report.command}`: {shared(report.conditions)}; AMPC for ROS 2 {__version__}. "
        f"{len(report.cases)} faults on {len(report.courses)} roads. Each fault starts where the "
        "road asks for the largest lateral acceleration. "
        f"{sum(each.kept for each in cells)} of {len(cells)} cells recover, "
        f"{sum(each.fails for each in cells)} fail.",
    ]
    said = remarks(report)
    lines += ["", "## Not recovered", "", *(f"* {line}" for line in said)] if said else []
    lines += ["", "## Error and recovery", "", f"{legend().capitalize()}.", "", *_matrix(report)]
    lines += ["", "## What was seen", "", "All roads together.", "", *_seen(report)]
    return "\n".join(lines) + "\n"


def _row(texts: Sequence[str]) -> str:
    return "| " + " | ".join(texts) + " |"


def _matrix(report: Report) -> Iterator[str]:
    yield _row(["fault", *report.roads])
    yield "|---" + "|---:" * len(report.roads) + "|"
    yield _row(["start of the fault", *(f"{course.start:g} s" for course in report.courses)])
    yield _row(["no fault", *(f"{_free(course):.2f} m" for course in report.courses)])
    for case, cells in report.rows():
        yield _row([case, *(summary(cell) for cell in cells)])


def _seen(report: Report) -> Iterator[str]:
    """Give time on the rungs below the top, reasons, refused inputs and clipped commands."""
    below = RUNGS[1:]
    yield _row(["fault", *(f"{rung} [s]" for rung in below), "reasons", "refused inputs", "clips"])
    yield "|---" + "|---:" * len(below) + "|---|---|---|"
    for case, cells in report.rows():
        times = [f"{sum(cell.rungs[rung] for cell in cells):.1f}" for rung in below]
        reasons = sorted({reason for cell in cells for reason in cell.reasons})
        yield _row([case, *times, ", ".join(reasons), *(_counts(cells, n) for n in COUNTS)])


COUNTS = ("rejected", "clips")


def _counts(cells: Sequence[Cell], name: str) -> str:
    total: Counter[str] = Counter()
    for cell in cells:
        total.update(getattr(cell, name))
    return ", ".join(f"{cause} {n}" for cause, n in total.most_common())


def content(report: Report) -> dict[str, Any]:
    """Give all numbers, and what is needed to repeat them, for JSON."""
    return {
        "version": __version__,
        "command": report.command,
        "machine": describe_machine(),
        "conditions": report.conditions._asdict(),
        "lost_beyond_m": LOST,
        "faults": {case.name: _fault(case) for case in CASES if case.name in report.cases},
        "scenarios": {
            course.scenario.name: {
                "duration_s": course.scenario.duration,
                "start_of_fault_s": course.start,
            }
            for course in report.courses
        },
        "cells": [_cell(cell) for cell in report.cells],
    }


def _fault(case: Any) -> dict[str, Any]:
    fault = case.fault
    return {"kind": fault.kind, "duration": fault.duration, "amount": fault.amount}


def _cell(cell: Cell) -> dict[str, Any]:
    """Give a cell; what is not a number is null."""
    values = cell._asdict() | {"kept": cell.kept}
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in values.items()
    }


def heat_map(report: Report) -> Figure:
    """Draw the largest errors, with the times of recovery."""
    squares = [[_square(cell) for cell in cells] for _, cells in report.rows()]
    title = (
        "largest cross-track error [m] and recovery after the end of the fault [s]\n"
        f"{shared(report.conditions)}"
    )
    return draw_heat_map(title, report.cases, report.roads, squares, MARGIN)


def _square(cell: Cell) -> HeatCell:
    if not cell.kept:
        return HeatCell(cell.outcome, hatch="xxx" if cell.fails else "////")
    return HeatCell(f"{cell.max_error:.2f}    {cell.outcome}", max(cell.max_error, FINEST))


def write(report: Report, folder: Path) -> None:
    """Write all files into a folder that is there."""
    found = json.dumps(content(report), indent=1, allow_nan=False) + "\n"
    (folder / "faults.json").write_text(found, encoding="utf-8")
    (folder / "faults.md").write_text(markdown(report), encoding="utf-8")
    save_png(heat_map(report), folder / "faults.png")
    reduce_colors(folder / "faults.png")


def reduce_colors(file: Path) -> None:
    """Write a picture again with a palette: a third of the bytes, and no difference to the eye."""
    with Image.open(file) as picture:
        picture.convert("RGB").quantize(COLORS).save(file, optimize=True)
