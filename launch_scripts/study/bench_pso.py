"""Measure the paper's particle swarm and other methods on test functions; check its claim.

`python -m launch_scripts.study.bench_pso`; `--seeds 11 --tuning-seeds 0` for a quick run. Every
method has the same number of evaluations. The methods of the tuner are measured on its own fitness
as well. Exit code 1: a bar does not hold.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation
from rich.console import Console
from rich.markdown import Markdown
from rich.progress import Progress

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
    READINGS,
    REPORTED,
    final_quartiles,
    ordering_bars,
    reading_medians,
    search_curves,
)
from launch_scripts.study.pso_tuning import (
    BEST,
    EVALUATIONS,
    LONG,
    TUNING_PROBLEMS,
    method_names,
    tuning_bars,
    tuning_curves,
    tuning_results,
    tuning_tables,
)

CONSOLE_WIDTH = 240
"""Minimum width of the printed tables [characters]."""
COLUMNS = 4
NAMES = [problem.name for problem in PROBLEMS]
Runs = Mapping[tuple[str, str], Array]
"""Best value after each generation (seeds, GENERATIONS + 1), by names of problem and method."""
NOTE = """\
# Search methods compared

![median curves](bench_pso.png)

The paper shows 41 generations, but its Table 2 has G = 15. It states neither a velocity clamp nor a
boundary rule. The first row of the last table is the reading that reproduces its numbers. Its
"improved PSO of [23]" is a swarm with the linear inertia of Eq. (32) only; the adaptive swarm that
[23] publishes is "Zhan's adaptive" here. In "fitted" swarms the schedule ends with the run (G = 41)
and velocities are clamped to 0.2 ranges. `python -m launch_scripts.study.bench_pso`.
"""


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/bench_pso"), help="output folder")
    parser.add_argument("--seeds", type=int, default=51, help="runs each; default: %(default)s")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    text = "seeds on the tuner's fitness (20 minutes); 0: none; default: %(default)s"
    parser.add_argument("--tuning-seeds", type=int, default=20, help=text)
    chosen = parser.parse_args(arguments)
    if chosen.tuning_seeds < 0:
        parser.error(f"--tuning-seeds {chosen.tuning_seeds} must be at least 0")
    for name in ("seeds", "workers"):
        if getattr(chosen, name) < 1:
            parser.error(f"--{name} {getattr(chosen, name)} must be at least 1")
    return chosen


def measure_methods(seeds: int, workers: int, progress: Progress) -> dict[str, Any]:
    """Run all methods on all problems, and all readings, in parallel; return the results."""
    with ProcessPoolExecutor(workers) as pool:
        runs = {
            (problem.name, name): pool.submit(search_curves, method, problem, range(seeds))
            for problem in PROBLEMS
            for name, method in METHODS.items()
        }
        medians = {name: pool.submit(reading_medians, name, range(seeds)) for name in READINGS}
        futures: list[Future[Any]] = [*runs.values(), *medians.values()]
        for _ in progress.track(as_completed(futures), len(futures), description="searches"):
            pass
        return bench_results(
            {key: future.result() for key, future in runs.items()},
            {key: future.result() for key, future in medians.items()},
        )


def measure_tuning(seeds: int, workers: int, progress: Progress) -> dict[str, Any]:
    """Run the tuner's methods on its own fitness, in parallel; return the results."""
    with ProcessPoolExecutor(workers) as pool:
        budgets = {name: (name, EVALUATIONS[-1], seeds) for name in method_names()}
        budgets[BEST] = ("pso", LONG, 1)
        runs = {
            (number, name, seed): pool.submit(tuning_curves, number, method, [seed], budget)
            for number in range(len(TUNING_PROBLEMS))
            for name, (method, budget, count) in budgets.items()
            for seed in range(count)
        }
        for _ in progress.track(as_completed(runs.values()), len(runs), description="tuning"):
            pass
    curves: dict[str, dict[str, Array]] = {}
    for (number, name, _), run in runs.items():
        by_method = curves.setdefault(TUNING_PROBLEMS[number].name, {})
        rows = run.result()
        by_method[name] = np.vstack((by_method[name], rows)) if name in by_method else rows
    return tuning_results(curves)


