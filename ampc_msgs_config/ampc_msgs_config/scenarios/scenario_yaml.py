"""A drive as values: whatever it was made of, this text is enough to drive it again.

Long rows of numbers stand as text, `x: '0.0 0.5 1.0'`: read in no time, and bit for bit.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import yaml

from ampc_msgs_config import __version__
from ampc_msgs_config.config import parsed
from ampc_msgs_config.paths.curves import Lane, bounded, check_known
from ampc_msgs_config.paths.path import Array
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedProfile, checked_profile
from ampc_msgs_config.scenarios.wind import read_wind

LONGEST = 1_000_000
"""Of a row."""


def document(content: Mapping[str, Any], number: int = 1) -> str:
    """Write what a node tells of its configuration.

    Args:
        content: What the run is made of.
        number: Counts the configurations of a run.
    """
    told = {"version": __version__, "number": number, **content}
    return str(yaml.safe_dump(told, sort_keys=False, width=math.inf))


def read_document(text: str, where: str, keys: Iterable[str]) -> dict[str, Any]:
    """Read what `document` wrote.

    Args:
        text: YAML.
        where: It comes from, for the message.
        keys: That it must have besides `version` and `number`, and no others.

    Raises:
        ValueError: Names place and key.
    """
    content, known = parsed(text, where), ("version", "number", *keys)
    check_known(content, known, where)
    require(content, known, where)
    return content


def require(content: Mapping[str, Any], keys: Iterable[str], where: str) -> None:
    """Raise a ValueError where a key is missing."""
    for key in keys:
        if key not in content:
            raise ValueError(f"{where}: missing key {key!r}")


def mapping_of(scenario: Scenario) -> dict[str, Any]:
    """Give a scenario as YAML can hold it."""
    (over_distance, at, speed, period), (x, y) = scenario.speed, scenario.points.T
    return {
        "name": scenario.name,
        "points": {"x": text_of(x), "y": text_of(y)},
        "speed": {
            "over_distance": bool(over_distance),
            "at": text_of(at),
            "speed": text_of(speed),
            "period": float(period),
        },
        "duration": float(scenario.duration),
        "wind": [piece._asdict() for piece in scenario.wind],
        "lanes": [
            {key: float(at) for key, at in lane._asdict().items()} for lane in scenario.lanes
        ],
        "start_offset": float(scenario.start_offset),
    }


def scenario_of(content: Any, where: str) -> Scenario:
    """Give the scenario of a mapping, bit for bit.

    Args:
        content: What `mapping_of` gave.
        where: It comes from, for the message.

    Raises:
        ValueError: Names place, key, value and bound.
    """
    check_known(content, Scenario._fields, where)
    require(content, Scenario._fields, where)
    try:
        return Scenario(
            name=str(content["name"]),
            points=_points(content["points"]),
            speed=_profile(content["speed"]),
            duration=bounded(content, "duration", 0.1, 1.0e6),
            wind=read_wind(content["wind"]),
            lanes=tuple(_lane(each) for each in _list(content["lanes"], "lanes")),
            start_offset=bounded(content, "start_offset", -100.0, 100.0),
        )
    except KeyError as error:
        raise ValueError(f"{where}: missing key {error}") from error
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def text_of(row: Array) -> str:
    """Write numbers, each so that it is read back to the bit."""
    return " ".join(map(repr, row.tolist()))


def row_of(content: Mapping[str, Any], key: str) -> Array:
    """Read a row of finite numbers.

    Raises:
        ValueError: Names key, value and bound.
    """
    text = content[key]
    if not isinstance(text, str):
        raise ValueError(f"{key} = {text!r} must be numbers in one text")
    words = text.split()
    if not 1 <= len(words) <= LONGEST:
        raise ValueError(f"{key} has {len(words)} numbers, must have 1 to {LONGEST}")
    try:
        row = np.array([float(word) for word in words])
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error
    if not np.isfinite(row).all():
        i = int(np.argmin(np.isfinite(row)))
        raise ValueError(f"{key}[{i}] = {row[i]} must be finite")
    return row


def _points(content: Any) -> Array:
    check_known(content, ("x", "y"), "points")
    x, y = row_of(content, "x"), row_of(content, "y")
    if len(x) != len(y):
        raise ValueError(f"points: x has {len(x)} numbers and y {len(y)}, must be as many")
    if len(x) < 2:
        raise ValueError(f"points: {len(x)} given, must be at least 2")
    return np.column_stack((x, y))


def _profile(content: Any) -> SpeedProfile:
    check_known(content, SpeedProfile._fields, "speed")
    over_distance = content["over_distance"]
    if not isinstance(over_distance, bool):
        raise ValueError(f"speed: over_distance = {over_distance!r} must be true or false")
    at, speed = row_of(content, "at"), row_of(content, "speed")
    if len(at) != len(speed):
        raise ValueError(f"speed: at has {len(at)} numbers and speed {len(speed)}")
    period = bounded(content, "period", 1.0e-3, math.inf)
    return checked_profile(SpeedProfile(over_distance, at, speed, period))


def _lane(content: Any) -> Lane:
    check_known(content, Lane._fields, "lanes")
    return Lane(*(bounded(content, key, -1.0e6, 1.0e6) for key in Lane._fields))


def _list(content: Any, key: str) -> list[Any]:
    if not isinstance(content, list):
        raise ValueError(f"{key} = {content!r} must be a list")
    return content
