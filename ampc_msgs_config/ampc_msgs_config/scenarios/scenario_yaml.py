"""Scenarios as YAML text in a recording, complete enough to repeat the drive bit for bit.

Long rows of numbers are stored as text, `x: '0.0 0.5 1.0'`, which is fast to read and exact.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any, NamedTuple

import numpy as np

from ampc_msgs_config import __version__
from ampc_msgs_config.config import build, dump, parse
from ampc_msgs_config.paths.curves import Lane
from ampc_msgs_config.scenarios.scenario import START_OFFSET, Scenario, SpeedProfile, check_profile
from ampc_msgs_config.scenarios.wind import Wind
from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import dotted, number

LONGEST_ROW = 1_000_000
"""Greatest number of values in a row of numbers."""


class DocumentHeader(NamedTuple):
    """First keys of a published configuration."""

    version: str
    number: int
    """Count of the configurations of a run."""


class PointRows(NamedTuple):
    """Points of a path as rows of numbers [m]."""

    x: str
    y: str


class ProfileRows(NamedTuple):
    """Speed profile as rows of numbers, see `SpeedProfile`."""

    over_distance: bool
    at: str
    speed: str
    period: Annotated[float, number(1.0e-3, math.inf, "m")]


class RecordedScenario(NamedTuple):
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
    header = {key: content.pop(key) for key in DocumentHeader._fields if key in content}
    return content, build(DocumentHeader, header, where).number


def scenario_content(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as YAML values."""
    over_distance, at, speed, period = scenario.speed
    rows = ProfileRows(bool(over_distance), row_text(at), row_text(speed), float(period))
    return {
        "name": scenario.name,
        "points": dict(zip("xy", map(row_text, scenario.points.T), strict=True)),
        "speed": rows._asdict(),
        "duration": float(scenario.duration),
        "wind": [asdict(piece) for piece in scenario.wind],
        "lanes": [
            dict(zip(Lane._fields, map(float, lane), strict=True)) for lane in scenario.lanes
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
    recorded = build(RecordedScenario, content, where, key)
    try:
        x, y = read_rows(recorded.points._asdict(), "points", least=2)
        at, speed = read_rows({k: getattr(recorded.speed, k) for k in ("at", "speed")}, "speed")
        profile = SpeedProfile(recorded.speed.over_distance, at, speed, recorded.speed.period)
        check_profile(profile)
    except ValueError as error:
        raise ValueError(f"{where}: {dotted(key, str(error))}") from error
    values = {**recorded._asdict(), "points": np.column_stack((x, y)), "speed": profile}
    return Scenario(**values)


def row_text(row: Array) -> str:
    """Write numbers so that each is read back to the bit."""
    return " ".join(map(repr, row.tolist()))


def read_rows(texts: Mapping[str, str], key: str, least: int = 1) -> list[Array]:
    """Read rows of finite numbers, equally long.

    Raises:
        ValueError: Key, value and bound.
    """
    rows: list[Array] = []
    for name, text in texts.items():
        at, words = f"{key}.{name}", text.split()
        if not least <= len(words) <= LONGEST_ROW:
            raise ValueError(f"{at} has {len(words)} numbers, must have {least} to {LONGEST_ROW}")
        try:
            rows.append(np.array([float(word) for word in words]))
        except ValueError as error:
            raise ValueError(f"{at}: {error}") from error
        if not np.isfinite(rows[-1]).all():
            i = int(np.argmin(np.isfinite(rows[-1])))
            raise ValueError(f"{at}[{i}] = {rows[-1][i]} must be finite")
        if len(rows[-1]) != len(rows[0]):
            raise ValueError(f"{at} has {len(words)} numbers, the row before it {len(rows[0])}")
    return rows
