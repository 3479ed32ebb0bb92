"""Measure the paper's particle swarm and other methods on test functions; check its claim.

`python -m launch_scripts.study.bench_pso`; `--seeds 11` for a quick run. Every method has the same
number of evaluations.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ampc_msgs_config.types import Array
from launch_scripts.reporting.pages import markdown_table
from launch_scripts.reporting.style import label_ends
from launch_scripts.study.pso_methods import (
    BUDGET,
    CLAIMED,
    GENERATIONS,
    METHOD_STYLES,
    METHODS,
    PARTICLES,
    PROBLEMS,
    READING_VARIANTS,
    REPORTED,
    all_bars_hold,
    ordering_bars,
    reading_medians,
    readings,
    search_curves,
)

CONSOLE_WIDTH = 126
"""Minimum width of the printed tables [characters]."""
COLUMNS = 4
Runs = Mapping[tuple[str, str], Array]
"""Best value after each generation (seeds, GENERATIONS + 1), by names of problem and method."""
ReadingMedians = Mapping[str, Array]
"""Final medians of READING_VARIANTS by title of the reading."""
READING_HEADS = ("reading (sphere, n = 5)", *READING_VARIANTS, "bars hold")
CLAIM_HEADS = ("sphere, n = 5", "paper, one run", "median", "quartiles")
NOTE = """\
![median curves](bench_pso.png)

The paper shows 41 generations, but its Table 2 has G = 15. It states neither a velocity clamp nor a
boundary rule. The first row of the last table is the reading that reproduces its numbers. Its
"improved PSO of [23]" is a swarm with the linear inertia of Eq. (32) only; the adaptive swarm that
[23] publishes is "Zhan's adaptive" here. In "fitted" swarms the schedule ends with the run (G = 41)
and velocities are clamped to 0.2 ranges, the settings recommended to users.
"""


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/bench_pso"), help="output folder")
    parser.add_argument("--seeds", type=int, default=51, help="runs each; default: %(default)s")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    chosen = parser.parse_args(arguments)
    for name in ("seeds", "workers"):
        if getattr(chosen, name) < 1:
            parser.error(f"--{name} {getattr(chosen, name)} must be at least 1")
    return chosen


def measure_methods(
    seeds: int, workers: int, progress: Progress
) -> tuple[dict[tuple[str, str], Array], dict[str, Array]]:
    """Run all methods on all problems, and all readings, in parallel."""
    with ProcessPoolExecutor(workers) as pool:
        runs = {
            (problem.name, name): pool.submit(search_curves, method, problem, range(seeds))
            for problem in PROBLEMS
            for name, method in METHODS.items()
        }
        medians = {name: pool.submit(reading_medians, name, range(seeds)) for name in readings()}
        futures = [*runs.values(), *medians.values()]
        for _ in progress.track(as_completed(futures), len(futures), description="searches"):
            pass
        return (
            {key: future.result() for key, future in runs.items()},
            {key: future.result() for key, future in medians.items()},
        )


def final_quartiles(runs: Runs, problem: str, method: str) -> list[float]:
    """Return the quartiles over the seeds of the final value."""
    quartiles: list[float] = np.percentile(runs[problem, method][:, -1], (25, 50, 75)).tolist()
    return quartiles


def final_medians(runs: Runs, problem: str) -> dict[str, float]:
    """Return the median final value of each method."""
    return {name: float(np.median(runs[problem, name][:, -1])) for name in METHODS}


def bench_results(runs: Runs, medians: ReadingMedians) -> dict[str, Any]:
    """Return all results for JSON."""
    problems = {
        problem.name: {
            name: {
                "quartiles": final_quartiles(runs, problem.name, name),
                "median_curve": np.percentile(runs[problem.name, name], 50, axis=0).tolist(),
                "final": runs[problem.name, name][:, -1].tolist(),
            }
            for name in METHODS
        }
        for problem in PROBLEMS
    }
    return {
        "evaluations": BUDGET,
        "generations": GENERATIONS,
        "problems": problems,
        "readings": {
            name: dict(zip(READING_VARIANTS, values.tolist(), strict=True))
            for name, values in medians.items()
        },
        "bars": ordering_bars(final_medians(runs, PROBLEMS[0].name)),
    }


def better_methods(runs: Runs) -> list[str]:
    """Return a line for each problem: the methods with a better median than `proposed`."""
    lines = []
    for problem in PROBLEMS:
        medians = final_medians(runs, problem.name)
        better = [name for name in METHODS if medians[name] < medians["proposed"]]
        lines.append(f"{problem.name}: {'; '.join(better) or 'none'}")
    return lines


def median_rows(runs: Runs, text: str = "{1:.3g}", bold: str = "[bold]{}[/]") -> list[list[str]]:
    """Return a row per method and a cell per problem; the best cell of a column is bold.

    Args:
        runs: Results.
        text: Format of a cell; fields: lower quartile, median and upper quartile.
        bold: Format of the best cell.
    """
    best = {p.name: min(final_medians(runs, p.name).values()) for p in PROBLEMS}
    rows = [[method] for method in METHODS]
    for row in rows:
        for problem, smallest in best.items():
            quartiles = final_quartiles(runs, problem, row[0])
            cell = text.format(*quartiles)
            row.append(bold.format(cell) if quartiles[1] <= smallest else cell)
    return rows


def reading_rows(medians: ReadingMedians) -> list[list[str]]:
    """Return a row per reading of the paper; the last cell states whether the claim holds."""
    rows = []
    for name, values in medians.items():
        holds = all_bars_hold(dict(zip(READING_VARIANTS, values.tolist(), strict=True)))
        rows.append([name, *(f"{value:.3g}" for value in values), "yes" if holds else "no"])
    return rows


def claim_rows(runs: Runs) -> list[list[str]]:
    """Return a row per variant of the paper's comparison: reported and measured values."""
    rows = []
    for name in CLAIMED:
        low, middle, high = final_quartiles(runs, PROBLEMS[0].name, name)
        rows.append([name, f"{REPORTED[name]:g}", f"{middle:.3g}", f"{low:.3g}-{high:.3g}"])
    return rows


