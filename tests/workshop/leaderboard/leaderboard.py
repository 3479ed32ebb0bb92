"""Leaderboard: drive the shipped controllers and published yardsticks under equal conditions.

`make leaderboard`, or `python -m tests.workshop.leaderboard.leaderboard`; `--rows noise`, `--cars
ordinary`, `--roads sc1` and `--columns preview preview_lq` select a part; `--reuse
runs/leaderboard/leaderboard.json` takes the yardsticks of an earlier run. A row is a road, a car
and a disturbance that no controller knows.

Rule of winning, of 2026-11-28. It is not changed afterwards:

* The error of a controller is that of the point that it guides along the path: the centre of
  gravity; the rear axle for the MPC with lag and for pure pursuit; the front axle for Stanley.
* With noise, error and activity are means over three seeds. With a start aside, errors count from
  4 s on. A car that is more than 5 m from its path has left the road: its error is infinite.
* A yardstick beats a controller in a row if its largest error is smaller by more than 1 mm and by
  more than 2 %.
* A controller of ours wins a row if it stays on the road, no yardstick beats it, and its steering
  activity is at most 1.5 times that of the best yardstick, which is the one with the smallest
  largest error. If every yardstick leaves the road, staying on it is enough.
* The activity is the RMS change of the commanded wheel angle within 0.1 s, at all times.

`preview` and `preview_50hz` know nothing of the actuator, like the yardsticks. The columns
`configured` know its rate, lag and delay; they are driven where it is not ideal, and compete, too.

Exit code 0: no row is lost by `preview` or `preview_50hz`; 1: some are; 2: wrong option.
"""

import argparse
import shlex
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path as File

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from launch_scripts.run.options import create_folder, naming
from tests.workshop.leaderboard.columns import COLUMNS, compile_for, drive_cell
from tests.workshop.leaderboard.drives import CARS, ROADS, Result, Row, all_rows
from tests.workshop.leaderboard.leaderboard_page import (
    Board,
    read_yardsticks,
    screen_tables,
    write_json,
    write_page,
)

WIDTH = 140
"""Minimum width of the printed tables [characters]."""
LOST, WRONG = 1, 2
"""Exit codes."""


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    text = "rows whose disturbance contains one of these texts, such as noise or 'delay 100'"
    add("--rows", nargs="+", metavar="TEXT", default=[], help=f"{text}; default: all")
    add("--cars", nargs="+", choices=CARS, default=CARS, help="cars; default: all")
    add("--roads", nargs="+", choices=ROADS, default=ROADS, help="roads; default: all")
    add("--columns", nargs="+", choices=COLUMNS, default=COLUMNS, help="columns; default: all")
    add("--output", type=File, default=File("runs/leaderboard"), help="folder; %(default)s")
    add("--workers", type=int, default=2, help="number of processes; default: %(default)s")
    text = "take the yardsticks of an earlier run from its leaderboard.json, do not drive them"
    add("--reuse", type=File, metavar="FILE", help=text)
    text = "also write the page and its picture here, such as ampc_ros/doc/leaderboard.md"
    add("--page", type=File, metavar="FILE", help=text)
    return parser.parse_args(arguments)


def rows_of(chosen: argparse.Namespace) -> list[Row]:
    """Return the selected rows.

    Raises:
        ValueError: There is none.
    """
    rows = [
        row
        for row in all_rows()
        if row.car in chosen.cars and row.road in chosen.roads
        if not chosen.rows or any(text in row.disturbance.name for text in chosen.rows)
    ]
    if not rows:
        raise ValueError(f"--rows: no disturbance contains {' or '.join(chosen.rows)}")
    return rows


Cells = dict[Row, dict[str, Result]]
"""Results by row and column."""


def drive_all(
    rows: Sequence[Row], columns: Sequence[str], workers: int, console: Console, known: Cells
) -> Cells:
    """Drive all cells that are not known yet in parallel, with a progress bar."""
    bars = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    console.print("compiling the car ...")
    compile_for(rows, columns)  # before the processes start, which inherit it
    cells: Cells = {
        row: {name: result for name, result in known.get(row, {}).items() if name in columns}
        for row in rows
    }
    with (
        Progress(*bars, *times, console=console) as progress,
        ProcessPoolExecutor(workers) as pool,
    ):
        tasks = {
            pool.submit(drive_cell, row, name): (row, name)
            for row in rows
            for name in columns
            if COLUMNS[name].drives(row) and name not in cells[row]
        }
        for task in progress.track(as_completed(tasks), len(tasks), description="drives"):
            row, name = tasks[task]
            cells[row][name] = task.result()
    return cells


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive the selected cells, print and write the leaderboard, and return the exit code."""
    chosen, console = read_options(arguments), Console(highlight=False, soft_wrap=True)
    words = shlex.join(sys.argv[1:] if arguments is None else arguments)
    console.width = max(console.width, WIDTH)
    try:
        rows = rows_of(chosen)
        with naming("output"):
            create_folder(chosen.output, exist_ok=True)
        known = read_yardsticks(chosen.reuse, rows) if chosen.reuse else {}
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    columns = [name for name in COLUMNS if name in chosen.columns]
    cells = drive_all(rows, columns, chosen.workers, console, known)
    command = f"python -m tests.workshop.leaderboard.leaderboard {words}".strip()
    board = Board(command, columns, cells)
    for table in screen_tables(board):
        console.print(table)
    write_json(board, chosen.output / "leaderboard.json")
    for file in (chosen.output / "leaderboard.md", chosen.page):
        if file:
            write_page(board, file)
    console.print(f"leaderboard.md, .json and .png: {chosen.output}", markup=False)
    lost = [board.lost(name) for name in columns if COLUMNS[name].decides]
    return LOST if any(lost) else 0


if __name__ == "__main__":
    sys.exit(main())
