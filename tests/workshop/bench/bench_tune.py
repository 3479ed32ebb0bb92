"""Cost of tuning: growth with nodes, particles, plants and simulated time, and gain of threads.

`python -m tests.workshop.bench.bench_tune` writes `bench_tune.json` and `bench_tune.png`.
"""

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from ampc_msgs_config.config import find
from ampc_msgs_config.types import Array
from launch_scripts.reporting.style import BLUE, ORANGE
from launch_scripts.tuning.fitness import GENTLE, Node, fitness, prepared, repeat_for_gain_sets
from launch_scripts.tuning.fleet_rows import FleetRun, map_rows, run_fleet
from launch_scripts.tuning.workers import open_workers
from sim_vehicle.parameters import load_vehicle_file

mpl.use("Agg")
SPEEDS = (8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 22.0)
BASE = {"nodes": 1, "particles": 8, "plants": 7, "ticks": 70}
"""Sizes of a generation; one at a time is varied."""
SIZES = {
    "nodes": (1, 2, 4, 8),
    "particles": (4, 8, 16, 32),
    "plants": (2, 4, 7, 14),
    "ticks": (17, 35, 70, 140),
}
STYLES = ((BLUE, "o", "-"), (ORANGE, "^", "--"), ("#56B4E9", "s", "-."), ("#009E73", "D", ":"))
"""Colour (Okabe and Ito), marker and line of each axis."""
Times = dict[str, list[float]]


def generation(sizes: dict[str, int]) -> list[FleetRun]:
    """Prepare a generation of the given sizes, with ticks of 0.1 s."""
    vehicle = load_vehicle_file(find("vehicles", "paper"))
    nodes = [Node(vehicle, "preview", "robust", v) for v in SPEEDS[: sizes["nodes"]]]
    rows = np.array([GENTLE] * sizes["particles"], dtype=float)
    return [repeat_for_gain_sets(shortened(prepared(node), sizes), rows) for node in nodes]


def shortened(fleet_run: FleetRun, sizes: dict[str, int]) -> FleetRun:
    """Keep the first plants and ticks of a node's drives."""
    fleet = map_rows(fleet_run.fleet, lambda array: array[: sizes["plants"]])
    ticks = np.minimum(fleet.ticks, sizes["ticks"])
    return fleet_run._replace(fleet=fleet._replace(ticks=ticks))


def seconds_of(expeditions: Sequence[FleetRun]) -> float:
    """Return the wall time of a generation, one node after the other [s]."""
    begin = perf_counter()
    for expedition in expeditions:
        run_fleet(expedition)
    return perf_counter() - begin


def growth(rounds: int) -> Times:
    """Return the median time of several rounds for each size, by axis [s]."""
    laid = {axis: [generation(BASE | {axis: n}) for n in sizes] for axis, sizes in SIZES.items()}
    return {
        axis: np.median(
            [[seconds_of(e) for e in all_sizes] for _ in range(rounds)], axis=0
        ).tolist()
        for axis, all_sizes in laid.items()
    }


def growth_exponents(times: Times) -> dict[str, float]:
    """Return the exponent of the growth of time, by axis: 1 is linear."""
    return {a: float(np.polyfit(np.log(SIZES[a]), np.log(times[a]), 1)[0]) for a in times}


def gain_of_threads(count: int, rounds: int) -> float:
    """Return the speed-up of a number of threads: the median of the ratios."""
    vehicle = load_vehicle_file(find("vehicles", "paper"))
    nodes = [Node(vehicle, "preview", "robust", v) for v in SPEEDS]
    rows = np.array([GENTLE] * 8, dtype=float)
    ratios = [_seconds(nodes, rows, 1) / _seconds(nodes, rows, count) for _ in range(rounds)]
    return float(np.median(ratios))


def _seconds(nodes: Sequence[Node], rows: Array, count: int) -> float:
    with open_workers(count) as workers:
        begin = perf_counter()
        tasks = [workers.executor.submit(fitness, node, rows) for node in nodes]
        for task in tasks:
            task.result()
        return perf_counter() - begin


def draw(times: Times, file: Path) -> None:
    """Draw time over size, relative to the smallest size, and the linear growth."""
    figure = Figure(figsize=(7, 5), layout="constrained", dpi=110)
    ax, powers = figure.subplots(), growth_exponents(times)
    ax.loglog((1, 8), (1, 8), color="#CCCCCC", linewidth=6, label="linear")
    for (axis, values), (color, marker, line) in zip(times.items(), STYLES, strict=True):
        label = f"{axis}, from {SIZES[axis][0]}: ~ size^{powers[axis]:.2f}"
        size, time = np.divide(SIZES[axis], SIZES[axis][0]), np.divide(values, values[0])
        ax.loglog(size, time, color=color, marker=marker, linestyle=line, label=label)
    ax.set_xticks((1, 2, 4, 8), ("1", "2", "4", "8"))
    ax.set_yticks((1, 2, 4, 8), ("1", "2", "4", "8"))
    ax.minorticks_off()
    ax.set_xlabel("size over the smallest")
    ax.set_ylabel("time of a generation over that of the smallest")
    ax.grid(alpha=0.3)
    ax.legend()
    figure.savefig(file)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and write the results; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/bench_tune"), help="folder")
    parser.add_argument("--rounds", type=int, default=9, help="number of rounds for the medians")
    chosen, console = parser.parse_args(arguments), Console(highlight=False)
    growth(1)  # compiles
    times, cores = growth(chosen.rounds), os.cpu_count() or 1
    gain = gain_of_threads(2, chosen.rounds)
    table = Table("axis", "sizes", "time [ms]", "growth", box=SIMPLE_HEAD)
    for axis, power in growth_exponents(times).items():
        milliseconds = ", ".join(f"{1000 * time:.1f}" for time in times[axis])
        table.add_row(axis, ", ".join(map(str, SIZES[axis])), milliseconds, f"size^{power:.2f}")
    console.print(table)
    console.print(f"speed-up of two threads: {gain:.2f}; {cores} cores")
    content: dict[str, Any] = {"base": BASE, "sizes": SIZES, "seconds": times, "cores": cores}
    content |= {"exponents": growth_exponents(times), "two_threads_over_one": gain}
    chosen.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(content, indent=1) + "\n"
    (chosen.output / "bench_tune.json").write_text(text, encoding="utf-8")
    draw(times, chosen.output / "bench_tune.png")
    console.print(f"written to {chosen.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