def bench_markdown(runs: Runs, medians: ReadingMedians) -> str:
    """Return the tables for the documentation."""
    names = [problem.name for problem in PROBLEMS]
    cells = median_rows(runs, "{1:.2g} ({0:.2g}-{2:.2g})", "**{}**")
    lines = [
        NOTE,
        *markdown_table(CLAIM_HEADS, claim_rows(runs), "l"),
        "",
        *markdown_table(("median (quartiles)", *names), cells, "l"),
        "",
        f"{len(runs[names[0], 'proposed'])} seeds, {BUDGET} evaluations. "
        "Better than `proposed` in the median:",
        "",
        *(f"* {line}" for line in better_methods(runs)),
        "",
        *markdown_table(READING_HEADS, reading_rows(medians), "l"),
        "",
    ]
    return "\n".join(lines)


def draw_methods(runs: Runs, file: Path) -> None:
    """Draw the median curves into a PNG file: a panel per problem, labels at the line ends."""
    rows = -(-len(PROBLEMS) // COLUMNS)
    figure = Figure(figsize=(4.6 * COLUMNS, 4.2 * rows), layout="constrained", dpi=80)
    panels = figure.subplots(rows, COLUMNS, squeeze=False)
    colors = {name: color for name, (color, _) in METHOD_STYLES.items() if name in METHODS}
    evaluations = PARTICLES * np.arange(1, BUDGET // PARTICLES + 1)
    for ax, problem in zip(panels.flat, PROBLEMS, strict=False):
        ax.set_title(problem.name)
        ax.set_yscale("log")
        ax.yaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(2, 0.6)))
        for name, color in colors.items():
            values = np.median(runs[problem.name, name], axis=0)
            width = 2.6 if name == "proposed" else 1.5
            ax.plot(evaluations, values, METHOD_STYLES[name][1], color=color, linewidth=width)
        ax.set_xlim(0, BUDGET)
        ax.grid(alpha=0.3)
    for ax in panels[-1]:
        ax.set_xlabel("evaluations")
    for ax in panels[:, 0]:
        ax.set_ylabel("best value so far, median")
    figure.draw_without_rendering()
    for ax, problem in zip(panels.flat, PROBLEMS, strict=False):
        medians = final_medians(runs, problem.name)
        label_ends(ax, {name: medians[name] for name in colors}, colors)
    figure.savefig(file)


def print_table(heads: Sequence[str], rows: list[list[str]], console: Console) -> None:
    """Print a table whose first column is text."""
    table = Table(box=SIMPLE_HEAD)
    for k, head in enumerate(heads):
        table.add_column(head.replace(", ", "\n"), justify="right" if k else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console.print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and write; return 1 if a bar does not hold."""
    chosen, console = parse_arguments(arguments), Console(highlight=False)
    console.width = max(console.width, CONSOLE_WIDTH)
    if "CMA-ES" not in METHODS:
        console.print("note: CMA-ES is left out: pip install -r lock/requirements-bench.txt")
    with Progress(console=console) as progress:
        runs, medians = measure_methods(chosen.seeds, chosen.workers, progress)
    names = [problem.name for problem in PROBLEMS]
    print_table((f"median of {chosen.seeds}", *names), median_rows(runs), console)
    console.print("better than the proposed variant in the median:")
    console.print("\n".join(f"  {line}" for line in better_methods(runs)))
    print_table(READING_HEADS, reading_rows(medians), console)
    print_table(CLAIM_HEADS, claim_rows(runs), console)
    results = bench_results(runs, medians)
    for text, holds in results["bars"].items():
        console.print(f"  {text}: {'yes' if holds else '[bold red]NO[/]'}")
    chosen.output.mkdir(parents=True, exist_ok=True)
    content = json.dumps(results, indent=1, allow_nan=False) + "\n"
    (chosen.output / "bench_pso.json").write_text(content, encoding="utf-8")
    (chosen.output / "bench_pso.md").write_text(bench_markdown(runs, medians), encoding="utf-8")
    draw_methods(runs, chosen.output / "bench_pso.png")
    missed = sum(not holds for holds in results["bars"].values())
    console.print(f"{missed} bars do not hold; written to {chosen.output}")
    return int(missed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
