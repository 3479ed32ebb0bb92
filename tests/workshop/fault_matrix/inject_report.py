"""Reports of the fault matrix: terminal, Markdown, JSON and heat map."""

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
"""Margin of the heat map for the names of the faults [inch]."""
COLORS = 96
"""Number of colours of the picture."""
FINEST = 0.01
"""Error below which all cells have the same colour [m]."""


class FaultReport(NamedTuple):
    """All results of a run."""

    command: str
    conditions: Conditions
    courses: Sequence[Course]
    cases: Sequence[str]
    cells: Sequence[Cell]
    """Cells ordered by case, then by road."""

    @property
    def roads(self) -> list[str]:
        """Names of the roads."""
        return [course.scenario.name for course in self.courses]

    def rows(self) -> Iterator[tuple[str, Sequence[Cell]]]:
        """Yield each case with its cells."""
        count = len(self.courses)
        for i, case in enumerate(self.cases):
            yield case, self.cells[i * count : (i + 1) * count]


def describe_conditions(conditions: Conditions) -> str:
    """Return the settings of all cells as text."""
    vehicle = Path(conditions.vehicle).stem
    driver = (
        "the driver obeys the stop request" if conditions.obey else "the stop request is ignored"
    )
    gate = "with the gate" if conditions.gated else "without the gate"
    return (
        f"{conditions.controller}, vehicle {vehicle}, guard {Path(conditions.guard).stem}, {gate}, "
        f"{driver}, seed {conditions.seed}"
    )


def legend() -> str:
    """Return the meaning of the numbers."""
    return (
        "largest cross-track error after the start of the fault [m], and time from its end until "
        f"the car is within {NEAR:g} m of its path (or {EXTRA:g} m more than without the fault) "
        f"and steered by the optimal plan permanently; lost: error above {LOST:g} m"
    )


def summary(cell: Cell) -> str:
    """Return error and recovery as text."""
    return f"{cell.max_error:.2f} m, {cell.outcome}" if cell.kept else cell.outcome


def remarks(report: FaultReport) -> list[str]:
    """Return the cells without recovery, and why they are allowed."""
    return [
        f"{cell.case}, {cell.scenario}: {cell.outcome}, largest error {cell.max_error:.2f} m: "
        f"{cell.allowed_reason or 'not allowed'}"
        for cell in report.cells
        if not cell.kept
    ]


def screen_table(report: FaultReport) -> Table:
    """Format the matrix for the terminal."""
    caption = "\n".join([legend(), *remarks(report)])
    table = Table(title=Text(describe_conditions(report.conditions)), caption=Text(caption))
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
    """Return the largest error without a fault, after the start of the faults [m]."""
    log = course.free
    return float(abs(log.error[log.time >= course.start]).max())


def _style(cell: Cell) -> str:
    return "red" if cell.fails else "yellow" if not cell.kept else ""


def report_markdown(report: FaultReport) -> str:
    """Return the matrix and the reactions as Markdown."""
    cells = report.cells
    lines = [
        "# Faults and scenarios",
        "",
        f"`{report.command}`: {describe_conditions(report.conditions)}; "
        f"AMPC for ROS 2 {__version__}. {len(report.cases)} faults on "
        f"{len(report.courses)} roads. Each fault starts where lateral acceleration is largest. "
        f"{sum(each.kept for each in cells)} of {len(cells)} cells recover, "
        f"{sum(each.fails for each in cells)} fail.",
    ]
    unrecovered = remarks(report)
    lines += (
        ["", "## Not recovered", "", *(f"* {line}" for line in unrecovered)] if unrecovered else []
    )
    lines += ["", "## Error and recovery", "", f"{legend().capitalize()}.", "", *_matrix(report)]
    lines += [
        "",
        "## Reactions of the controller",
        "",
        "Sum over all roads.",
        "",
        *_reactions(report),
    ]
    return "\n".join(lines) + "\n"


def _row(texts: Sequence[str]) -> str:
    return "| " + " | ".join(texts) + " |"


def _matrix(report: FaultReport) -> Iterator[str]:
    yield _row(["fault", *report.roads])
    yield "|---" + "|---:" * len(report.roads) + "|"
    yield _row(["start of the fault", *(f"{course.start:g} s" for course in report.courses)])
    yield _row(["no fault", *(f"{_free(course):.2f} m" for course in report.courses)])
    for case, cells in report.rows():
        yield _row([case, *(summary(cell) for cell in cells)])


def _reactions(report: FaultReport) -> Iterator[str]:
    """Yield time in each fallback, reasons, rejected inputs and clipped commands."""
    below = RUNGS[1:]
    yield _row(["fault", *(f"{rung} [s]" for rung in below), "reasons", "rejected inputs", "clips"])
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


def report_to_json(report: FaultReport) -> dict[str, Any]:
    """Return all results, and the settings to reproduce them, as JSON values."""
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
    """Return a cell as JSON values; NaN is null."""
    values = cell._asdict() | {"kept": cell.kept}
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in values.items()
    }


def heat_map(report: FaultReport) -> Figure:
    """Draw a heat map of the largest errors with the times of recovery."""
    squares = [[_square(cell) for cell in cells] for _, cells in report.rows()]
    title = (
        "largest cross-track error [m] and recovery after the end of the fault [s]\n"
        f"{describe_conditions(report.conditions)}"
    )
    return draw_heat_map(title, report.cases, report.roads, squares, MARGIN)


def _square(cell: Cell) -> HeatCell:
    if not cell.kept:
        return HeatCell(cell.outcome, hatch="xxx" if cell.fails else "////")
    return HeatCell(f"{cell.max_error:.2f}    {cell.outcome}", max(cell.max_error, FINEST))


def write_report(report: FaultReport, folder: Path) -> None:
    """Write all files into an existing folder."""
    text = json.dumps(report_to_json(report), indent=1, allow_nan=False) + "\n"
    (folder / "faults.json").write_text(text, encoding="utf-8")
    (folder / "faults.md").write_text(report_markdown(report), encoding="utf-8")
    save_png(heat_map(report), folder / "faults.png")
    reduce_colors(folder / "faults.png")


def reduce_colors(file: Path) -> None:
    """Write a picture with a palette, which needs a third of the bytes."""
    with Image.open(file) as picture:
        picture.convert("RGB").quantize(COLORS).save(file, optimize=True)
