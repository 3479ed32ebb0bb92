"""Compare the shipped tuned gains with their alternatives on plants that no search has seen.

`python -m launch_scripts.study.shipped_tables --update ampc_ros/doc/tables.md` reads the proof
beside each shipped table and searches the best possible gains at each speed on the same plants.
"""

import argparse
import json
import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from rich.console import Console

from ampc_msgs_config.config import find, read, shipped
from ampc_msgs_config.types import Array
from launch_scripts.reporting.pages import markdown_table
from launch_scripts.reporting.style import BLUE, ORANGE
from launch_scripts.tune import build_parser
from launch_scripts.tuning.fitness import JUDGED
from launch_scripts.tuning.methods import SearchRecord, run_method
from launch_scripts.tuning.task import TABLE_SEARCH, TuningTask, read_task

BEST_EVALUATIONS = 90
"""Evaluations of the search for the best possible gains at one speed."""
STYLES = {
    "table": (BLUE, "-"),
    "single": (ORANGE, "-"),
    "hand-set": ("#777777", "--"),
    "best possible": ("#000000", ":"),
}
"""Colour and line of the gains in the figure."""
HEADINGS = (
    *("gains", "written", "table", "single set", "hand-set", "best possible", "table saves"),
    *("written / best possible, worst speed", "written / hand-set, worst speed"),
)
INTRODUCTION = """\
# Shipped gain tables

Every tuned table was judged by the [rule](table_rule.md) that had been written before. Numbers are
the fitness on the 14 held-out plants (mean squared error plus effort [m2]; geometric mean of the
average and the worst drive), as the geometric mean over the speeds half-way between the nodes.
*Best possible* is a search of the tuned gains at each speed on the held-out plants themselves,
which nothing that is tuned on other plants can reach. The proof of each table, with the gains and
the fitness of all candidates at each speed, is the file `<table>.json` beside it in
`ampc_msgs_config/ampc_msgs_config/config/gains/`.
"""


class Judged(NamedTuple):
    """A shipped table with its proof and the best possible fitness."""

    name: str
    proof: dict[str, Any]
    speeds: Array
    """Nodes and the speeds between them (n,), increasing."""
    fitness: dict[str, Array]
    """Fitness (n,) on the held-out plants by key of STYLES."""
    between: npt.NDArray[np.intp]
    """Indices of the speeds between the nodes."""

    def mean(self, key: str) -> float:
        """Return the geometric mean between the nodes."""
        return float(np.exp(np.log(self.fitness[key][self.between]).mean()))

    def worst(self, reference: str) -> float:
        """Return the largest ratio of the written gains to a reference, over all speeds."""
        written = self.proof["written"].partition(",")[0]
        return float(np.max(self.fitness[written] / self.fitness[reference]))


def judged_tables() -> list[str]:
    """Return the shipped tables of `preview` that have a proof."""
    return [name for name in shipped("gains") if name != "paper_pso" and proof_file(name).is_file()]


def proof_file(name: str) -> Path:
    """Return the file of the proof of a shipped table."""
    return find("gains", name).with_suffix(".json")


def task_of(name: str) -> TuningTask:
    """Return the task whose command is in the provenance of a shipped table."""
    words = read(find("gains", name))["provenance"]["command"].split()[2:]
    return read_task(build_parser().parse_args(words))


def best_possible(name: str, speed: float) -> float:
    """Return the best fitness that a search finds on the held-out plants at one speed [m/s]."""
    task = task_of(name)
    nodes = tuple(node._replace(kind=JUDGED) for node in task.nodes((speed,)))
    search = task.search(TABLE_SEARCH, 1, 0, nodes, BEST_EVALUATIONS)
    record = SearchRecord(search.cost, search.space.dimensions, BEST_EVALUATIONS)
    return run_method("pso", record, search.rng).best[1]


def judged_table(name: str, pool: ProcessPoolExecutor) -> Judged:
    """Read the proof of a shipped table and search the best possible gains."""
    proof = json.loads(proof_file(name).read_text(encoding="utf-8"))
    nodes = np.array(task_of(name).speeds)
    middle = (nodes[1:] + nodes[:-1]) / 2
    order = np.argsort(np.append(nodes, middle))
    found = [pool.submit(best_possible, name, v) for v in np.append(nodes, middle).tolist()]
    fitness = {"best possible": np.array([each.result() for each in found])[order]}
    for title, item in proof["candidates"].items():
        key = "hand-set" if title.startswith("shipped preview") else title.partition(",")[0]
        if key in STYLES and key not in fitness:  # the best seed comes first
            values = [math.inf if x is None else x for x in item["held_out"] + item["between"]]
            fitness[key] = np.array(values)[order]
    speeds = np.append(nodes, middle)[order]
    return Judged(name, proof, speeds, fitness, np.flatnonzero(order >= len(nodes)))


def table_lines(tables: Sequence[Judged]) -> list[str]:
    """Return the table in Markdown."""
    rows = [
        [
            f"`{item.name}`",
            item.proof["written"].partition(",")[0],
            *(f"{item.mean(key):.3e}" for key in STYLES),
            f"{item.proof['saving']:.1%}",
            f"{item.worst('best possible'):.2f}",
            f"{item.worst('hand-set'):.3f}",
        ]
        for item in tables
    ]
    return markdown_table(HEADINGS, rows, "lr")


def draw_tables(tables: Sequence[Judged], file: Path) -> None:
    """Draw the fitness over the speed, a panel for each shipped table."""
    columns = min(2, len(tables))
    rows = -(-len(tables) // columns)
    figure = Figure(figsize=(5.2 * columns, 3.8 * rows), layout="constrained", dpi=100)
    for ax, item in zip(figure.subplots(rows, columns, squeeze=False).flat, tables, strict=False):
        for key, (color, line) in STYLES.items():
            ax.plot(item.speeds, 1e3 * item.fitness[key], line, color=color, label=key)
        ax.set_title(f"{item.name}: {item.proof['written'].partition(',')[0]} written")
        ax.set_xscale("log")
        ax.set_xticks((3, 5, 10, 20, 40), ("3", "5", "10", "20", "40"))
        ax.minorticks_off()
        ax.set_ylim(bottom=0.0)
        ax.set_xlabel("speed [m/s]")
        ax.set_ylabel("fitness, held-out plants [1e-3 m2]")
        ax.grid(alpha=0.3)
        ax.legend()
    figure.savefig(file)


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge all shipped tables, print the table, write page and figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--update", type=Path, default=Path("runs/tables.md"), help="page to write")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    chosen, console = parser.parse_args(arguments), Console(highlight=False, soft_wrap=True)
    tables = []
    with ProcessPoolExecutor(chosen.workers) as pool:
        for name in judged_tables():
            console.print(f"{name}: searching the best possible gains")
            tables.append(judged_table(name, pool))
    lines = table_lines(tables)
    console.print("\n".join(lines), markup=False)
    picture = chosen.update.with_suffix(".png")
    chosen.update.parent.mkdir(parents=True, exist_ok=True)
    draw_tables(tables, picture)
    verdicts = [f"* `{item.name}`: {item.proof['verdict']}." for item in tables]
    verdicts += [
        f"* `{item.name}`: condition 2 of the rule is **not met**: {item.proof['warning']}."
        for item in tables
        if item.proof["warning"]
    ]
    command = "`python -m launch_scripts.study.shipped_tables --update ampc_ros/doc/tables.md`"
    figure = f"![fitness over speed]({picture.name})"
    parts = [INTRODUCTION, *lines, "", *verdicts, "", figure, "", f"Command: {command}.", ""]
    chosen.update.write_text("\n".join(parts), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
