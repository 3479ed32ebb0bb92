"""The matrix of a comparison as a table for the terminal, as Markdown and as JSON."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from rich.text import Text

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find
from ampc_msgs_config.metrics import LOST
from ampc_msgs_config.scenarios.scenario import Scenario
from launch_scripts.comparing.cells import (
    QUANTITIES,
    Cell,
    Conditions,
    Contender,
    Quantity,
    best_of,
)
from launch_scripts.run.machine import describe_machine

MARK = "*"
"""Behind the smallest number of a scenario."""


class Comparison(NamedTuple):
    """All that was driven."""

    command: str
    conditions: Conditions
    contenders: list[Contender]
    scenarios: list[Scenario]
    cells: list[Cell]
    """Scenario after scenario, the contenders of each in order."""

    @property
    def labels(self) -> list[str]:
        """Of the contenders."""
        return [contender.label for contender in self.contenders]

    def rows(self) -> Iterator[tuple[str, list[Cell]]]:
        """Give each scenario with its cells."""
        count = len(self.contenders)
        for i, scenario in enumerate(self.scenarios):
            yield scenario.name, self.cells[i * count : (i + 1) * count]


def number(cell: Cell, quantity: Quantity) -> str:
    """Give the number of a drive that was finished on the road, else what became of it."""
    return short(cell.numbers[quantity.key]) if cell.kept else cell.outcome


def short(value: float) -> str:
    """Give three digits, without an exponent as long as that is short."""
    if value == 0 or not 1e-4 <= abs(value) < 1e4:
        return f"{value:.3g}"
    return f"{value:.{max(2 - math.floor(math.log10(abs(value))), 0)}f}"


def shared(conditions: Conditions) -> str:
    """Say in words what all cells share."""
    friction = conditions.friction
    road = "friction of the tyres" if friction is None else f"friction {friction:g}"
    noise = f"noise {conditions.noise}, seed {conditions.seed}" if conditions.noise else "no noise"
    words = [f"vehicle {Path(conditions.vehicle).stem}", road, noise]
    if conditions.delay:
        words.append(f"{conditions.delay:g} s of unknown steering delay")
    return ", ".join(words)


def remarks(comparison: Comparison) -> list[str]:
    """Say who was lost, then who gave up."""
    lost = [
        f"{cell.scenario}, {cell.contender}: {cell.outcome}, largest error "
        f"{short(cell.numbers['max_error_m'])} m"
        for cell in comparison.cells
        if cell.numbers and not cell.kept
    ]
    return lost + reasons(comparison)


def reasons(comparison: Comparison) -> list[str]:
    """Say who gave up, and why."""
    return [
        f"{cell.scenario}, {cell.contender}: {cell.outcome}: {cell.reason}"
        for cell in comparison.cells
        if cell.reason
    ]


def table_of(comparison: Comparison, quantity: str) -> Table:
    """Lay out one quantity for the terminal."""
    what = QUANTITIES[quantity]
    words = f"{MARK} smallest of its scenario; lost: more than {LOST:g} m off the path"
    caption = "\n".join([words, *reasons(comparison)])
    title = f"{what.heading}; {shared(comparison.conditions)}"
    table = Table(title=Text(title), caption=Text(caption), title_justify="left")
    table.caption_justify = "left"
    table.add_column("scenario", no_wrap=True)
    for label in comparison.labels:
        table.add_column(Text(label.replace("=", "=\n")), justify="right", overflow="fold")
    for name, cells in comparison.rows():
        best = best_of(cells, what.key)
        table.add_row(Text(name), *(_cell(cell, what, cell.contender in best) for cell in cells))
    return table


def _cell(cell: Cell, quantity: Quantity, best: bool) -> Text:
    style = "bold green" if best else "" if cell.kept else "red"
    return Text(f"{number(cell, quantity)} {MARK if best else ' '}", style=style)


def markdown(comparison: Comparison) -> str:
    """Write all matrices."""
    lines = [
        "# Controllers and scenarios",
        "",
        f"`{comparison.command}`: {shared(comparison.conditions)}; AMPC for ROS 2 {__version__}. "
        "Every cell drives the same car with the same seed. Errors are those of the real car, "
        "without the noise of the measurement. Bold: smallest of its scenario. Lost: more than "
        f"{LOST:g} m off the path at some time.",
    ]
    for quantity in QUANTITIES.values():
        lines += ["", f"## {quantity.label} [{quantity.unit}]", ""]
        lines += [quantity.note, ""] if quantity.note else []
        lines += _matrix(comparison, quantity)
    said = remarks(comparison)
    lines += ["", "## Not driven to the end on the road", "", *(f"* {line}" for line in said)]
    return "\n".join(lines if said else lines[:-3]) + "\n"


def _matrix(comparison: Comparison, quantity: Quantity) -> Iterator[str]:
    yield "| " + " | ".join(["scenario", *comparison.labels]) + " |"
    yield "|---" + "|---:" * len(comparison.labels) + "|"
    for name, cells in comparison.rows():
        best = best_of(cells, quantity.key)
        texts = [number(cell, quantity) for cell in cells]
        marked = [
            f"**{t}**" if c.contender in best else t for t, c in zip(texts, cells, strict=True)
        ]
        yield "| " + " | ".join([name, *marked]) + " |"


def content(comparison: Comparison) -> dict[str, Any]:
    """Give all numbers, and what is needed to repeat them, for JSON."""
    return {
        "version": __version__,
        "command": comparison.command,
        "machine": describe_machine(),
        "conditions": comparison.conditions._asdict(),
        "lost_beyond_m": LOST,
        "controllers": [_contender(contender) for contender in comparison.contenders],
        "scenarios": {s.name: {"duration_s": s.duration} for s in comparison.scenarios},
        "cells": [_cell_content(cell) for cell in comparison.cells],
    }


def _cell_content(cell: Cell) -> dict[str, Any]:
    numbers = {key: v if math.isfinite(v) else None for key, v in cell.numbers.items()}
    told = {"scenario": cell.scenario, "controller": cell.contender, "fate": cell.outcome}
    return {**told, "reason": cell.reason, **numbers}


def _contender(contender: Contender) -> dict[str, str]:
    gains = contender.gain_table
    contents = find("gains", gains).read_text(encoding="utf-8") if gains else ""
    return {**contender._asdict(), "gains": contents}
