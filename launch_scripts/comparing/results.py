"""Results of a comparison: terminal table, page, JSON, Markdown, CSV and figures."""

import csv
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup
from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find
from ampc_msgs_config.metrics import LOST, METRICS
from ampc_msgs_config.scenarios.scenario import Scenario
from launch_scripts.comparing.cells import QUANTITIES, Cell, Conditions, Contender, best_of
from launch_scripts.comparing.figures import colors_of, draw_scenario
from launch_scripts.reporting.heat_map import HeatCell, draw_heat_map
from launch_scripts.reporting.markdown import markdown_table
from launch_scripts.reporting.pages import data, render
from launch_scripts.reporting.style import save_figures, save_png, svg
from launch_scripts.run.machine import describe_machine

MARK = "*"
"""Mark of the smallest number of a scenario in the terminal."""
NOTES = {
    "max_lateral_acceleration": "Speed times yaw rate, which mostly follows from the road.",
    "solve_time_p50_us": "Wall time of one step() called from Python under the current load of the "
    "machine. It is an order of magnitude, not a benchmark (see `make bench`), and the only "
    "quantity that another run does not reproduce.",
}
"""Explanations by metric."""


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

    def rows(self) -> Iterator[tuple[str, list[Cell]]]:
        """Yield the name of each scenario with its cells."""
        count = len(self.contenders)
        for i, scenario in enumerate(self.scenarios):
            yield scenario.name, self.cells[i * count : (i + 1) * count]

    def marked_rows(self, key: str) -> Iterator[tuple[str, list[tuple[Cell, bool]]]]:
        """Yield the same rows, each cell with a flag that marks the smallest value."""
        for name, cells in self.rows():
            best = best_of(cells, key)
            yield name, [(cell, cell.contender in best) for cell in cells]


def heading_of(key: str) -> str:
    """Return title and unit of a metric."""
    return f"{METRICS[key].title} [{METRICS[key].unit}]"


def number_or_outcome(cell: Cell, key: str) -> str:
    """Return the number of a completed drive, else its outcome."""
    return three_digits(cell.numbers[key]) if cell.kept else cell.outcome


def three_digits(value: float) -> str:
    """Return three significant digits, without an exponent from 1e-4 to 1e4."""
    if value == 0 or not 1e-4 <= abs(value) < 1e4:
        return f"{value:.3g}"
    return f"{value:.{max(2 - math.floor(math.log10(abs(value))), 0)}f}"


def describe_conditions(conditions: Conditions) -> str:
    """Return the common conditions in words."""
    friction = conditions.friction
    road = "friction of the tyres" if friction is None else f"friction {friction:g}"
    noise = f"noise {conditions.noise}, seed {conditions.seed}" if conditions.noise else "no noise"
    words = [f"vehicle {Path(conditions.vehicle).stem}", road, noise]
    if conditions.delay:
        words.append(f"{conditions.delay:g} s of unknown steering delay")
    return ", ".join(words)


def remarks(comparison: Comparison) -> list[str]:
    """Return one line for each lost car, then one for each controller that ended its drive."""
    lost = [
        f"{cell.scenario}, {cell.contender}: {cell.outcome}, largest error "
        f"{three_digits(cell.numbers['max_error_m'])} m"
        for cell in comparison.cells
        if cell.numbers and not cell.kept
    ]
    return lost + reasons(comparison)


def reasons(comparison: Comparison) -> list[str]:
    """Return one line for each controller that ended its drive."""
    return [
        f"{cell.scenario}, {cell.contender}: {cell.outcome}: {cell.reason}"
        for cell in comparison.cells
        if cell.reason
    ]


def terminal_table(comparison: Comparison, key: str) -> Table:
    """Return one metric as a table for the terminal."""
    legend = f"{MARK} smallest of its scenario; lost: cross-track error above {LOST:g} m"
    title = f"{heading_of(key)}; {describe_conditions(comparison.conditions)}"
    caption = Text("\n".join([legend, *reasons(comparison)]))
    table = Table(title=Text(title), caption=caption, title_justify="left")
    table.caption_justify = "left"
    table.add_column("scenario", no_wrap=True)
    for label in comparison.labels:
        table.add_column(Text(label.replace("=", "=\n")), justify="right", overflow="fold")
    for name, cells in comparison.marked_rows(key):
        texts = [f"{number_or_outcome(cell, key)} {MARK if best else ' '}" for cell, best in cells]
        colors = ["bold green" if best else "" if cell.kept else "red" for cell, best in cells]
        table.add_row(Text(name), *map(Text, texts, colors))
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
    matrix, roads = draw_matrix(comparison, key), road_figures(comparison)
    page = comparison_page(comparison, key, svg(matrix), {k: svg(f) for k, f in roads.items()})
    content = json.dumps(comparison_json(comparison), indent=1, allow_nan=False) + "\n"
    texts = {
        "page.html": page,
        "compare.json": content,
        "compare.md": comparison_markdown(comparison),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    save_png(matrix, folder / "compare.png")
    files = [*texts, "compare.png"]
    if "csv" in formats:
        write_cells(comparison, folder / "compare.csv")
        files.append("compare.csv")
    figures = {"compare": matrix} | {f"compare_{name}": each for name, each in roads.items()}
    return files + [file.name for file in save_figures(figures, folder / "compare", formats)]


def draw_matrix(comparison: Comparison, key: str) -> Figure:
    """Return the heat map of a metric; the smallest value of a scenario has a frame."""
    squares = [
        [
            HeatCell(
                number_or_outcome(cell, key),
                cell.numbers[key] if cell.kept else 0.0,
                hatch="" if cell.kept else "////" if cell.numbers else "xxx",
                framed=best,
            )
            for cell, best in cells
        ]
        for _, cells in comparison.marked_rows(key)
    ]
    title = f"{heading_of(key)}\n{describe_conditions(comparison.conditions)}"
    names = [scenario.name for scenario in comparison.scenarios]
    labels = [name.replace("=", "=\n") for name in comparison.labels]
    return draw_heat_map(title, names, labels, squares)


def road_figures(comparison: Comparison) -> dict[str, Figure]:
    """Return the figure of each scenario that at least one controller has driven."""
    colors = colors_of(comparison.labels)
    return {
        name: draw_scenario(cells, colors)
        for name, cells in comparison.rows()
        if any(cell.driven for cell in cells)
    }


def write_cells(comparison: Comparison, file: Path) -> None:
    """Write one row per cell; metrics of drives that were not completed are empty."""
    heads = [f"{key} [{METRICS[key].unit}]" for key in QUANTITIES.values()]
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["scenario", "controller", "outcome", *heads])
        for cell in comparison.cells:
            numbers = [cell.numbers[key] if cell.kept else "" for key in QUANTITIES.values()]
            writer.writerow([cell.scenario, cell.contender, cell.outcome, *numbers])


