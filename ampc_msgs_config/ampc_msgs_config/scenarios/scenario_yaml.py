"""Scenarios as YAML text in a recording, complete enough to repeat the drive bit for bit.

Long rows of numbers are stored as text, `x: '0.0 0.5 1.0'`, which is fast to read and exact.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np

from ampc_msgs_config import __version__
from ampc_msgs_config.config import build, dump, parse
from ampc_msgs_config.paths.curves import Lane
from ampc_msgs_config.scenarios.scenario import START_OFFSET, Scenario, SpeedProfile, check_profile
from ampc_msgs_config.scenarios.wind import Wind
from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import Checked, dotted, number

LONGEST_ROW = 1_000_000
"""Greatest number of values in a row of numbers."""


@dataclass(frozen=True, kw_only=True)
class PointRows(Checked):
    """Points of a path as rows of numbers [m]."""

    x: str
    y: str


@dataclass(frozen=True, kw_only=True)
class ProfileRows(Checked):
    """Speed profile as rows of numbers, see `SpeedProfile`."""

    over_distance: bool
    at: str
    speed: str
    period: Annotated[float, number(1.0e-3, math.inf, "m")]


@dataclass(frozen=True, kw_only=True)
class RecordedScenario(Checked):
    """Scenario as `scenario_content` writes it."""

    name: str
    points: PointRows
    speed: ProfileRows
    duration: Annotated[float, number(0.1, 1.0e6, "s")]
    wind: tuple[Wind, ...]
    lanes: tuple[Lane, ...]
    start_offset: Annotated[float, START_OFFSET]


def document(content: Mapping[str, Any], number: int = 1) -> str:
    """Write the configuration that a node publishes.

    Args:
        content: Configuration as YAML values.
        number: Count of the configurations of a run.
    """
    return dump({"version": __version__, "number": number, **content}, width=math.inf)


def read_document(text: str, where: str) -> tuple[dict[str, Any], int]:
    """Read what `document` wrote: the content without its header, and the number.

    Args:
        text: YAML.
        where: Source of the text, for the message.

    Raises:
        ValueError: Source, key and value.
    """
    content = parse(text, where)
    for key, kind in (("version", str), ("number", int)):
        if key not in content:
            raise ValueError(f"{where}: missing key {key!r}")
        if type(content[key]) is not kind:
            what = "text" if kind is str else "a whole number"
            raise ValueError(f"{where}: {key} = {content[key]!r} must be {what}")
    del content["version"]
    return content, content.pop("number")


def scenario_content(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as YAML values."""
    (over_distance, at, speed, period), (x, y) = scenario.speed, scenario.points.T
    return {
        "name": scenario.name,
        "points": {"x": row_text(x), "y": row_text(y)},
        "speed": {
            "over_distance": bool(over_distance),
            "at": row_text(at),
            "speed": row_text(speed),
            "period": float(period),
        },
        "duration": float(scenario.duration),
        "wind": [asdict(piece) for piece in scenario.wind],
        "lanes": [
            {key: float(at) for key, at in lane._asdict().items()} for lane in scenario.lanes
        ],
        "start_offset": float(scenario.start_offset),
    }


def read_scenario(content: Any, where: str, key: str = "") -> Scenario:
    """Return the scenario of YAML values, bit for bit.

    Args:
        content: Values that `scenario_content` wrote.
        where: Source of the content, for the message.
        key: Dotted key of the content in its source, for the message.

    Raises:
        ValueError: Source, key, value and bound.
    """
    rows = build(RecordedScenario, content, where, key)
    try:
        x, y = read_row(rows.points.x, "points.x"), read_row(rows.points.y, "points.y")
        at, speed = read_row(rows.speed.at, "speed.at"), read_row(rows.speed.speed, "speed.speed")
        for name, row, other in (("points.x", x, y), ("speed.at", at, speed)):
            if len(row) != len(other):
                raise ValueError(f"{name} has {len(row)} numbers, its other row {len(other)}")
        if len(x) < 2:
            raise ValueError(f"points.x has {len(x)} numbers, must have at least 2")
        profile = check_profile(
            SpeedProfile(rows.speed.over_distance, at, speed, rows.speed.period)
        )
    except ValueError as error:
        raise ValueError(f"{where}: {dotted(key, str(error))}") from error
    return Scenario(
        name=rows.name,
        points=np.column_stack((x, y)),
        speed=profile,
        duration=rows.duration,
        wind=rows.wind,
        lanes=rows.lanes,
        start_offset=rows.start_offset,
    )


def row_text(row: Array) -> str:
    """Write numbers so that each is read back to the bit."""
    return " ".join(map(repr, row.tolist()))


def read_row(text: str, key: str) -> Array:
    """Read a row of finite numbers.

    Raises:
        ValueError: Key, value and bound.
    """
    words = text.split()
    if not 1 <= len(words) <= LONGEST_ROW:
        raise ValueError(f"{key} has {len(words)} numbers, must have 1 to {LONGEST_ROW}")
    try:
        row = np.array([float(word) for word in words])
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error
    if not np.isfinite(row).all():
        i = int(np.argmin(np.isfinite(row)))
        raise ValueError(f"{key}[{i}] = {row[i]} must be finite")
    return row
