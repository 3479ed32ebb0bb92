"""Proof and files of a tuning.

The tuned table is compared with the best single gain set, random sampling, Table 3 of the paper
and the shipped table. The report is shown on the screen and written as YAML and JSON.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import yaml
from rich.box import SIMPLE_HEAD
from rich.table import Table

from ampc_ros.configuration import DEFAULT_TABLES
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from launch_scripts.tuning.fitness import FITNESS, Node, fitness
from launch_scripts.tuning.search import SearchResult
from launch_scripts.tuning.task import (
    RANDOM,
    SINGLE,
    TABLE_SEARCH,
    TuningTask,
    geometric_mean,
    is_reachable,
)
from launch_scripts.tuning.workers import Workers

MIN_ADVANTAGE = 0.10
"""Share of the single set's fitness that a table must save."""
NO_SINGLE = "no single set found"


class Candidate(NamedTuple):
    """A gain table with its fitness."""

    name: str
    table: GainTable
    fitness: tuple[float, ...] = ()
    """Fitness at the reachable nodes of the grid."""
    held_out: tuple[float, ...] = ()
    """Fitness half-way between the speeds of the grid."""

    @property
    def overall(self) -> float:
        """Geometric mean over the nodes and the held-out speeds."""
        return mean((*self.fitness, *self.held_out))

    @property
    def at_nodes(self) -> float:
        """Geometric mean over the nodes; infinite where a car leaves the road at one of them."""
        return mean(self.fitness)

    @property
    def between(self) -> float:
        """Geometric mean over the held-out speeds; with a single speed, the fitness there."""
        return mean(self.held_out or self.fitness)


