"""A tuned gain table as YAML: what people read first, the gains, and where they come from."""

import math
from typing import Any

import yaml

from ampc_ros.mpc.gain_table import Gains
from launch_scripts.tuning.fitness import FITNESS
from launch_scripts.tuning.report import Report
from launch_scripts.tuning.task import Task, describe


def text_of(task: Task, report: Report, command: str) -> str:
    """Write the table, or the single gain set, whichever the report is for.

    Args:
        task: What was searched for.
        report: What was found.
        command: That gives this file again.
    """
    head = [
        f"# Gains of the {task.formulation} formulation for vehicle {describe(task)['vehicle']}, "
        "found by particle swarm.",
        f"# {report.verdict[0].upper()}{report.verdict[1:]}.",
        f"# Again: {command}",
    ]
    body = _table(task, report) if report.is_table else _single(task, report)
    provenance = yaml.safe_dump({"provenance": provenance_of(task, report, command)}, width=100,
                                sort_keys=False, default_flow_style=None)  # fmt: skip
    return "\n".join([*head, *body, provenance])


def provenance_of(task: Task, report: Report, command: str) -> dict[str, Any]:
    """Where the gains come from; fitness in the order of the rows, null where none is reached."""
    fitness = iter(report.table.fitness)
    return {
        "command": command,
        **describe(task),
        "fitness_unit": FITNESS[task.kind],
        "verdict": report.verdict,
        "best_seed": int((report.table if report.is_table else report.single).name.split()[-1]),
        "nodes_not_reached": [list(place) for place in report.not_reached],
        "node_fitness": [
            _short(next(fitness)) if abs(y) <= 2.0 * v else None
            for v in task.speeds
            for y in task.references
        ],
        "geometric_mean": {
            item.name: [_short(item.at_nodes), _short(item.between)]
            for item in (report.table, report.single, *report.others)
        },
    }


def _short(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def _table(task: Task, report: Report) -> list[str]:
    lines = [f"speed: {list(task.speeds)} # m/s"]
    if len(task.references) > 1:
        lines.append(f"lateral_reference: {list(task.references)} # m")
    lines.append("gains:")
    places = [(v, y) for v in task.speeds for y in task.references]
    for place, gains in zip(places, report.table.table.nodes, strict=True):
        note = f"{place[0]:g} m/s" + (f", {place[1]:g} m" if len(task.references) > 1 else "")
        missing = ": NOT REACHED, its neighbour's" if place in report.not_reached else ""
        lines.append(f"  - {_row(gains)} # {note}{missing}")
    return lines


def _single(task: Task, report: Report) -> list[str]:
    """The set at both ends of the grid: who leaves it shall hear of it."""
    ends = sorted({task.speeds[0], task.speeds[-1]})
    row = _row(report.single.table.nodes[0])
    return [f"speed: {ends} # m/s", "gains:", *(f"  - {row}" for _ in ends)]


def _row(gains: Gains) -> str:
    fields = ", ".join(f"{key}: {_number(value)}" for key, value in gains._asdict().items())
    return f"{{{fields}}}"


def _number(value: float) -> str:
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text
