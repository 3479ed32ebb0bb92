"""Targets of a section of `make acceptance`: observations, rows, table and files."""

import json
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from launch_scripts.reporting.pages import markdown_table

END = "<!-- end of the table -->"


class Target(NamedTuple):
    """One row of the table."""

    name: str
    quantity: str


class Observation(NamedTuple):
    """Value of a target in one drive."""

    target: Target
    value: float
    place: str
    """Description of the drive."""


Task = partial[list[Observation]]


def observe(name: str, place: object, values: Mapping[str, float]) -> list[Observation]:
    """Return the observations of one drive."""
    return [Observation(Target(name, q), float(value), str(place)) for q, value in values.items()]


def targets_of(rows: Mapping[str, Mapping[str, float]]) -> dict[Target, float]:
    """Return limits by target, of limits by name and quantity; infinite: reported only."""
    return {Target(name, q): limit for name, part in rows.items() for q, limit in part.items()}


class Row(NamedTuple):
    """Result of one target."""

    target: Target
    limit: float
    values: tuple[float, ...]
    """Value of each drive."""
    place: str
    """Drive with the worst value."""

    @property
    def worst(self) -> float:
        """Largest value of all drives; nan without drives."""
        return max(self.values, default=math.nan)

    @property
    def within(self) -> int:
        """Number of drives within the target."""
        return sum(value <= self.limit for value in self.values)

    @property
    def holds(self) -> bool:
        """True if all drives meet the target; a target without drives is not met."""
        return math.isinf(self.limit) or (bool(self.values) and self.within == len(self.values))

    @property
    def to_json(self) -> dict[str, Any]:
        """JSON value; an infinite number is null."""
        return {
            "name": self.target.name,
            "quantity": self.target.quantity,
            "limit": finite(self.limit),
            "worst": finite(self.worst),
            "drive": self.place,
            "drives": len(self.values),
            "within": self.within,
        }


def finite(value: float) -> float | None:
    """Return a finite number, or None."""
    return value if math.isfinite(value) else None


def shown(value: float) -> str:
    """Return a number as text; infinite: the path was rejected."""
    return "rejected" if value == math.inf else "-" if math.isnan(value) else f"{value:.3g}"


class Section(NamedTuple):
    """Targets that are measured and reported together."""

    group: str
    """Name in `make acceptance` and above the first column."""
    script: str
    """Name of the module and of its files."""
    limits: Mapping[Target, float]
    """Targets in the order of the table; an infinite limit is reported only."""
    before_file: Path
    """Results of the version before."""

    @property
    def command(self) -> str:
        """Command that measures this section."""
        return f"python -m tests.workshop.acceptance.{self.script}"

    @property
    def begin(self) -> str:
        """Mark above the table of a page."""
        return f"<!-- table of {self.script}.py -->"

    def rows(self, observations: Sequence[Observation]) -> list[Row]:
        """Return the rows of all targets that have been driven."""
        rows = []
        for target, limit in self.limits.items():
            of_target = [o for o in observations if o.target == target]
            if of_target:
                worst = max(of_target, key=lambda o: o.value)
                rows.append(Row(target, limit, tuple(o.value for o in of_target), worst.place))
        return rows

    def measure(self, jobs: Sequence[Task], workers: int, progress: Progress) -> list[Row]:
        """Run tasks in parallel and return the rows."""
        found: list[Observation] = []
        with ProcessPoolExecutor(workers) as pool:
            running = [pool.submit(job) for job in jobs]
            tasks = as_completed(running)
            for task in progress.track(tasks, len(running), description=self.group):
                found += task.result()
        return self.rows(sorted(found))

    def measure_alone(self, jobs: Sequence[Task], workers: int, console: Console) -> list[Row]:
        """Run tasks with a progress bar of their own."""
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
            return self.measure(jobs, workers, progress)

    def before(self) -> dict[Target, float]:
        """Return the worst values of the version before; infinite where it had none."""
        if not self.before_file.is_file():
            return {}
        rows = json.loads(self.before_file.read_text(encoding="utf-8"))["rows"]
        values = {Target(row["name"], row["quantity"]): row["worst"] for row in rows}
        return {target: math.inf if v is None else v for target, v in values.items()}

    def table(self, rows: Sequence[Row]) -> str:
        """Return the table as Markdown, with the worst values of the version before."""
        before, cells = self.before(), []
        for row in rows:
            reported = math.isinf(row.limit)
            cells.append(
                (
                    row.target.name,
                    row.target.quantity,
                    "" if reported else f"<= {row.limit:g}",
                    shown(row.worst),
                    shown(before.get(row.target, math.nan)),
                    "" if reported else f"{row.within} of {len(row.values)}",
                    "" if reported else "yes" if row.holds else "NO",
                    row.place,
                )
            )
        heads = ("quantity", "target", "worst", "before", "drives within", "met", "worst drive")
        return "\n".join(markdown_table((self.group, *heads), cells, "lrrrrll")) + "\n"

    def write(self, rows: Sequence[Row], folder: Path) -> None:
        """Write the results of this version as JSON."""
        write_json(rows, folder / f"{self.script}.json", self.command)

    def update(self, page: Path, text: str) -> None:
        """Replace the table of a page.

        Raises:
            ValueError: The page does not contain the marks of the table.
        """
        content = page.read_text(encoding="utf-8")
        if self.begin not in content or END not in content:
            raise ValueError(f"{page}: must contain {self.begin!r} and {END!r}")
        before, after = content.split(self.begin)[0], content.split(END)[1]
        page.write_text(f"{before}{self.begin}\n\n{text}\n{END}{after}", encoding="utf-8")

    def report(self, rows: Sequence[Row], folder: Path, page: Path | None, console: Console) -> int:
        """Write, print and update everything; return the exit code."""
        folder.mkdir(parents=True, exist_ok=True)
        self.write(rows, folder)
        text = self.table(rows)
        (folder / f"{self.script}.md").write_text(text, encoding="utf-8")
        if page:
            self.update(page, text)
        console.print(text, markup=False)
        failed = sum(not row.holds for row in rows)
        console.print(f"{failed} targets not met; written to {folder}")
        return int(failed > 0)


def write_json(rows: Sequence[Row], file: Path, command: str, **others: object) -> None:
    """Write results as JSON with the command that measured them, and other JSON values."""
    content = {"command": command, **others, "rows": [row.to_json for row in rows]}
    file.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
