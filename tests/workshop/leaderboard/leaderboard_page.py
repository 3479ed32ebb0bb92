"""Results of the leaderboard: terminal, Markdown, JSON and heat map."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from ampc_msgs_config import __version__
from launch_scripts.reporting.heat_map import HeatCell, draw_heat_map
from launch_scripts.reporting.pages import markdown_table, terminal_table, to_json
from launch_scripts.reporting.style import save_png
from launch_scripts.run.machine import describe_machine
from tests.workshop.fault_matrix.inject_report import reduce_colors
from tests.workshop.leaderboard.columns import COLUMNS, reason_of_loss
from tests.workshop.leaderboard.drives import LEFT, Result, Row

MARGIN = 3.6
"""Width of the row names of the heat map [inch]."""
FINEST = 0.001
"""Largest errors below this count as equal in the heat map [m]."""
MARKS = "Bold: smallest largest error of the row. Italic: lost by a controller of ours."
NUMBERS = "largest error [m] / RMS [m] / steering activity [deg per 0.1 s]"


class Board(NamedTuple):
    """All results of a run."""

    command: str
    columns: Sequence[str]
    cells: Mapping[Row, Mapping[str, Result]]

    @property
    def ours(self) -> list[str]:
        """Columns of the product."""
        return [name for name in self.columns if COLUMNS[name].is_ours]

    def reason(self, row: Row, name: str, *, at_centre: bool = False) -> str:
        """Return why a column of ours loses a row; empty: it wins, or does not drive it."""
        results = self.cells[row]
        if at_centre:
            results = {k: result._replace(max=result.centre) for k, result in results.items()}
        yardsticks = {k: result for k, result in results.items() if not COLUMNS[k].is_ours}
        return reason_of_loss(results[name], yardsticks) if name in results else ""

    def lost(self, name: str) -> list[Row]:
        """Return the rows that a column of ours loses."""
        return [row for row in self.cells if self.reason(row, name)]

    def groups(self) -> dict[tuple[str, str], list[Row]]:
        """Return the rows by disturbance and car."""
        groups: dict[tuple[str, str], list[Row]] = {}
        for row in self.cells:
            groups.setdefault((row.disturbance.name, row.car), []).append(row)
        return groups


def metres(value: float) -> str:
    """Return an error as text."""
    return f"{value:.3f}" if math.isfinite(value) else f"> {LEFT:g}"


def cell_text(result: Result) -> str:
    """Return the three numbers of a cell."""
    return f"{metres(result.max)} / {metres(result.rms)} / {result.activity:.2f}"


SUMMARY_HEADS = (
    *("controller", "rows", "lost", "by error", "by activity", "off the road"),
    "lost with all errors at the centre of gravity",
)


def summary(board: Board) -> Iterator[list[object]]:
    """Yield the counts of lost rows of each column of ours."""
    for name in board.ours:
        reasons = [board.reason(row, name) for row in board.lost(name)]
        active = sum("activity" in reason for reason in reasons)
        off = sum("leaves" in reason for reason in reasons)
        rows = sum(name in results for results in board.cells.values())
        yield [
            COLUMNS[name].title,
            rows,
            len(reasons),
            len(reasons) - active - off,
            active,
            off,
            sum(bool(board.reason(row, name, at_centre=True)) for row in board.cells),
        ]


LOST_HEADS = ("lost row", "controller", "largest error [m]", "activity [deg]", "because")


def lost_rows(board: Board) -> Iterator[list[str]]:
    """Yield the lost rows of the columns that decide."""
    for name in board.ours:
        if COLUMNS[name].decides:
            for row in board.lost(name):
                result = board.cells[row][name]
                numbers = [metres(result.max), f"{result.activity:.2f}"]
                yield [str(row), name, *numbers, board.reason(row, name)]


def screen_tables(board: Board) -> list[Table]:
    """Return the tables for the terminal."""
    return [
        terminal_table(LOST_HEADS, lost_rows(board), "llrrl"),
        terminal_table(SUMMARY_HEADS, [list(map(str, row)) for row in summary(board)], "lr"),
    ]


def page(board: Board, picture: str) -> str:
    """Return the leaderboard as Markdown."""
    lines = [
        "# Leaderboard",
        "",
        f"`{board.command}`, AMPC for ROS 2 {__version__}: the shipped controllers and published "
        "yardsticks with the same cars, roads and disturbances, all unknown to them. `preview` and "
        "`preview_50hz` have their default configuration; nothing of the actuator is configured. "
        "The gains of the preview LQ, the kinematic MPC and Stanley were chosen once, on two of "
        "the roads; those of the MPC with lag and delay are published.",
        "",
        "A controller of ours wins a row if no yardstick has a smaller largest error, by more than "
        "1 mm and 2 %, and if its steering activity is at most 1.5 times that of the best "
        "yardstick. The complete rule and the sources of the yardsticks are in "
        "`tests/workshop/leaderboard/`.",
        "",
        *markdown_table(SUMMARY_HEADS, summary(board)),
        "",
        f"![Largest error relative to the best controller]({picture})",
        "",
        "The colour is the largest error relative to the smallest one of its row, without the "
        "configured controllers: the geometric mean over the roads. Framed: rows are lost. "
        f"Hatched: the car leaves the road, by more than {LEFT:g} m, on at least one road.",
        "",
        "## Yardsticks",
        "",
        *(
            f"* `{name}`: {COLUMNS[name].source}"
            for name in board.columns
            if name not in board.ours
        ),
        "",
        "## Lost rows",
        "",
        *(markdown_table(LOST_HEADS, lost_rows(board), "lrrl")),
    ]
    for name in dict.fromkeys(row.disturbance.name for row in board.cells):
        rows = [row for row in board.cells if row.disturbance.name == name]
        lines += ["", f"## {name.capitalize()}", "", f"{NUMBERS.capitalize()}. {MARKS}", ""]
        texts = [[f"{row.road}, {row.car}", *_texts(board, row)] for row in rows]
        lines += markdown_table(["row", *board.columns], texts)
    return "\n".join(lines) + "\n"


def _texts(board: Board, row: Row) -> Iterator[str]:
    """Yield the cells of a row; bold: smallest largest error; italic: a lost row of ours."""
    results = board.cells[row]
    best = min(result.max for result in results.values())
    for name in board.columns:
        if name not in results:
            yield ""
            continue
        text = cell_text(results[name])
        text = f"**{text}**" if results[name].max == best else text
        yield f"*{text}*" if name in board.ours and board.reason(row, name) else text


def heat_map(board: Board) -> Figure:
    """Return the largest errors relative to the best of each row, means over the roads."""
    groups = board.groups()
    names = [f"{disturbance}, {car}" for disturbance, car in groups]
    cells = [[_heat_cell(board, rows, name) for name in board.columns] for rows in groups.values()]
    titles = [name.replace("_", "\n") for name in board.columns]
    title = "largest cross-track error relative to the best controller; lost rows of ours"
    return draw_heat_map(title, names, titles, cells, MARGIN)


def _heat_cell(board: Board, rows: Sequence[Row], name: str) -> HeatCell:
    """Return the cell of a column for all roads of a disturbance and a car."""
    errors = [board.cells[row][name].max for row in rows if name in board.cells[row]]
    if not errors:
        return HeatCell("", hatch=" ")
    lost = sum(bool(board.reason(row, name)) for row in rows) if name in board.ours else 0
    lost_text = f"{lost}/{len(rows)} lost" if lost else ""
    off = sum(not math.isfinite(error) for error in errors)
    if off:
        return HeatCell(lost_text or f"{off}/{len(rows)} off", hatch="////", framed=lost > 0)
    ratio = [
        math.log(max(e, FINEST) / _best(board, row)) for e, row in zip(errors, rows, strict=True)
    ]
    mean = math.exp(float(np.mean(ratio)))
    return HeatCell(f"{mean:.1f}  {lost_text}".strip(), mean, framed=lost > 0)


def _best(board: Board, row: Row) -> float:
    """Return the smallest largest error of a row without configured controllers [m]."""
    results = board.cells[row].items()
    return max(min(r.max for name, r in results if not COLUMNS[name].configured), FINEST)


def content(board: Board) -> dict[str, Any]:
    """Return all results as JSON values."""
    return {
        "version": __version__,
        "command": board.command,
        "machine": describe_machine(),
        "columns": {name: COLUMNS[name].title for name in board.columns},
        "lost": {name: [str(row) for row in board.lost(name)] for name in board.ours},
        "rows": [
            {
                "road": row.road,
                "car": row.car,
                "disturbance": row.disturbance.name,
                **{name: result._asdict() for name, result in results.items()},
                "reasons": {name: board.reason(row, name) for name in board.ours},
            }
            for row, results in board.cells.items()
        ],
    }


def read_yardsticks(file: File, rows: Sequence[Row]) -> dict[Row, dict[str, Result]]:
    """Return the cells of the yardsticks of an earlier run, as far as it has them.

    Raises:
        ValueError: The file is not the JSON file of a leaderboard.
    """
    try:
        stored = json.loads(file.read_text(encoding="utf-8"))["rows"]
        found = {(each["road"], each["car"], each["disturbance"]): each for each in stored}
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{file}: not a leaderboard: {error}") from error
    names = [name for name, column in COLUMNS.items() if not column.is_ours]
    cells: dict[Row, dict[str, Result]] = {}
    for row in rows:
        results = found.get((row.road, row.car, row.disturbance.name), {})
        cells[row] = {name: _result(results[name]) for name in names if name in results}
    return cells


def _result(numbers: Mapping[str, float | None]) -> Result:
    """Return a cell of JSON values; null is infinite."""
    return Result(**{key: math.inf if v is None else v for key, v in numbers.items()})


def write_page(board: Board, file: File) -> None:
    """Write the page, and its picture next to it."""
    picture = file.with_suffix(".png")
    file.write_text(page(board, picture.name), encoding="utf-8")
    save_png(heat_map(board), picture)
    reduce_colors(picture)


def write_json(board: Board, file: File) -> None:
    """Write all numbers as JSON."""
    text = json.dumps(to_json(content(board)), indent=1, allow_nan=False) + "\n"
    file.write_text(text, encoding="utf-8")
