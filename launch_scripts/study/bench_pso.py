"""Measure the paper's particle swarm and its rivals on test functions, and judge its claim.

`python launch_scripts/study/bench_pso.py`; `--seeds 11` for a quick look. Every method has the same
number of evaluations.
"""

import argparse
import json
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console, JustifyMethod
from rich.progress import Progress
from rich.table import Table

from ampc_msgs_config.types import Array
from launch_scripts.study.bench_pso_figure import draw_curves
from launch_scripts.study.bench_pso_tables import (
    CLAIM_HEADS,
    CLAIMED,
    READ,
    READING_HEADS,
    Bar,
    Readings,
    Runs,
    bars,
    claim_rows,
    losses,
    markdown,
    median,
    median_rows,
    reading_rows,
)
from launch_scripts.study.pso_yardsticks import (
    BUDGET,
    GENERATIONS,
    METHODS,
    PROBLEMS,
    Problem,
    as_in_the_paper,
    curves,
    finals,
    readings,
)

WIDTH = 126
"""Of the printed tables, at least [characters]."""


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/bench_pso"), help="to write")
    parser.add_argument("--seeds", type=int, default=51, help="runs each; default: %(default)s")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    chosen = parser.parse_args(arguments)
    for name in ("seeds", "workers"):
        if getattr(chosen, name) < 1:
            parser.error(f"--{name} {getattr(chosen, name)} must be at least 1")
    return chosen


def measured(problem: Problem, method: str, seeds: int) -> Array:
    """Run a method on a problem: best value after each generation (seeds, GENERATIONS + 1)."""
    return curves(METHODS[method], problem, range(seeds))


def read(name: str, seeds: int) -> Array:
    """Give the final medians of the variants in READ under one reading of the paper."""
    settings = [as_in_the_paper(variant, **readings()[name]) for variant in READ]
    return np.asarray(np.median(finals(settings, PROBLEMS[0], range(seeds)), axis=1))


def measure_all(seeds: int, workers: int, progress: Progress) -> tuple[Runs, Readings]:
    """Run everything in parallel."""
    with ProcessPoolExecutor(workers) as pool:
        runs = {
            (problem.name, method): pool.submit(measured, problem, method, seeds)
            for problem in PROBLEMS
            for method in METHODS
        }
        ways = {name: pool.submit(read, name, seeds) for name in readings()}
        futures = [*runs.values(), *ways.values()]
        for _ in progress.track(as_completed(futures), len(futures), description="searches"):
            pass
        return (
            {key: future.result() for key, future in runs.items()},
            {key: future.result() for key, future in ways.items()},
        )


def content(runs: Runs, ways: Readings, judged: Sequence[Bar]) -> dict[str, Any]:
    """Give all that was measured, for JSON."""

    def summary(values: Array) -> dict[str, Any]:
        low, middle, high = np.percentile(values, (25, 50, 75), axis=0)
        return {
            "quartiles": [float(low[-1]), float(middle[-1]), float(high[-1])],
            "median_curve": middle.tolist(),
            "final": values[:, -1].tolist(),
        }

    return {
        "evaluations": BUDGET,
        "generations": GENERATIONS,
        "problems": {
            problem.name: {name: summary(runs[problem.name, name]) for name in METHODS}
            for problem in PROBLEMS
        },
        "readings": {
            name: dict(zip(READ, medians.tolist(), strict=True)) for name, medians in ways.items()
        },
        "bars": {bar.text: bar.holds for bar in judged},
    }


def grid(heads: Sequence[str], rows: Iterable[Sequence[str]], console: Console) -> None:
    """Print a table whose first column is text."""
    table = Table(box=SIMPLE_HEAD)
    for k, head in enumerate(heads):
        justify: JustifyMethod = "right" if k else "left"
        table.add_column(head.replace(", ", "\n"), justify=justify, no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console.print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, show, judge, write; gives 1 if a bar is not held."""
    chosen, console = options(arguments), Console(highlight=False)
    console.width = max(console.width, WIDTH)
    if "CMA-ES" not in METHODS:
        console.print("note: CMA-ES is left out: pip install -r lock/requirements-bench.txt")
    with Progress(console=console) as progress:
        runs, ways = measure_all(chosen.seeds, chosen.workers, progress)
    grid(
        (f"median of {chosen.seeds}", *(problem.name for problem in PROBLEMS)),
        median_rows(runs),
        console,
    )
    console.print("better than the proposed variant in the median:")
    console.print("\n".join(f"  {line}" for line in losses(runs)))
    grid(READING_HEADS, reading_rows(ways), console)
    grid(CLAIM_HEADS, claim_rows(runs), console)
    judged = bars({name: median(runs, PROBLEMS[0], name) for name in CLAIMED})
    for bar in judged:
        console.print(f"  {bar.text}: {'yes' if bar.holds else '[bold red]NO[/]'}")
    chosen.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content(runs, ways, judged), indent=1, allow_nan=False) + "\n"
    (chosen.output / "bench_pso.json").write_text(text, encoding="utf-8")
    (chosen.output / "bench_pso.md").write_text(markdown(runs, ways), encoding="utf-8")
    draw_curves(runs, chosen.output / "bench_pso.png")
    console.print(f"{sum(not bar.holds for bar in judged)} bars not held; in {chosen.output}")
    return int(not all(bar.holds for bar in judged))


if __name__ == "__main__":
    raise SystemExit(main())
