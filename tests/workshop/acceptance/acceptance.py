"""Drive all cases of the result table with both formulations and compare them with thresholds.

`python -m tests.workshop.acceptance.acceptance`; `--only scenarios iso3888` selects groups. Exit
code 0: the preview formulation meets every threshold; 1: it does not.
"""

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from ampc_msgs_config.config import find
from ampc_ros.mpc.gain_table import load_gain_table
from tests.workshop.acceptance import real_paths, real_states
from tests.workshop.acceptance.acceptance_figure import draw_comparison
from tests.workshop.acceptance.cases import BOTH, Case, Measured, Threshold, all_cases
from tests.workshop.acceptance.loop_margins import loop_table
from tests.workshop.acceptance.road_data import DATA, IS_RECORDED
from tests.workshop.acceptance.trials import OTHER_TABLES, QUANTITIES

SECTIONS = (
    (real_paths.SECTION, partial(real_paths.tasks, 0)),
    (real_states.SECTION, real_states.tasks),
)
"""Sections with targets of their own, and the functions that return their tasks."""

HEADINGS = ("case", "quantity", "threshold", *BOTH, "met")
WIDTH = 120
"""Minimum width of the printed table [characters]."""
Measurements = dict[tuple[int, str], Measured]
"""Results by case number and controller; empty where the controller cannot take the path."""


class Row(NamedTuple):
    """One row of the table."""

    case: Case
    threshold: Threshold
    values: tuple[float, ...]
    """Values of the controllers in BOTH; NaN where one cannot take the path."""

    @property
    def holds(self) -> bool:
        """True if the preview formulation meets the threshold."""
        return math.isinf(self.threshold.limit) or self.threshold.holds(self.values[0])

    @property
    def cells(self) -> tuple[str, ...]:
        """Cells of the row as text."""
        threshold, sign = self.threshold, ">=" if self.threshold.at_least else "<="
        limit = "" if math.isinf(threshold.limit) else f"{sign} {threshold.limit:g}"
        verdict = "" if math.isinf(threshold.limit) else "yes" if self.holds else "NO"
        numbers = ("-" if math.isnan(value) else f"{value:.3g}" for value in self.values)
        return (self.case.name, QUANTITIES[threshold.quantity].label, limit, *numbers, verdict)


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    groups = [*dict.fromkeys(case.group for case in all_cases())]
    groups += [section.group for section, _ in SECTIONS]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--output", type=Path, default=Path("runs/acceptance"), help="folder; default: %(default)s"
    )
    parser.add_argument(
        "--only", nargs="+", default=groups, choices=groups, help="groups; default: all"
    )
    parser.add_argument(
        "--workers", type=int, default=2, help="number of processes; default: %(default)s"
    )
    parser.add_argument(
        "--gain-table",
        nargs="+",
        default=[],
        metavar="CAR=TABLE",
        help="gains of `preview` instead of the shipped ones, by vehicle",
    )
    chosen = parser.parse_args(arguments)
    for text in chosen.gain_table:
        car, _, name = text.partition("=")
        try:
            load_gain_table(name)
            find("vehicles", car)
        except ValueError as error:
            parser.error(f"--gain-table {text}: must look like ordinary=FILE: {error}")
    return chosen


def other_tables(words: Sequence[str]) -> dict[str, str]:
    """Return the gain tables by vehicle of the option `--gain-table`."""
    return {car: name for car, _, name in (text.partition("=") for text in words)}


def use_tables(tables: Mapping[str, str]) -> None:
    """Use other gain tables than the shipped ones in this process."""
    OTHER_TABLES.update(tables)


def measure_case(case: Case, controller: str) -> Measured:
    """Measure a case with a controller; empty where it cannot take the path."""
    try:
        return case.measure(controller)
    except ValueError:
        return {}