class TuningReport(NamedTuple):
    """Result of a tuning."""

    table: Candidate
    """The best tuned table."""
    single: Candidate
    """The best single gain set."""
    others: tuple[Candidate, ...]
    """Results of the other seeds, random sampling, and shipped tables."""
    not_reached: tuple[tuple[float, float], ...]
    """Speed and lateral reference of the nodes without gains of their own."""

    @property
    def advantage(self) -> float:
        """Share of the single set's fitness that the table saves, over nodes and held-out speeds.

        Note:
            The held-out speeds alone would omit both ends of the speed range, where a single set
            is worst.
        """
        table, single = self.table.overall, self.single.overall
        if math.isinf(single):
            return 1.0
        return -math.inf if math.isinf(table) else 1.0 - table / single

    @property
    def is_table(self) -> bool:
        """True if the table is written: better by MIN_ADVANTAGE, not worse at held-out speeds.

        Otherwise the single set is written.
        """
        return self.advantage >= MIN_ADVANTAGE and self.table.between <= self.single.between

    @property
    def verdict(self) -> str:
        """The decision and its reason in one sentence."""
        if math.isinf(self.single.overall):
            return "no single gain set brings every car through: table written"
        if self.is_table:
            gain = f"{self.advantage:.0%}"
            return f"the table beats the best single gain set by {gain}: table written"
        if self.advantage >= MIN_ADVANTAGE:
            reason = "between its nodes the table is worse than the best single set"
            return f"{reason}: single set written"
        return (
            f"the table does not beat the best single gain set by {MIN_ADVANTAGE:.0%} "
            f"({self.advantage:.0%}): single gain set written"
        )

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """All candidates, the table first."""
        return (self.table, self.single, *self.others)

    def screen_table(self) -> Table:
        """Return the table for the screen."""
        table = Table("gains", "at the nodes", "between the speeds", "lost", box=SIMPLE_HEAD)
        for item in self.candidates:
            lost = sum(map(math.isinf, (*item.fitness, *item.held_out)))
            table.add_row(item.name, f"{item.at_nodes:.4g}", f"{item.between:.4g}", str(lost or ""))
        return table

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON values; an infinite fitness is null."""
        return {
            "verdict": self.verdict,
            "not_reached": [list(node) for node in self.not_reached],
            "candidates": {
                item.name: {
                    "geometric_mean": finite((item.at_nodes, item.between)),
                    "fitness": finite(item.fitness),
                    "held_out": finite(item.held_out),
                    "gains": [list(gains) for gains in item.table.nodes],
                }
                for item in self.candidates
            },
        }


def mean(values: Sequence[float]) -> float:
    """Return the geometric mean."""
    return float(geometric_mean(np.array(values)))


def finite(values: Iterable[float], digits: int = 17) -> list[float | None]:
    """Return values of a number of digits for JSON or YAML; an infinite one is null."""
    return [float(f"{each:.{digits}g}") if math.isfinite(each) else None for each in values]


def prove(task: TuningTask, results: dict[str, SearchResult], workers: Workers) -> TuningReport:
    """Compare the tables built from the search results, by name of the search.

    Raises:
        ValueError: Every car left the road at every node.
    """
    # gains by speed and lateral reference, for each purpose and seed
    gains: dict[tuple[str, int], dict[tuple[float, float], Gains]] = {
        (purpose, seed): {} for purpose in (TABLE_SEARCH, RANDOM, SINGLE) for seed in task.seeds
    }
    for search in task.searches():
        found, value = results[search.name]
        if math.isfinite(value):
            node = search.nodes[0]
            gains[search.purpose, search.seed][node.speed, node.reference] = found
    if not any(gains[TABLE_SEARCH, seed] for seed in task.seeds):
        raise ValueError("search: every car was lost at every node: choose other bounds")
    # all candidates, evaluated at the nodes and half-way between them
    tables = {
        f"{purpose}, seed {seed}": task.build_table(content)
        for (purpose, seed), content in gains.items()
        if content
    }
    for name in ("table3", DEFAULT_TABLES[task.formulation]):
        tables[f"shipped {name}"] = load_gain_table(name)
    nodes = task.nodes()
    at_nodes = evaluate_tables(tables, [node for node in nodes if is_reachable(node)], workers)
    between = evaluate_tables(tables, task.held_out_nodes(), workers)
    candidates = [Candidate(n, tables[n], at_nodes[n], between[n]) for n in tables]
    # the best table and the best single set over all seeds
    table, single = (
        min(
            (item for item in candidates if item.name.startswith(f"{purpose}, ")),
            key=lambda item: item.overall,
            default=None,
        )
        for purpose in (TABLE_SEARCH, SINGLE)
    )
    assert table is not None
    if single is None:  # each single set loses a car at one node
        single = Candidate(NO_SINGLE, table.table, (math.inf,), (math.inf,))
    others = tuple(item for item in candidates if item not in (table, single))
    own = gains[TABLE_SEARCH, int(table.name.split()[-1])]
    places = [(node.speed, node.reference) for node in nodes]
    return TuningReport(table, single, others, tuple(at for at in places if at not in own))


def evaluate_tables(
    tables: dict[str, GainTable], nodes: Sequence[Node], workers: Workers
) -> dict[str, tuple[float, ...]]:
    """Return the fitness of each table at some nodes."""
    rows = [
        [table.lookup(node.speed, node.reference).gains for table in tables.values()]
        for node in nodes
    ]
    futures = [
        workers.executor.submit(fitness, node, np.array(row, dtype=float))
        for node, row in zip(nodes, rows, strict=True)
    ]
    columns = np.reshape([future.result() for future in futures], (len(nodes), len(tables))).T
    return dict(zip(tables, map(tuple, columns.tolist()), strict=True))


def provenance(task: TuningTask, report: TuningReport, command: str) -> dict[str, Any]:
    """Return the origin of the gains as YAML values.

    The fitness is in the order of the rows of the table, null where a node is not reachable.
    """
    best = report.table if report.is_table else report.single
    at_nodes = iter(report.table.fitness)
    return {
        "command": command,
        **task.describe(),
        "fitness_unit": FITNESS[task.kind],
        "verdict": report.verdict,
        "best_seed": int(best.name.split()[-1]),
        "nodes_not_reached": [list(node) for node in report.not_reached],
        "node_fitness": finite(
            (next(at_nodes) if is_reachable(node) else math.inf for node in task.nodes()), 4
        ),
        "geometric_mean": {
            item.name: finite((item.at_nodes, item.between), 4) for item in report.candidates
        },
    }


def table_yaml(task: TuningTask, report: TuningReport, origin: dict[str, Any]) -> str:
    """Return the YAML text of the table, or of the single gain set if that is the verdict.

    Args:
        task: The task.
        report: Its result.
        origin: Provenance.
    """
    lines = [
        f"# Gains of the {task.formulation} formulation for vehicle {origin['vehicle']}, "
        "found by particle swarm.",
        f"# {report.verdict[0].upper()}{report.verdict[1:]}.",
        f"# Again: {origin['command']}",
    ]
    if report.is_table:
        with_references = len(task.references) > 1
        lines.append(f"speed: {list(task.speeds)} # m/s")
        if with_references:
            lines.append(f"lateral_reference: {list(task.references)} # m")
        lines.append("gains:")
        nodes = [(v, y) for v in task.speeds for y in task.references]
        for (v, y), gains in zip(nodes, report.table.table.nodes, strict=True):
            note = f"{v:g} m/s" + (f", {y:g} m" if with_references else "")
            missing = ": NOT REACHED, its neighbour's" if (v, y) in report.not_reached else ""
            lines.append(f"  - {_gains_yaml(gains)} # {note}{missing}")
    else:  # both ends of the grid, so that a speed outside them is reported
        ends = sorted({task.speeds[0], task.speeds[-1]})
        row = _gains_yaml(report.single.table.nodes[0])
        lines += [f"speed: {ends} # m/s", "gains:", *(f"  - {row}" for _ in ends)]
    text = yaml.safe_dump({"provenance": origin}, width=100, sort_keys=False,
                          default_flow_style=None)  # fmt: skip
    return "\n".join([*lines, text])


def _gains_yaml(gains: Gains) -> str:
    """Return a row; YAML 1.1 would read a number such as `1e-05` as a string."""
    texts = {key: repr(value) for key, value in gains._asdict().items()}
    fields = [
        f"{key}: {text.replace('e', '.0e') if 'e' in text and '.' not in text else text}"
        for key, text in texts.items()
    ]
    return f"{{{', '.join(fields)}}}"
