"""Proof before use: a tuned table against one gain set, chance, Table 3 and what is shipped."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table as Lines

from ampc_msgs_config.types import Array
from ampc_ros.configuration import DEFAULT_TABLES
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from launch_scripts.tuning.fitness import Node, fitness
from launch_scripts.tuning.search import Found
from launch_scripts.tuning.task import (
    RANDOM,
    SINGLE,
    TABLE,
    Task,
    geometric_mean,
    held_out,
    jobs_of,
    lookup,
    nodes_of,
    reached,
)
from launch_scripts.tuning.workers import Workers

WORTH = 0.10
"""Share by which a table has to beat the single gain set."""
NO_SINGLE = "no single set found"
Content = dict[tuple[float, float], Gains]
Outcome = dict[str, Found]


class Candidate(NamedTuple):
    """Gains by speed and lateral reference that are judged."""

    name: str
    table: GainTable
    fitness: tuple[float, ...] = ()
    """At the reached nodes of the grid."""
    held_out: tuple[float, ...] = ()
    """Half-way between its speeds."""

    @property
    def overall(self) -> float:
        """Geometric mean over the nodes and half-way between them."""
        return mean((*self.fitness, *self.held_out))

    @property
    def at_nodes(self) -> float:
        """Geometric mean over the nodes; infinite where a car is lost at one of them."""
        return mean(self.fitness)

    @property
    def between(self) -> float:
        """The same half-way between the speeds, which no search saw; of one speed the node."""
        return mean(self.held_out or self.fitness)


class Report(NamedTuple):
    """What a tuning came to."""

    table: Candidate
    single: Candidate
    others: tuple[Candidate, ...]
    """The same with other seeds, and what they are compared with."""
    found: Content
    """Gains of the table's nodes that have some."""
    not_reached: tuple[tuple[float, float], ...]
    """Speed and lateral reference of the others."""

    @property
    def gain(self) -> float:
        """Share of the single set's fitness that the table saves, at the nodes and between them.

        Note:
            The speeds between the nodes alone would leave out both ends of the range, where one
            set for all speeds is worst.
        """
        table, single = self.table.overall, self.single.overall
        if math.isinf(single):
            return 1.0
        return -math.inf if math.isinf(table) else 1.0 - table / single

    @property
    def is_table(self) -> bool:
        """Whether the table is worth its nodes, also where no search has been.

        Otherwise the single set is written.
        """
        return self.gain >= WORTH and self.table.between <= self.single.between

    @property
    def verdict(self) -> str:
        """In one sentence."""
        if math.isinf(self.single.overall):
            return "no single gain set brings every car through: table written"
        if self.is_table:
            return f"the table beats the best single gain set by {self.gain:.0%}: table written"
        if self.gain >= WORTH:
            return (
                "between its nodes the table is worse than the best single set: single set written"
            )
        return (
            f"the table does not beat the best single gain set by {WORTH:.0%} "
            f"({self.gain:.0%}): single gain set written"
        )


def mean(values: Sequence[float]) -> float:
    """Geometric mean."""
    return float(geometric_mean(np.array(values)))


def content_of(task: Task, outcome: Outcome, purpose: str, seed: int) -> Content:
    """Gains of the nodes where a car came through, by speed and lateral reference."""
    return {
        (job.nodes[0].speed, job.nodes[0].reference): outcome[job.name].gains
        for job in jobs_of(task)
        if (job.purpose, job.seed) == (purpose, seed) and math.isfinite(outcome[job.name].fitness)
    }


def prove(task: Task, outcome: Outcome, workers: Workers) -> Report:
    """Judge what was found.

    Raises:
        ValueError: At no node any car came through.
    """
    contents = {
        (purpose, seed): content_of(task, outcome, purpose, seed)
        for purpose in (TABLE, RANDOM, SINGLE)
        for seed in task.seeds
    }
    if not any(contents[TABLE, seed] for seed in task.seeds):
        raise ValueError("search: every car was lost at every node: other bounds are needed")
    candidates = [
        Candidate(f"{purpose}, seed {seed}", lookup(content, task))
        for (purpose, seed), content in contents.items()
        if content
    ] + compared(task)
    candidates = judge(task, candidates, workers)
    best = {p: _best(candidates, p) for p in (TABLE, SINGLE)}
    table, single = best[TABLE], best[SINGLE]
    assert table is not None
    if single is None:  # every one loses a car somewhere
        single = Candidate(NO_SINGLE, table.table, (math.inf,), (math.inf,))
    found = contents[TABLE, int(table.name.split()[-1])]
    others = tuple(item for item in candidates if item not in (table, single))
    places = [(node.speed, node.reference) for node in nodes_of(task)]
    missing = tuple(place for place in places if place not in found)
    return Report(table, single, others, found, missing)


def _best(candidates: Sequence[Candidate], purpose: str) -> Candidate | None:
    mine = [item for item in candidates if item.name.startswith(f"{purpose}, ")]
    return min(mine, key=lambda item: item.overall) if mine else None


def compared(task: Task) -> list[Candidate]:
    """Give Table 3, and the table that comes with the formulation if that is another one."""
    names = list(dict.fromkeys(("table3", DEFAULT_TABLES[task.formulation])))
    return [Candidate(f"shipped {name}", load_gain_table(name)) for name in names]


def judge(task: Task, candidates: Sequence[Candidate], workers: Workers) -> list[Candidate]:
    """Fill in the fitness of all candidates."""
    at_nodes = _fitness([node for node in nodes_of(task) if reached(node)], candidates, workers)
    between = _fitness(held_out(task), candidates, workers)
    return [
        item._replace(
            fitness=tuple(at_nodes[:, i].tolist()), held_out=tuple(between[:, i].tolist())
        )
        for i, item in enumerate(candidates)
    ]


def _fitness(nodes: Sequence[Node], candidates: Sequence[Candidate], workers: Workers) -> Array:
    """Fitness (nodes, candidates), with the gains that each table has there."""
    rows = [[c.table.lookup(n.speed, n.reference).gains for c in candidates] for n in nodes]
    tasks = [
        workers.executor.submit(fitness, node, np.array(row, dtype=float))
        for node, row in zip(nodes, rows, strict=True)
    ]
    values = [task.result() for task in tasks]
    return np.array(values) if values else np.zeros((0, len(candidates)))


def lines_of(report: Report) -> Lines:
    """Give the report as a table for the screen."""
    lines = Lines("gains", "at the nodes", "between the speeds", "lost", box=SIMPLE_HEAD)
    for item in (report.table, report.single, *report.others):
        lost = sum(map(math.isinf, (*item.fitness, *item.held_out)))
        lines.add_row(item.name, f"{item.at_nodes:.4g}", f"{item.between:.4g}", str(lost or ""))
    return lines


def as_json(report: Report) -> dict[str, Any]:
    """Give the report as JSON holds it; an infinite fitness is null."""

    def plain(values: Sequence[float]) -> list[float | None]:
        return [value if math.isfinite(value) else None for value in values]

    return {
        "verdict": report.verdict,
        "not_reached": [list(place) for place in report.not_reached],
        "candidates": {
            item.name: {
                "geometric_mean": plain([item.at_nodes, item.between]),
                "fitness": plain(item.fitness),
                "held_out": plain(item.held_out),
                "gains": [list(gains) for gains in item.table.nodes],
            }
            for item in (report.table, report.single, *report.others)
        },
    }
