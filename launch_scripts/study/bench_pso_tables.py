"""Tables of the particle swarm's benchmark, and the bars that the paper's claim is held to."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.types import Array
from launch_scripts.study.pso_yardsticks import BUDGET, METHODS, PROBLEMS, Problem

CLAIMED = ("proposed", "linear", "damped", "classic")
"""Variants of the paper's comparison, in the order that it claims."""
REPORTED = {"proposed": 1e-3, "linear": 2.1, "damped": 3.11, "classic": 5.59}
"""Fitness after 41 generations, read in the text of the paper, from one run each."""
READ = (*CLAIMED, "authors_code")
"""Variants that are measured in every reading of the paper."""
Runs = dict[tuple[str, str], Array]
"""By names of problem and method: best value after each generation (seeds, GENERATIONS + 1)."""
Readings = dict[str, Array]
"""Final medians of the variants in READ (len(READ),)."""
READING_HEADS = ("reading (sphere, n = 5)", *READ, "bars hold")
CLAIM_HEADS = ("sphere, n = 5", "paper, one run", "median", "quartiles")
NOTE = """\
![median curves](bench_pso.png)

The paper shows 41 generations, but its Table 2 has G = 15, and it names neither a velocity clamp
nor a boundary rule. The first row of the last table is the reading that gives its numbers. Its
"improved PSO of [23]" is a swarm with the linear inertia of Eq. (32) only: the adaptive swarm that
[23] publishes is "Zhan's adaptive" here. "Fitted" swarms have their schedule end with the run
(G = 41) and velocities clamped to 0.2 ranges, as a user would set them.
"""


class Bar(NamedTuple):
    """What must hold of the medians on the paper's sphere."""

    text: str
    holds: bool


def bars(median: dict[str, float]) -> list[Bar]:
    """Judge the medians of the variants in CLAIMED."""
    proposed, linear, damped, classic = (median[name] for name in CLAIMED)
    return [
        Bar("proposed < 0.1", proposed < 0.1),
        Bar("0.5 <= linear <= 5", 0.5 <= linear <= 5),
        Bar("0.5 <= damped <= 5", 0.5 <= damped <= 5),
        Bar("classic > 2", classic > 2),
        Bar("proposed < linear < classic", proposed < linear < classic),
        Bar("proposed < damped < classic", proposed < damped < classic),
    ]


def median(runs: Runs, problem: Problem, method: str) -> float:
    """Final value, median over seeds."""
    return float(np.median(runs[problem.name, method][:, -1]))


def losses(runs: Runs) -> list[str]:
    """Say for each problem which methods end with a better median than the proposed variant."""
    lines = []
    for problem in PROBLEMS:
        own = median(runs, problem, "proposed")
        better = [name for name in METHODS if median(runs, problem, name) < own]
        lines.append(f"{problem.name}: {'; '.join(better) or 'none'}")
    return lines


def median_rows(runs: Runs, text: str = "{1:.3g}", bold: str = "[bold]{}[/]") -> list[list[str]]:
    """Give a row for each method, a cell for each problem; the best of a column is bold.

    Args:
        runs: What was measured.
        text: Of a cell, from lower quartile, median and upper quartile of the final values.
        bold: Around the best.
    """
    rows = []
    for method in METHODS:
        cells = [method]
        for problem in PROBLEMS:
            quartiles = np.percentile(runs[problem.name, method][:, -1], (25, 50, 75))
            best = quartiles[1] <= min(median(runs, problem, other) for other in METHODS)
            cells.append((bold if best else "{}").format(text.format(*quartiles)))
        rows.append(cells)
    return rows


def reading_rows(ways: Readings) -> list[list[str]]:
    """Give a row for each reading of the paper; the last cell says whether its claim then holds."""
    rows = []
    for name, medians in ways.items():
        kept = all(bar.holds for bar in bars(dict(zip(READ, medians.tolist(), strict=True))))
        rows.append([name, *(f"{value:.3g}" for value in medians), "yes" if kept else "no"])
    return rows


def claim_rows(runs: Runs) -> list[list[str]]:
    """Give a row for each variant of the paper's comparison: what it reports, what we measure."""
    rows = []
    for name in CLAIMED:
        low, middle, high = np.percentile(runs[PROBLEMS[0].name, name][:, -1], (25, 50, 75))
        rows.append([name, f"{REPORTED[name]:g}", f"{middle:.3g}", f"{low:.3g}-{high:.3g}"])
    return rows


def markdown(runs: Runs, ways: Readings) -> str:
    """Write the tables for the documentation."""

    def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
        lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
        return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]

    names = [problem.name for problem in PROBLEMS]
    seeds = len(runs[PROBLEMS[0].name, "proposed"])
    lines = [
        NOTE,
        *table(CLAIM_HEADS, claim_rows(runs)),
        *table(
            ("median (quartiles)", *names), median_rows(runs, "{1:.2g} ({0:.2g}-{2:.2g})", "**{}**")
        ),
        f"{seeds} seeds, {BUDGET} evaluations. Better than `proposed` in the median:",
        "",
        *(f"* {line}" for line in losses(runs)),
        "",
        *table(READING_HEADS, reading_rows(ways)),
    ]
    return "\n".join(lines)
