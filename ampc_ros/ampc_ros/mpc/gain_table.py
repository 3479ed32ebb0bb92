"""Gains by speed and lateral reference, from YAML."""

import math
from collections.abc import Mapping
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config import config
from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.interpolation import section
from ampc_msgs_config.parameters import check_range

Array = NDArray[np.float64]

NONE = -1
"""Node in use before the first lookup."""
HYSTERESIS = 0.1
"""Share of the distance between two nodes by which another one must be nearer to be used."""


class Gains(NamedTuple):
    """Tunable parameters of the controller, in the paper's order N_p, N_c, N, alpha, Q, R."""

    prediction_horizon: int
    """N_p [ticks]."""
    control_horizon: int
    """N_c [ticks]."""
    laguerre_terms: int
    """N."""
    laguerre_pole: float
    """alpha."""
    output_weight: float
    """Q."""
    increment_weight: float
    """R."""


KEYS = ("speed", "lateral_reference", "gains", "provenance")
"""Of a table's file."""
INTEGERS = ("prediction_horizon", "control_horizon", "laguerre_terms")
BOUNDS: dict[str, dict[str, Any]] = {
    "prediction_horizon": {"low": 1, "high": 200, "unit": "ticks"},
    "control_horizon": {"low": 1, "high": 200, "unit": "ticks"},
    "laguerre_terms": {"low": 1, "high": 20, "unit": ""},
    "laguerre_pole": {"low": 0.0, "high": 0.999, "unit": ""},
    "output_weight": {"low": 1.0e-9, "high": 1.0e9, "unit": ""},
    "increment_weight": {"low": 1.0e-9, "high": 1.0e9, "unit": ""},
}


class Table(NamedTuple):
    """Gain table as arrays, for compiled code."""

    speeds: Array
    """(n,) increasing [m/s]."""
    references: Array
    """(m,) lateral references, increasing [m]."""
    nodes: Array
    """(n m, 6) gains; the reference index varies fastest."""


class Lookup(NamedTuple):
    """Gains, and whether the operating point lies outside the table."""

    gains: Gains
    outside: bool
    """Whether speed or reference lie outside the grid; the nearest edge was used."""


@in_place
def look_up(table: Table, in_use: Array, speed: float, reference: float) -> tuple[Gains, bool]:
    """Interpolate the gains at a speed and a lateral reference.

    Integers come from the nearest node, with hysteresis. Weights are interpolated in the logarithm,
    the pole linearly. Outside the grid the nearest edge is used. The gains of an axis with a single
    node hold everywhere.

    Args:
        table: The grid.
        in_use: (2,) indices of the node in use on the two axes, NONE at first; changed in place.
        speed: [m/s].
        reference: [m].

    Returns:
        The gains, and whether speed or reference lie outside the grid.
    """
    speeds, references, nodes = table
    outside = is_outside(speeds, speed) or is_outside(references, reference)
    in_use[0] = nearest_node(speeds, speed, int(in_use[0]))
    in_use[1] = nearest_node(references, reference, int(in_use[1]))
    node = nodes[int(in_use[0]) * len(references) + int(in_use[1])]
    if len(nodes) == 1:
        return Gains(int(node[0]), int(node[1]), int(node[2]), node[3], node[4], node[5]), outside
    i, share_i = bracket(speeds, speed)
    k, share_k = bracket(references, reference)
    pole, log_output, log_increment = 0.0, 0.0, 0.0
    for corner in range(4):
        right, up = corner // 2, corner % 2
        share = (share_i if right else 1.0 - share_i) * (share_k if up else 1.0 - share_k)
        if share > 0.0:
            corner_node = nodes[(i + right) * len(references) + k + up]
            pole += share * corner_node[3]
            log_output += share * math.log(corner_node[4])
            log_increment += share * math.log(corner_node[5])
    Q, R = math.exp(log_output), math.exp(log_increment)
    return Gains(int(node[0]), int(node[1]), int(node[2]), pole, Q, R), outside


@in_place
def is_outside(axis: Array, place: float) -> bool:
    """Return whether a value lies beyond the ends of an axis; never for an axis of one node."""
    return len(axis) > 1 and not axis[0] <= place <= axis[len(axis) - 1]


@in_place
def nearest_node(axis: Array, place: float, current: int) -> int:
    """Return the index of the nearest node; `current` stays unless another is clearly nearer."""
    best = 0
    for i in range(1, len(axis)):
        if abs(axis[i] - place) < abs(axis[best] - place):
            best = i
    if current == NONE or best == current:
        return best
    margin = HYSTERESIS * abs(axis[best] - axis[current])
    return best if abs(axis[current] - place) - abs(axis[best] - place) > margin else current


