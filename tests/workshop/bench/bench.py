"""Measure solver, tick, swarm and node against what users would take instead, in one run.

`make bench`, or `python tests/workshop/bench/bench.py`; `--only solvers growth` for a part.
"""

import argparse
import importlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

PARTS = {
    "solvers": "tests.workshop.bench.bench_solvers",
    "growth": "tests.workshop.bench.bench_growth",
    "swarm": "tests.workshop.bench.bench_swarm",
    "scaling": "tests.workshop.bench.bench_scaling",
    "start": "tests.workshop.bench.bench_start",
    "node": "tests.workshop.bench.bench_node_table",
}
"""Modules whose `measure(quick=...)` gives the tables of a part."""
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""What NumPy's and the solvers' linear algebra read when they are loaded."""
WIDTH = 160
"""Of the printed tables, at least [characters]."""


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/bench"), help="folder to write")
    parser.add_argument("--only", nargs="+", default=list(PARTS), choices=PARTS, help="parts")
    parser.add_argument("--quick", action="store_true", help="a smoke test: numbers mean nothing")
    parser.add_argument("--readme", type=Path, help="Markdown file that takes the table of bars")
    parser.add_argument("--read", type=Path, nargs="+", help="bench.json of earlier runs: no new")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, judge, show, write."""
    chosen, console = options(arguments), Console(highlight=False)
    console.width = max(console.width, WIDTH)
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    report = importlib.import_module("tests.workshop.bench.bench_report")
    machine, sections = report.read(chosen.read) if chosen.read else measured(chosen, console)
    bars = importlib.import_module("tests.workshop.bench.bench_bars").bars(sections)
    for section in bars:
        report.show(section, console)
        if chosen.readme:
            report.put_into(chosen.readme, machine, section)
    report.write(chosen.output, machine, bars + sections)
    figure = importlib.import_module("tests.workshop.bench.bench_figure")
    if set(figure.DRAWN) <= {section.key for section in sections}:
        figure.draw(sections, chosen.output / "bench.png")
    console.print(f"written to {chosen.output}")
    return 0


def measured(chosen: argparse.Namespace, console: Console) -> tuple[dict[str, Any], list[Any]]:
    """Measure the parts asked for, show each; gives the machine and the tables."""
    report = importlib.import_module("tests.workshop.bench.bench_report")
    machine, sections = importlib.import_module("launch_scripts.run.machine").describe_machine(), []
    for part in chosen.only:
        console.print(f"measuring: {part} ...")
        found = importlib.import_module(PARTS[part]).measure(quick=chosen.quick)
        for section in found:
            report.show(section, console)
        sections += found
    return machine, sections


if __name__ == "__main__":
    raise SystemExit(main())