def comparison_markdown(comparison: Comparison) -> str:
    """Return the tables of all metrics as Markdown."""
    lines = [
        "# Controllers and scenarios",
        "",
        f"`{comparison.command}`: {describe_conditions(comparison.conditions)}; "
        f"AMPC for ROS 2 {__version__}. Every cell is a drive of the same car with the same seed. "
        "Errors are those of the true state, without measurement noise. Bold: smallest of its "
        f"scenario. Lost: cross-track error above {LOST:g} m at any time.",
    ]
    for key in QUANTITIES.values():
        lines += ["", f"## {heading_of(key)}", ""]
        lines += [NOTES[key], ""] if key in NOTES else []
        rows = [
            [name, *(bold(number_or_outcome(cell, key), best) for cell, best in cells)]
            for name, cells in comparison.marked_rows(key)
        ]
        lines += markdown_table(["scenario", *comparison.labels], rows)
    if remarks(comparison):
        lines += ["", "## Drives that were not completed", ""]
        lines += [f"* {line}" for line in remarks(comparison)]
    return "\n".join(lines) + "\n"


def bold(text: str, best: bool) -> str:
    """Return text in Markdown, bold for the smallest number."""
    return f"**{text}**" if best else text


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return all numbers, and everything that is needed to reproduce them."""
    cells, controllers = [], []
    for cell in comparison.cells:
        numbers = {key: v if math.isfinite(v) else None for key, v in cell.numbers.items()}
        names = {"scenario": cell.scenario, "controller": cell.contender, "fate": cell.outcome}
        cells.append({**names, "reason": cell.reason, **numbers})
    for contender in comparison.contenders:
        table = contender.gain_table
        gains = find("gains", table).read_text(encoding="utf-8") if table else ""
        controllers.append({**contender._asdict(), "gains": gains})
    return {
        "version": __version__,
        "command": comparison.command,
        "machine": describe_machine(),
        "conditions": comparison.conditions._asdict(),
        "lost_beyond_m": LOST,
        "controllers": controllers,
        "scenarios": {s.name: {"duration_s": s.duration} for s in comparison.scenarios},
        "cells": cells,
    }


def comparison_page(comparison: Comparison, key: str, matrix: str, roads: dict[str, str]) -> str:
    """Return the page.

    Args:
        comparison: Content.
        key: Metric of the heat map.
        matrix: SVG text of the heat map.
        roads: SVG text of each driven scenario.
    """
    conditions = comparison.conditions
    run = {
        "command": comparison.command,
        **{name: str(v) for name, v in conditions._asdict().items() if v not in (None, "")},
        **{
            c.label: f"{c.controller}, gains {c.gain_table or 'none'}"
            for c in comparison.contenders
        },
        "version": f"AMPC for ROS 2 {__version__}",
        **{name: str(v) for name, v in describe_machine().items() if name != "packages"},
    }
    return render(
        "comparing/compare.html",
        comparison=comparison,
        conditions=describe_conditions(conditions),
        lost=f"{LOST:g} m",
        title=METRICS[key].title,
        matrix=matrix,
        remarks=remarks(comparison),
        tables=[
            (heading_of(each), NOTES.get(each, ""), table_rows(comparison, each))
            for each in QUANTITIES.values()
        ],
        roads=[
            (name, roads.get(name), sorted(best_of(cells, "rms_error_m")), cells)
            for name, cells in comparison.rows()
        ],
        run=list(run.items()),
    )


def table_rows(comparison: Comparison, key: str) -> list[list[str]]:
    """Return the rows of one metric for the page."""
    rows: list[list[str]] = []
    for name, cells in comparison.marked_rows(key):
        rows.append([name])
        for cell, best in cells:
            if cell.kept:
                value = data(cell.numbers[key], three_digits(cell.numbers[key]))
                rows[-1].append(Markup("<b>{}</b>").format(value) if best else value)
            else:
                rows[-1].append(cell.outcome)
    return rows