@in_place
def bracket(axis: Array, place: float) -> tuple[int, float]:
    """Return the node at or below a value, and the relative distance to the next node."""
    last = len(axis) - 1
    if last == 0 or not place > axis[0]:
        return 0, 0.0
    if place >= axis[last]:
        return last, 0.0
    i = section(place, axis)
    return i, (place - axis[i]) / (axis[i + 1] - axis[i])


class GainTable:
    """Grid of gains with the node in use, whose hysteresis keeps the integers from chattering."""

    def __init__(self, speeds: list[float], references: list[float], nodes: list[Gains]) -> None:
        """Arrange `nodes` over speeds [m/s] x lateral references [m]; references vary fastest."""
        axes = np.array(speeds, dtype=float), np.array(references, dtype=float)
        self.table = Table(*axes, np.array(nodes, dtype=float))
        self.nodes = nodes
        self.reset()

    def lookup(self, speed: float, reference: float = 0.0) -> Lookup:
        """Return the gains at a speed [m/s] and a lateral reference [m]; see `look_up`."""
        return Lookup(*look_up(self.table, self.in_use, speed, reference))

    def reset(self) -> None:
        """Reset the node in use."""
        self.in_use: Array = np.full(2, float(NONE))


def load_gain_table(name: str) -> GainTable:
    """Load a table by shipped name or YAML file.

    Raises:
        ValueError: Names the file, the key, the value and the bound.
    """
    return gain_table(read_gain_table(config.find("gains", name)))


def read_gain_table(file: File) -> dict[str, Any]:
    """Read the file of a table, and check that it is one.

    Raises:
        ValueError: Names the file, the key, the value and the bound.
    """
    content = config.read(file)
    try:
        gain_table(content)
    except KeyError as error:
        raise ValueError(f"{file}: missing key {error}") from error
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    return content


def gain_table(content: Mapping[str, Any]) -> GainTable:
    """Make a table of a mapping with `speed`, optional `lateral_reference`, and `gains`.

    It may have a `provenance`, too: a mapping of whatever whoever made the table wants to tell.
    """
    for key in content:
        if key not in KEYS:
            raise ValueError(f"unknown key {key!r}; known are {', '.join(KEYS)}")
    if not isinstance(content.get("provenance", {}), Mapping):
        raise ValueError(f"provenance = {content['provenance']!r} must be a mapping of keys")
    speeds = _axis("speed", content["speed"])
    references = _axis("lateral_reference", content.get("lateral_reference", [0.0]))
    rows, expected = content["gains"], len(speeds) * len(references)
    if not isinstance(rows, list) or len(rows) != expected:
        count = len(rows) if isinstance(rows, list) else repr(rows)
        raise ValueError(f"gains: {count} entries, the axes ask for {expected}")
    nodes = [_gains(f"gains[{i}]", row) for i, row in enumerate(rows)]
    return GainTable(speeds, references, nodes)


def _axis(key: str, values: Any) -> list[float]:
    if not isinstance(values, list) or not values:
        raise ValueError(f"{key} = {values!r} must be a list of numbers")
    for i, value in enumerate(values):
        check_range(f"{key}[{i}]", value, {"low": -1.0e4, "high": 1.0e4, "unit": ""})
        if i and value <= values[i - 1]:
            raise ValueError(f"{key}[{i}] = {value} must be greater than {values[i - 1]}")
    return [float(value) for value in values]


def _gains(where: str, row: Any) -> Gains:
    if not isinstance(row, Mapping) or set(row) != set(BOUNDS):
        raise ValueError(f"{where} = {row!r} must have exactly the keys {', '.join(BOUNDS)}")
    for key, metadata in BOUNDS.items():
        check_range(f"{where}.{key}", row[key], metadata)
        if key in INTEGERS and row[key] != int(row[key]):
            raise ValueError(f"{where}.{key} = {row[key]} must be an integer")
    gains = Gains._make(int(row[k]) if k in INTEGERS else float(row[k]) for k in Gains._fields)
    for key in ("control_horizon", "laguerre_terms"):
        if row[key] > gains.prediction_horizon:
            raise ValueError(
                f"{where}.{key} = {row[key]} must not exceed prediction_horizon = "
                f"{gains.prediction_horizon}"
            )
    return gains
