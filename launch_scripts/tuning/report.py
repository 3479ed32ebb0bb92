"""Proof and files of a tuning.

The tuned table is judged by `table_rule`: against the best single gain set and the hand-set gains,
on plants and at speeds that no search has used. The report is shown on the screen and written as
YAML and JSON.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import yaml
from rich.box import SIMPLE_HEAD
from rich.table import Table

from ampc_msgs_config.config import shipped
from ampc_ros.configuration import DEFAULT_TABLES
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from launch_scripts.tuning.choices import FITNESS, SETTINGS
from launch_scripts.tuning.fitness import JUDGED, Node, fitness
from launch_scripts.tuning.search import SearchResult
from launch_scripts.tuning.smoothness import smoothest
from launch_scripts.tuning.table_rule import MAX_LOSS, MIN_SAVING, saving, worst_ratio
from launch_scripts.tuning.task import (
    POLISH,
    SINGLE,
    TABLE_SEARCH,
    Search,
    TuningTask,
    geometric_mean,
    is_reachable,
    sample_time,
)
from launch_scripts.tuning.workers import Workers

NO_SINGLE = "no single set found"


class Candidate(NamedTuple):
    """A gain table with its fitness."""

    name: str
    table: GainTable
    fitness: tuple[float, ...] = ()
    """Fitness at the reachable nodes of the grid, on the training plants."""
    held_out: tuple[float, ...] = ()
    """Fitness at the same nodes, on the held-out plants."""
    between: tuple[float, ...] = ()
    """Fitness half-way between the speeds of the grid, on the held-out plants."""

    @property
    def judged(self) -> tuple[float, ...]:
        """Fitness that decides about saving: between the speeds; of one speed, at that speed."""
        return self.between or self.held_out


class TuningReport(NamedTuple):
    """Result of a tuning."""

    table: Candidate
    """The best tuned table."""
    single: Candidate
    """The best single gain set."""
    hand_set: Candidate
    """Gains that are compared at each speed."""
    others: tuple[Candidate, ...]
    """Results of the other seeds, and Table 3."""
    not_reached: tuple[tuple[float, float], ...]
    """Speed and lateral reference of the nodes without gains of their own."""
    kind: str = "robust"
    """Key of FITNESS; only `robust` has held-out plants."""

    @property
    def judged_on(self) -> str:
        """What decides: the drives of a search are never repeated for the decision."""
        return "on held-out plants" if self.kind == "robust" else "at speeds between the nodes"

    @property
    def saving(self) -> float:
        """Share of the single set's fitness that the table saves between the nodes."""
        return saving(self.table.judged, self.single.judged)

    @property
    def is_table(self) -> bool:
        """True if the table is written, by `table_rule`; otherwise the single set is written."""
        return self.saving >= MIN_SAVING and self.loss(self.table) <= MAX_LOSS

    @property
    def written(self) -> Candidate:
        """The candidate whose gains are written."""
        return self.table if self.is_table else self.single

    def loss(self, candidate: Candidate) -> float:
        """Return the largest share by which a candidate is worse than the hand-set gains."""
        ours = (*candidate.held_out, *candidate.between)
        return worst_ratio(ours, (*self.hand_set.held_out, *self.hand_set.between)) - 1.0

    @property
    def verdict(self) -> str:
        """The decision and its reason in one sentence."""
        if not any(map(math.isfinite, self.single.judged)):
            return "no single gain set brings every car through: table written"
        if math.isinf(self.saving):
            return f"the table loses a car {self.judged_on}: single gain set written"
        saved = f"{round(100 * self.saving)}%"
        if self.is_table:
            better = "the table beats the best single gain set"
            return f"{better} by {saved} {self.judged_on}: table written"
        if self.saving < MIN_SAVING:
            return (
                f"the table does not beat the best single gain set by {MIN_SAVING:.0%} "
                f"{self.judged_on} ({saved}): single gain set written"
            )
        reason = f"at one speed the table is {worse(self.loss(self.table))} than the hand-set gains"
        return f"{reason}: single gain set written"

    @property
    def warning(self) -> str:
        """What the hand-set gains do better than the written ones; empty: nothing."""
        lost, name = self.loss(self.written), self.hand_set.name.removeprefix("shipped ")
        if lost <= MAX_LOSS:
            return ""
        return f"at one speed or more the written gains are {worse(lost)} than the hand-set {name}"

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """All candidates, the table first."""
        return (self.table, self.single, self.hand_set, *self.others)

    def screen_table(self) -> Table:
        """Return the table for the screen."""
        other = "held-out" if self.kind == "robust" else "the same"
        headings = "gains", "training: at the nodes", f"{other}: at the nodes", "between", "lost"
        table = Table(*headings, box=SIMPLE_HEAD)
        for item in self.candidates:
            values = item.fitness, item.held_out, item.between
            lost = sum(map(math.isinf, (*item.held_out, *item.between)))
            cells = [f"{mean(each):.4g}" if each else "" for each in values]
            table.add_row(item.name, *cells, str(lost or ""))
        return table

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON values; an infinite fitness is null."""
        return {
            "verdict": self.verdict,
            "warning": self.warning,
            "saving": finite([self.saving])[0],
            "written": self.written.name,
            "worse_than_hand_set": finite([self.loss(self.written)])[0],
            "not_reached": [list(node) for node in self.not_reached],
            "candidates": {
                item.name: {
                    "geometric_mean": finite(means(item)),
                    "fitness": finite(item.fitness),
                    "held_out": finite(item.held_out),
                    "between": finite(item.between),
                    "gains": [list(gains) for gains in item.table.nodes],
                }
                for item in self.candidates
            },
        }


def worse(loss: float) -> str:
    """Return in words by how much gains are worse; infinite: they lose a car."""
    if math.isinf(loss):
        return "worse (they lose a car)"
    return f"{1.0 + loss:.0f} times worse" if loss >= 1.0 else f"up to {loss:.1%} worse"


def means(item: Candidate) -> list[float]:
    """Return the geometric means of training, and of held-out plants at and between the nodes."""
    return [mean(item.fitness), mean(item.held_out), mean(item.between)]


def mean(values: Sequence[float]) -> float:
    """Return the geometric mean; not a number of no values."""
    return float(geometric_mean(np.array(values))) if len(values) else math.nan


def finite(values: Iterable[float], digits: int = 17) -> list[float | None]:
    """Return values of a number of digits for JSON or YAML; an infinite one is null."""
    return [float(f"{each:.{digits}g}") if math.isfinite(each) else None for each in values]


def choose_gains(
    task: TuningTask, results: Mapping[str, SearchResult]
) -> dict[tuple[str, int], dict[tuple[float, float], Gains]]:
    """Return the gains by speed and lateral reference, for each purpose and seed.

    Nodes at which each gain set loses a car are left out.
    """
    gains: dict[tuple[str, int], dict[tuple[float, float], Gains]] = {}
    for seed in task.seeds:
        at: dict[tuple[float, float], SearchResult] = {}
        for search in task.searches():
            if search.seed != seed:
                continue
            found = [pair for pair in results[search.name] if math.isfinite(pair[1])]
            node = search.nodes[0]
            if search.purpose == SINGLE:
                gains[SINGLE, seed] = {(node.speed, node.reference): found[0][0]} if found else {}
            elif found:
                polished = results.get(search.name.replace(TABLE_SEARCH, POLISH, 1), [])
                found += [pair for pair in polished if math.isfinite(pair[1])]
                at[node.speed, node.reference] = found
        best = [found[0][0] for found in at.values()]
        if task.is_smooth and at:
            best = smoothest(list(at.values()))
        gains[TABLE_SEARCH, seed] = dict(zip(at, best, strict=True))
    return gains


def polish_searches(task: TuningTask, results: Mapping[str, SearchResult]) -> list[Search]:
    """Return the searches that polish the nodes after the first searches; none without a table."""
    chosen = choose_gains(task, results)
    whole = len(task.nodes())
    return [
        search
        for seed in task.seeds
        if task.is_smooth and len(chosen[TABLE_SEARCH, seed]) == whole
        for search in task.polishes(seed, list(chosen[TABLE_SEARCH, seed].values()))
    ]


def prove(task: TuningTask, results: dict[str, SearchResult], workers: Workers) -> TuningReport:
    """Compare the tables built from the search results, by name of the search.

    Raises:
        ValueError: Every car left the road at every node.
    """
    gains = choose_gains(task, results)
    if not any(gains[TABLE_SEARCH, seed] for seed in task.seeds):
        raise ValueError("search: every car was lost at every node: choose other bounds")
    # all candidates, evaluated at the nodes and half-way between them
    tables = {
        f"{purpose}, seed {seed}": task.build_table(content)
        for (purpose, seed), content in gains.items()
        if content
    }
    for name in dict.fromkeys((hand_set_table(task), "table3")):
        if name != "table3" or task.settings == SETTINGS:
            tables[f"shipped {name}"] = load_gain_table(name)
    nodes = [node for node in task.nodes() if is_reachable(node)]
    judge = JUDGED if task.kind == "robust" else task.kind
    between = [node._replace(kind=judge) for node in task.held_out_nodes()]
    places = nodes, [node._replace(kind=judge) for node in nodes], between
    sets = [evaluate_tables(tables, group, workers) for group in places]
    candidates = {n: Candidate(n, tables[n], *(each[n] for each in sets)) for n in tables}
    # the best table and the best single set over all seeds, by their training
    best = {
        purpose: min(
            (item for item in candidates.values() if item.name.startswith(f"{purpose}, ")),
            key=lambda item: mean(item.fitness),
            default=None,
        )
        for purpose in (TABLE_SEARCH, SINGLE)
    }
    table, single = best[TABLE_SEARCH], best[SINGLE]
    assert table is not None
    if single is None:  # each single set loses a car at one node
        single = Candidate(NO_SINGLE, table.table, *[(math.inf,) * len(each) for each in places])
    hand_set = candidates[f"shipped {hand_set_table(task)}"]
    compared = (table, single, hand_set)
    others = tuple(item for item in candidates.values() if item not in compared)
    own = gains[TABLE_SEARCH, int(table.name.split()[-1])]
    at = [(node.speed, node.reference) for node in task.nodes()]
    not_reached = tuple(place for place in at if place not in own)
    report = TuningReport(*compared, others, not_reached, task.kind)
    if single.name == NO_SINGLE and not report.is_table:
        raise ValueError(
            "search: neither a table nor a single gain set brings every car through: choose other "
            "bounds or speeds"
        )
    return report


def hand_set_table(task: TuningTask) -> str:
    """Return the name of the hand-set gains of the formulation, for the period of the settings.

    Where none are shipped for this period the result is that of the default settings.
    """
    name, period = DEFAULT_TABLES[task.formulation], sample_time(task.settings)
    same = [f"{name}_{each}" for each in shipped("controllers") if sample_time(each) == period]
    return next((own for own in same if own in shipped("gains")), name)


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

    The fitness is that of the written gains at each speed and lateral reference of the task, the
    references fastest, null where a node is not reachable.
    """
    at_nodes = iter(report.written.fitness)
    return {
        "command": command,
        **task.describe(),
        "fitness_unit": FITNESS[task.kind],
        "verdict": report.verdict,
        "best_seed": int(report.written.name.split()[-1]),
        "worse_than_hand_set": finite([report.loss(report.written)], 3)[0],
        "nodes_not_reached": [list(node) for node in report.not_reached],
        "node_fitness": finite(
            (next(at_nodes) if is_reachable(node) else math.inf for node in task.nodes()), 4
        ),
        "geometric_mean": {item.name: finite(means(item), 4) for item in report.candidates},
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
        f"found by method {task.method}.",
        f"# {report.verdict[0].upper()}{report.verdict[1:]}.",
        *([f"# {report.warning[0].upper()}{report.warning[1:]}."] if report.warning else []),
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
    else:  # all speeds of the grid, at which a certificate checks the set
        row = _gains_yaml(report.single.table.nodes[0])
        lines += [f"speed: {list(task.speeds)} # m/s", "gains:", f"  - &same {row}"]
        lines += ["  - *same"] * (len(task.speeds) - 1)
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
