"""Measure solver, tick, swarm and node against what users would take instead, in one run.

`make bench`, or `python launch_scripts/bench.py`; `--only solvers growth` for a part.
"""

import argparse
import importlib
import os
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

PARTS = {
    "solvers": "launch_scripts.bench_solvers",
    "growth": "launch_scripts.bench_growth",
    "swarm": "launch_scripts.bench_swarm",
    "scaling": "launch_scripts.bench_scaling",
    "start": "launch_scripts.bench_start",
    "node": "launch_scripts.bench_node_table",
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
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, show, write."""
    chosen, console = options(arguments), Console(highlight=False)
    console.width = max(console.width, WIDTH)
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    report = importlib.import_module("launch_scripts.bench_report")
    machine, sections = report.machine(), []
    for part in chosen.only:
        console.print(f"measuring: {part} ...")
        found = importlib.import_module(PARTS[part]).measure(quick=chosen.quick)
        for section in found:
            report.show(section, console)
        sections += found
    report.write(chosen.output, machine, sections)
    if "growth" in chosen.only:
        figure = importlib.import_module("launch_scripts.bench_figure")
        figure.draw_growth(sections, chosen.output / "bench.png")
    console.print(f"written to {chosen.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
