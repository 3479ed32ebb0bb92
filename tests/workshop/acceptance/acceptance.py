"""Drive all cases of the result table, the paper's formulation beside the preview, and judge them.

`python tests/workshop/acceptance/acceptance.py`; `--only scenarios iso3888` for a part.
"""

import argparse
import json
import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from tests.workshop.acceptance.acceptance_figure import draw_comparison
from tests.workshop.acceptance.cases import BOTH, SPEEDS, Bar, Case, Measured, all_cases
from tests.workshop.acceptance.trials import DATA, QUANTITIES

HEADINGS = ("case", "quantity", "bar", *BOTH, "holds")
WIDTH = 120
"""Of the printed table, at least [characters]."""
Answers = dict[tuple[int, str], Measured]
"""By number of the case and name of the controller; empty where the controller cannot drive."""


class Row(NamedTuple):
    """One line of the table."""

    case: Case
    bar: Bar
    values: tuple[float, ...]
    """Of the controllers in BOTH; nan where one cannot drive."""

    @property
    def holds(self) -> bool:
        """Whether the preview keeps to the bar."""
        return math.isinf(self.bar.limit) or self.bar.holds(self.values[0])

    @property
    def cells(self) -> tuple[str, ...]:
        """As text."""
        bar, sign = self.bar, ">=" if self.bar.at_least else "<="
        limit = "" if math.isinf(bar.limit) else f"{sign} {bar.limit:g}"
        verdict = "" if math.isinf(bar.limit) else "yes" if self.holds else "NO"
        numbers = ("-" if math.isnan(value) else f"{value:.3g}" for value in self.values)
        return (self.case.name, QUANTITIES[bar.quantity].label, limit, *numbers, verdict)


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    groups = list(dict.fromkeys(case.group for case in all_cases()))
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--output", type=Path, default=Path("runs/acceptance"), help="folder to write"
    )
    parser.add_argument("--only", nargs="+", default=groups, choices=groups, help="groups to drive")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    return parser.parse_args(arguments)


def answer(case: Case, controller: str) -> Measured:
    """Measure a case with a controller; nothing where it cannot drive there."""
    try:
        return case.measure(controller)
    except ValueError:
        return {}


def measure_all(cases: Sequence[Case], workers: int, progress: Progress) -> Answers:
    """Measure all cases in parallel."""
    answers: Answers = {}
    with ProcessPoolExecutor(workers) as pool:
        tasks = {
            pool.submit(answer, case, name): (number, name)
            for number, case in enumerate(cases)
            for name in case.controllers
        }
        for task in progress.track(as_completed(tasks), len(tasks), description="cases"):
            answers[tasks[task]] = task.result()
    return answers


def rows_of(cases: Sequence[Case], answers: Answers) -> list[Row]:
    """Bring the answers into the order of the cases."""

    def value(number: int, name: str, quantity: str) -> float:
        return answers.get((number, name), {}).get(quantity, math.nan)

    return [
        Row(case, bar, tuple(value(number, name, bar.quantity) for name in BOTH))
        for number, case in enumerate(cases)
        for bar in case.bars
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


def markdown(rows: Sequence[Row]) -> str:
    """Write the table for the README."""
    lines = ["| " + " | ".join(HEADINGS) + " |", "|---" * len(HEADINGS) + "|"]
    for row in rows:
        name, *cells = row.cells
        lines.append("| " + " | ".join([f"{row.case.group}: {name}", *cells]) + " |")
    return "\n".join(lines) + "\n"


def eigenvalue_table(cases: Sequence[Case], answers: Answers) -> str:
    """Write spectral radius and margin of unknown delay over speed; empty without such cases."""
    found = {c.name: answers[i, "preview"] for i, c in enumerate(cases) if c.group == "eigenvalues"}
    if not found:
        return ""
    lines = [
        "\nSpectral radius, and the unknown delay [s] with which the loop is just stable:\n",
        "| " + " | ".join(["speed [m/s]", *found]) + " |",
        "|---" * (len(found) + 1) + "|",
    ]
    for v in SPEEDS:
        pairs = [(m[f"radius at {v:g} m/s"], m[f"margin at {v:g} m/s"]) for m in found.values()]
        lines.append(" | ".join([f"| {v:g}", *(f"{r:.3f}, {s:.3f}" for r, s in pairs)]) + " |")
    return "\n".join(lines) + "\n"


def content(cases: Sequence[Case], answers: Answers) -> list[dict[str, Any]]:
    """Give all that was measured, for JSON, which knows no nan."""
    return [
        {
            "group": case.group,
            "case": case.name,
            "bars": {bar.quantity: bar.limit for bar in case.bars if math.isfinite(bar.limit)},
            **{
                name: {k: v if math.isfinite(v) else None for k, v in answers[i, name].items()}
                for name in case.controllers
            },
        }
        for i, case in enumerate(cases)
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, judge, show, write; gives 1 if a bar is not held."""
    chosen, console = options(arguments), Console(highlight=False)
    console.width = max(console.width, WIDTH)
    cases = [case for case in all_cases() if case.group in chosen.only]
    if not DATA.is_dir():
        console.print(f"note: no recorded roads at {DATA}; these cases are left out")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        answers = measure_all(cases, chosen.workers, progress)
    rows = rows_of(cases, answers)
    show(rows, console)
    chosen.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content(cases, answers), indent=2, allow_nan=False) + "\n"
    (chosen.output / "acceptance.json").write_text(text, encoding="utf-8")
    text = markdown(rows) + eigenvalue_table(cases, answers)
    (chosen.output / "acceptance.md").write_text(text, encoding="utf-8")
    draw_comparison(("sc1", "sc3_varying"), chosen.output / "acceptance.png")
    failed = sum(not row.holds for row in rows)
    console.print(f"{failed} bars not held; written to {chosen.output}")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