def measure_all(
    cases: Sequence[Case], workers: int, progress: Progress, tables: Mapping[str, str]
) -> Measurements:
    """Measure all cases in parallel, with other gain tables by vehicle than the shipped ones."""
    measurements: Measurements = {}
    with ProcessPoolExecutor(workers, initializer=use_tables, initargs=(tables,)) as pool:
        tasks = {
            pool.submit(measure_case, case, name): (number, name)
            for number, case in enumerate(cases)
            for name in case.controllers
        }
        for task in progress.track(as_completed(tasks), len(tasks), description="cases"):
            measurements[tasks[task]] = task.result()
    return measurements


def rows_of(cases: Sequence[Case], measurements: Measurements) -> list[Row]:
    """Return the rows of the table in the order of the cases."""

    def value(number: int, name: str, quantity: str) -> float:
        return measurements.get((number, name), {}).get(quantity, math.nan)

    return [
        Row(case, threshold, tuple(value(number, name, threshold.quantity) for name in BOTH))
        for number, case in enumerate(cases)
        for threshold in case.thresholds
    ]


def show(rows: Sequence[Row], console: Console) -> None:
    """Print the table."""
    table = Table(*HEADINGS, box=SIMPLE_HEAD)
    group = ""
    for row in rows:
        if row.case.group != group:
            group = row.case.group
            table.add_section()
            table.add_row(f"[bold]{group}[/]")
        table.add_row(*map(escape, row.cells), style=None if row.holds else "bold red")
    console.print(table)


def result_table(rows: Sequence[Row]) -> str:
    """Return the table as Markdown."""
    lines = ["| " + " | ".join(HEADINGS) + " |", "|---" * len(HEADINGS) + "|"]
    for row in rows:
        name, *cells = row.cells
        lines.append("| " + " | ".join([f"{row.case.group}: {name}", *cells]) + " |")
    return "\n".join(lines) + "\n"


def results_to_json(cases: Sequence[Case], measurements: Measurements) -> list[dict[str, Any]]:
    """Return all results as JSON values; NaN and infinity are null."""
    return [
        {
            "group": case.group,
            "case": case.name,
            "bars": {
                threshold.quantity: threshold.limit
                for threshold in case.thresholds
                if math.isfinite(threshold.limit)
            },
            **{
                name: {k: v if math.isfinite(v) else None for k, v in measurements[i, name].items()}
                for name in case.controllers
            },
        }
        for i, case in enumerate(cases)
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure all cases, print and write the table, and return the exit code."""
    chosen, console = options(arguments), Console(highlight=False)
    console.width = max(console.width, WIDTH)
    cases = [case for case in all_cases() if case.group in chosen.only]
    if not DATA.is_dir():
        console.print(f"note: no roads in {DATA}; their cases are omitted: run make data")
    elif not IS_RECORDED:
        console.print(f"note: the roads from files are the generated ones in {DATA}")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        measurements = measure_all(cases, chosen.workers, progress, other_tables(chosen.gain_table))
        sections = [
            (section, section.measure(tasks(), chosen.workers, progress))
            for section, tasks in SECTIONS
            if section.group in chosen.only
        ]
    rows = rows_of(cases, measurements)
    show(rows, console)
    chosen.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(results_to_json(cases, measurements), indent=2, allow_nan=False) + "\n"
    (chosen.output / "acceptance.json").write_text(text, encoding="utf-8")
    loops = [(i, case) for i, case in enumerate(cases) if case.group == "eigenvalues"]
    text = result_table(rows)
    text += loop_table({case.name: measurements[i, "preview"] for i, case in loops})
    for section, targets in sections:
        table = section.table(targets)
        console.print(table, markup=False, soft_wrap=True)
        text += f"\n{section.group.capitalize()}:\n\n{table}"
        section.write(targets, chosen.output)
    (chosen.output / "acceptance.md").write_text(text, encoding="utf-8")
    draw_comparison(("sc1", "sc3_varying"), chosen.output / "acceptance.png")
    failed = sum(not row.holds for row in rows)
    failed += sum(not row.holds for _, targets in sections for row in targets)
    console.print(f"{failed} thresholds not met; written to {chosen.output}")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