def bench_results(runs: Runs, medians: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """Return all results for JSON."""
    problems = {
        problem: {
            name: {
                "quartiles": final_quartiles(runs[problem, name]),
                "median_curve": np.percentile(runs[problem, name], 50, axis=0).tolist(),
                "final": runs[problem, name][:, -1].tolist(),
            }
            for name in METHODS
        }
        for problem in NAMES
    }
    return {
        "evaluations": BUDGET,
        "generations": GENERATIONS,
        "problems": problems,
        "readings": medians,
        "bars": ordering_bars({n: row["quartiles"][1] for n, row in problems[NAMES[0]].items()}),
    }


def bench_tables(results: Mapping[str, Any]) -> str:
    """Return the tables in Markdown: claim, medians of all methods, readings of the paper."""
    quartiles: dict[str, dict[str, list[float]]] = {
        problem: {name: each["quartiles"] for name, each in row.items()}
        for problem, row in results["problems"].items()
    }
    # the paper's comparison
    claims = []
    for name in CLAIMED:
        low, middle, high = quartiles[NAMES[0]][name]
        claims.append([name, f"{REPORTED[name]:g}", f"{middle:.3g}", f"{low:.3g}-{high:.3g}"])
    # a row per method, a cell per problem; the best cell of a column is bold
    rows, better = [[name] for name in METHODS], []
    for problem in NAMES:
        best = min(middle for _, middle, _ in quartiles[problem].values())
        for row in rows:
            low, middle, high = quartiles[problem][row[0]]
            cell = f"{middle:.2g} ({low:.2g}-{high:.2g})"
            row.append(f"**{cell}**" if middle <= best else cell)
        ours = quartiles[problem]["proposed"][1]
        names = [name for name in METHODS if quartiles[problem][name][1] < ours]
        better.append(f"* {problem}: {'; '.join(names) or 'none'}")
    # a row per reading; the last cell states whether the claim holds
    readings = [
        [name, *(f"{value:.3g}" for value in median.values()),
         "yes" if all(ordering_bars(median).values()) else "no"]
        for name, median in results["readings"].items()
    ]  # fmt: skip
    seeds = len(results["problems"][NAMES[0]]["proposed"]["final"])
    lines = [
        *markdown_table(("sphere, n = 5", "paper, one run", "median", "quartiles"), claims, "l"),
        "",
        *markdown_table(("median (quartiles)", *NAMES), rows, "l"),
        "",
        f"{seeds} seeds, {BUDGET} evaluations. Better than `proposed` in the median:",
        "",
        *better,
        "",
        *markdown_table(("reading (sphere, n = 5)", *READING_VARIANTS, "bars hold"), readings, "l"),
        "",
    ]
    return "\n".join(lines)


def draw_methods(results: Mapping[str, Any], file: Path) -> None:
    """Draw the median curves into a PNG file: a panel per problem, labels at the line ends."""
    rows = -(-len(PROBLEMS) // COLUMNS)
    figure = Figure(figsize=(4.6 * COLUMNS, 4.2 * rows), layout="constrained", dpi=80)
    panels = figure.subplots(rows, COLUMNS, squeeze=False)
    colors = {name: color for name, (color, _) in METHOD_STYLES.items() if name in METHODS}
    evaluations = PARTICLES * np.arange(1, BUDGET // PARTICLES + 1)
    for ax, problem in zip(panels.flat, NAMES, strict=False):
        ax.set_title(problem)
        ax.set_yscale("log")
        ax.yaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(2, 0.6)))
        for name, color in colors.items():
            values = results["problems"][problem][name]["median_curve"]
            width = 2.6 if name == "proposed" else 1.5
            ax.plot(evaluations, values, METHOD_STYLES[name][1], color=color, linewidth=width)
        ax.set_xlim(0, BUDGET)
        ax.grid(alpha=0.3)
    for ax in panels[-1]:
        ax.set_xlabel("evaluations")
    for ax in panels[:, 0]:
        ax.set_ylabel("best value so far, median")
    figure.draw_without_rendering()
    for ax, problem in zip(panels.flat, NAMES, strict=False):
        row = results["problems"][problem]
        label_ends(ax, {name: row[name]["median_curve"][-1] for name in colors}, colors)
    figure.savefig(file)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and write; return 1 if a bar does not hold."""
    chosen, console = parse_arguments(arguments), Console(highlight=False)
    console.width = max(console.width, CONSOLE_WIDTH)
    if "CMA-ES" not in METHODS:
        console.print("note: CMA-ES is left out: pip install -r lock/requirements-bench.txt")
    with Progress(console=console) as progress:
        results = measure_methods(chosen.seeds, chosen.workers, progress)
        if chosen.tuning_seeds:
            tuning = measure_tuning(chosen.tuning_seeds, chosen.workers, progress)
            results |= {"tuning": tuning, "bars": results["bars"] | tuning_bars(tuning)}
    tables = bench_tables(results)
    if chosen.tuning_seeds:
        lines = tuning_tables(results["tuning"], chosen.tuning_seeds)
        tables = "\n".join([*lines, "## Test functions", "", tables])
    console.print(Markdown(tables))
    for text, holds in results["bars"].items():
        console.print(f"  {text}: {'yes' if holds else '[bold red]NO[/]'}")
    chosen.output.mkdir(parents=True, exist_ok=True)
    content = json.dumps(results, indent=1, allow_nan=False) + "\n"
    (chosen.output / "bench_pso.json").write_text(content, encoding="utf-8")
    (chosen.output / "bench_pso.md").write_text(f"{NOTE}\n{tables}", encoding="utf-8")
    draw_methods(results, chosen.output / "bench_pso.png")
    missed = sum(not holds for holds in results["bars"].values())
    console.print(f"{missed} bars do not hold; written to {chosen.output}")
    return int(missed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
