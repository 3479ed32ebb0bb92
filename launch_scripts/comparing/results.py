"""Results of a comparison: terminal table, page, JSON, Markdown, CSV and figures."""

import csv
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup
from matplotlib.figure import Figure
from rich.markup import escape
from rich.table import Table

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find
from ampc_msgs_config.metrics import LOST, METRICS
from ampc_msgs_config.scenarios.scenario import Scenario
from launch_scripts.comparing.cells import Cell, Contender, best_of
from launch_scripts.comparing.conditions import COMPARED_METRICS, Conditions
from launch_scripts.comparing.figures import colors_of, draw_compared_road
from launch_scripts.reporting.heat_map import HeatCell, draw_heat_map
from launch_scripts.reporting.pages import data, markdown_table, render, terminal_table, to_json
from launch_scripts.reporting.style import save_figures, save_png, svg
from launch_scripts.run.machine import describe_machine

REMARKS = {
    "max_lateral_acceleration": "Speed times yaw rate, which mostly follows from the road.",
    "solve_time_p50_us": "Wall time of one step() called from Python under the current load of the "
    "machine. It is an order of magnitude, not a benchmark (see `make bench`), and the only "
    "quantity that another run does not reproduce.",
}
"""Explanations by metric."""


class Shown(NamedTuple):
    """One cell of the table of a metric."""

    cell: Cell
    text: str
    """Number of a completed drive, else its outcome."""
    is_best: bool
    """Whether the number is the smallest of its scenario."""


class Comparison(NamedTuple):
    """All drives of one run of `compare`."""

    command: str
    conditions: Conditions
    contenders: list[Contender]
    scenarios: list[Scenario]
    cells: list[Cell]
    """Scenario by scenario, the contenders of each in order."""

    @property
    def labels(self) -> list[str]:
        """Labels of the contenders."""
        return [contender.label for contender in self.contenders]

    @property
    def setting(self) -> str:
        """Common conditions in words."""
        vehicle, _, friction, delay, noise, seed = self.conditions
        words = [
            f"vehicle {Path(vehicle).stem}",
            "friction of the tyres" if friction is None else f"friction {friction:g}",
            f"noise {noise}, seed {seed}" if noise else "no noise",
        ]
        return ", ".join(words + [f"{delay:g} s of unknown steering delay"] * (delay != 0.0))

    def rows(self, key: str) -> Iterator[tuple[str, list[Shown]]]:
        """Yield the name of each scenario with its cells for a metric."""
        count = len(self.contenders)
        for i, scenario in enumerate(self.scenarios):
            cells = self.cells[i * count : (i + 1) * count]
            best, shown = best_of(cells, key), []
            for cell in cells:
                text = three_digits(cell.numbers[key]) if cell.kept else cell.outcome
                shown.append(Shown(cell, text, cell.contender in best))
            yield scenario.name, shown

    def remarks(self, lost: bool = True) -> list[str]:
        """Return one line for each lost car, then one for each controller that ended its drive."""
        gone, ended = [], []
        for cell in self.cells:
            line = f"{cell.scenario}, {cell.contender}: {cell.outcome}"
            if cell.reason:
                ended.append(f"{line}: {cell.reason}")
            elif lost and not cell.kept:
                largest = three_digits(cell.numbers["max_error_m"])
                gone.append(f"{line}, largest error {largest} m")
        return gone + ended


def heading_of(key: str) -> str:
    """Return title and unit of a metric."""
    return f"{METRICS[key].title} [{METRICS[key].unit}]"


def three_digits(value: float) -> str:
    """Return three significant digits, without an exponent from 1e-4 to 1e4."""
    if value == 0 or not 1e-4 <= abs(value) < 1e4:
        return f"{value:.3g}"
    return f"{value:.{max(2 - math.floor(math.log10(abs(value))), 0)}f}"


def comparison_table(comparison: Comparison, key: str) -> Table:
    """Return one metric as a table for the terminal."""
    heads = ["scenario", *(label.replace("=", "=\n") for label in comparison.labels)]
    rows = [
        [name, *(f"{each.text} *" if each.is_best else f"{each.text}  " for each in cells)]
        for name, cells in comparison.rows(key)
    ]
    table = terminal_table(heads, rows, "lr", f"{heading_of(key)}; {comparison.setting}")
    legend = f"* smallest of its scenario; lost: cross-track error above {LOST:g} m"
    table.caption = "\n".join([legend, *map(escape, comparison.remarks(lost=False))])
    table.caption_justify = "left"
    return table


