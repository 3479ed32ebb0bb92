"""Benchmark solver, tick, swarm and node against the tools that users would take instead.

`make bench`, or `python -m tests.workshop.bench.bench`; `--only solvers growth` selects parts.
"""

import argparse
import importlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

PARTS = {
    "solvers": ("bench_solvers", "measure"),
    "growth": ("bench_growth", "measure"),
    "swarm": ("bench_swarm", "measure"),
    "scaling": ("bench_swarm", "measure_scaling"),
    "start": ("bench_node", "measure_start"),
    "node": ("bench_node", "measure"),
    "processes": ("bench_processes", "measure"),
    "inputs": ("bench_inputs", "measure"),
}
"""Module and function that returns the tables of a part."""
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that linear algebra libraries read when they are loaded."""
PAGE = Path(__file__).resolve().parents[3] / "ampc_ros" / "doc" / "benchmarks.md"
"""Page of the documentation with the marks between which the thresholds stand."""
WIDTH = 160
"""Minimum width of the printed tables [characters]."""


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/bench"), help="folder")
    parser.add_argument("--only", nargs="+", default=list(PARTS), choices=PARTS, help="parts")
    parser.add_argument("--quick", action="store_true", help="smoke test: meaningless numbers")
    parser.add_argument(
        "--page",
        type=Path,
        nargs="?",
        const=PAGE,
        help="also write the thresholds into this page (without a value: doc/benchmarks.md)",
    )
    parser.add_argument("--read", type=Path, nargs="+", help="bench.json of earlier runs")
    return parser.parse_args(arguments)


def load(module: str) -> Any:
    """Import a module of the benchmark, after the environment variables are set."""
    return importlib.import_module(f"tests.workshop.bench.{module}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure or read the tables, print and write them, and return the exit code."""
    chosen, console = read_options(arguments), Console(highlight=False)
    console.width = max(console.width, WIDTH)
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    report, figure = load("bench_report"), load("bench_figure")
    if chosen.read:
        machine, sections = report.read(chosen.read)
    else:
        machine = importlib.import_module("launch_scripts.run.machine").describe_machine()
        sections = []
        for part in chosen.only:
            console.print(f"measuring: {part} ...")
            module, function = PARTS[part]
            tables = getattr(load(module), function)(quick=chosen.quick)
            for section in tables:
                report.show(section, console)
            sections += tables
    thresholds = load("bench_thresholds").threshold_table(sections)
    for section in thresholds:
        report.show(section, console)
        if chosen.page:
            report.put_into(chosen.page, machine, section)
    report.write(chosen.output, machine, thresholds + sections)
    if set(figure.DRAWN) <= {section.key for section in sections}:
        figure.draw(sections, chosen.output / "bench.png")
    console.print(f"written to {chosen.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