def write_comparison(
    comparison: Comparison, key: str, folder: Path, formats: Sequence[str] = ()
) -> list[str]:
    """Write page, JSON, Markdown, heat map and further formats; return the names of the files.

    Args:
        comparison: Content.
        key: Metric of the heat map.
        folder: Existing folder.
        formats: Any of csv, svg, pdf.
    """
    colors = colors_of(comparison.labels)
    figures = {"compare": draw_matrix(comparison, key)}
    for name, shown in comparison.rows(key):
        if any(each.cell.driven for each in shown):
            figures[f"compare_{name}"] = draw_compared_road([each.cell for each in shown], colors)
    content = to_json(comparison_json(comparison))
    texts = {
        "page.html": comparison_page(comparison, key, figures),
        "compare.json": json.dumps(content, indent=1, allow_nan=False) + "\n",
        "compare.md": comparison_markdown(comparison),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    save_png(figures["compare"], folder / "compare.png")
    files = [*texts, "compare.png"]
    if "csv" in formats:
        files.append("compare.csv")
        heads = [f"{key} [{METRICS[key].unit}]" for key in COMPARED_METRICS.values()]
        with (folder / "compare.csv").open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(["scenario", "controller", "outcome", *heads])
            for cell in comparison.cells:
                numbers = [
                    cell.numbers[key] if cell.kept else "" for key in COMPARED_METRICS.values()
                ]
                writer.writerow([cell.scenario, cell.contender, cell.outcome, *numbers])
    return files + [file.name for file in save_figures(figures, folder / "compare", formats)]


def draw_matrix(comparison: Comparison, key: str) -> Figure:
    """Return the heat map of a metric; the smallest value of a scenario has a frame."""
    squares = [
        [
            HeatCell(text, cell.numbers[key] if cell.kept else 0.0, cell.hatch, is_best)
            for cell, text, is_best in shown
        ]
        for _, shown in comparison.rows(key)
    ]
    names = [scenario.name for scenario in comparison.scenarios]
    labels = [name.replace("=", "=\n") for name in comparison.labels]
    return draw_heat_map(f"{heading_of(key)}\n{comparison.setting}", names, labels, squares)


def comparison_markdown(comparison: Comparison) -> str:
    """Return the tables of all metrics as Markdown."""
    lines = [
        "# Controllers and scenarios",
        "",
        f"`{comparison.command}`: {comparison.setting}; "
        f"AMPC for ROS 2 {__version__}. Every cell is a drive of the same car with the same seed. "
        "Errors are those of the true state, without measurement noise. Bold: smallest of its "
        f"scenario. Lost: cross-track error above {LOST:g} m at any time.",
    ]
    for key in COMPARED_METRICS.values():
        rows = [
            [name, *(f"**{each.text}**" if each.is_best else each.text for each in cells)]
            for name, cells in comparison.rows(key)
        ]
        lines += ["", f"## {heading_of(key)}", "", *([REMARKS[key], ""] if key in REMARKS else [])]
        lines += markdown_table(["scenario", *comparison.labels], rows)
    if comparison.remarks():
        lines += ["", "## Drives that were not completed", ""]
        lines += [f"* {line}" for line in comparison.remarks()]
    return "\n".join(lines) + "\n"


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return all numbers, and everything that is needed to reproduce them."""
    tables = [contender.gain_table for contender in comparison.contenders]
    gains = [find("gains", table).read_text(encoding="utf-8") if table else "" for table in tables]
    return {
        "version": __version__,
        "command": comparison.command,
        "machine": describe_machine(),
        "conditions": comparison.conditions._asdict(),
        "lost_beyond_m": LOST,
        "controllers": [
            {**contender._asdict(), "gains": text}
            for contender, text in zip(comparison.contenders, gains, strict=True)
        ],
        "scenarios": {s.name: {"duration_s": s.duration} for s in comparison.scenarios},
        "cells": [
            {
                "scenario": cell.scenario,
                "controller": cell.contender,
                "fate": cell.outcome,
                "reason": cell.reason,
                **cell.numbers,
            }
            for cell in comparison.cells
        ],
    }


def comparison_page(comparison: Comparison, key: str, figures: Mapping[str, Figure]) -> str:
    """Return the page with the figures of `write_comparison` and the metric of the heat map."""
    tables = []
    for each in COMPARED_METRICS.values():
        rows: list[list[str]] = []
        for name, shown in comparison.rows(each):
            rows.append([name])
            for cell, text, is_best in shown:
                value = data(cell.numbers[each], text) if cell.kept else text
                rows[-1].append(Markup("<b>{}</b>").format(value) if is_best else value)
        tables.append((heading_of(each), REMARKS.get(each, ""), rows))
    return render(
        "comparing/compare.html",
        comparison=comparison,
        lost=f"{LOST:g} m",
        title=METRICS[key].title,
        tables=tables,
        roads=list(comparison.rows("rms_error_m")),
        figures={name: svg(figure) for name, figure in figures.items()},
        version=__version__,
        machine={name: v for name, v in describe_machine().items() if name != "packages"},
    )
