"""Gains by speed and lateral reference, from YAML."""

import itertools
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import config
from ampc_msgs_config.parameters import check_range

HYSTERESIS = 0.1
"""Share of the distance between two nodes by which another must be nearer to take over."""


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


INTEGERS = ("prediction_horizon", "control_horizon", "laguerre_terms")
BOUNDS: dict[str, dict[str, Any]] = {
    "prediction_horizon": {"low": 1, "high": 200, "unit": "ticks"},
    "control_horizon": {"low": 1, "high": 200, "unit": "ticks"},
    "laguerre_terms": {"low": 1, "high": 20, "unit": ""},
    "laguerre_pole": {"low": 0.0, "high": 0.999, "unit": ""},
    "output_weight": {"low": 1.0e-9, "high": 1.0e9, "unit": ""},
    "increment_weight": {"low": 1.0e-9, "high": 1.0e9, "unit": ""},
}


class Lookup(NamedTuple):
    """Gains, and whether the table had to be left."""

    gains: Gains
    outside: bool
    """The speed or reference lies outside the grid; the nearest edge was used."""


class GainTable:
    """Grid of gains; remembers the node in use, so that integers do not chatter between two."""

    def __init__(self, speeds: list[float], references: list[float], nodes: list[Gains]) -> None:
        """Lay `nodes` out over speeds [m/s] x lateral references [m], the references fastest."""
        self.axes = (np.asarray(speeds, dtype=float), np.asarray(references, dtype=float))
        self.nodes = nodes
        self.nearest = [-1, -1]

    def lookup(self, speed: float, reference: float = 0.0) -> Lookup:
        """Give the gains at a speed [m/s] and a lateral reference [m].

        Integers come from the nearest node, with hysteresis; weights are interpolated in the
        logarithm, the pole linearly. Outside the grid the edge counts; an axis of one place is
        none, its gains hold everywhere.
        """
        places = (speed, reference)
        outside = any(
            len(axis) > 1 and not axis[0] <= place <= axis[-1]
            for axis, place in zip(self.axes, places, strict=True)
        )
        if len(self.nodes) == 1:
            return Lookup(self.nodes[0], outside)
        for k, (axis, place) in enumerate(zip(self.axes, places, strict=True)):
            self.nearest[k] = nearest_node(axis, place, self.nearest[k])
        node = self._node(*self.nearest)
        brackets = [bracket(axis, p) for axis, p in zip(self.axes, places, strict=True)]
        return Lookup(Gains(*node[:3], *self._interpolate(brackets)), outside)

    def reset(self) -> None:
        """Forget the node in use."""
        self.nearest = [-1, -1]

    def _node(self, i: int, j: int) -> Gains:
        return self.nodes[i * len(self.axes[1]) + j]

    def _interpolate(self, brackets: list[list[tuple[int, float]]]) -> tuple[float, float, float]:
        pole = log_output = log_increment = 0.0
        for (i, share_i), (j, share_j) in itertools.product(*brackets):
            node, share = self._node(i, j), share_i * share_j
            pole += share * node.laguerre_pole
            log_output += share * math.log(node.output_weight)
            log_increment += share * math.log(node.increment_weight)
        return pole, math.exp(log_output), math.exp(log_increment)


def nearest_node(axis: Any, place: float, current: int) -> int:
    """Index of the nearest node; `current` (-1: none) is kept unless another is clearly nearer."""
    best = int(np.argmin(np.abs(axis - place)))
    if current < 0 or best == current:
        return best
    margin = HYSTERESIS * abs(axis[best] - axis[current])
    return best if abs(axis[current] - place) - abs(axis[best] - place) > margin else current


def bracket(axis: Any, place: float) -> list[tuple[int, float]]:
    """Neighbouring nodes of a place on an axis, with their shares; one node outside and on it."""
    clamped = min(max(place, axis[0]), axis[-1])
    i = min(int(np.searchsorted(axis, clamped, side="right")) - 1, len(axis) - 1)
    if i == len(axis) - 1 or axis[i] == clamped:
        return [(i, 1.0)]
    share = float((clamped - axis[i]) / (axis[i + 1] - axis[i]))
    return [(i, 1.0 - share), (i + 1, share)]


def load_gain_table(name: str) -> GainTable:
    """Load a table by shipped name or YAML file.

    Raises:
        ValueError: Names the file, the key, the value and the bound.
    """
    file = config.find("gains", name)
    content = config.read(file)
    try:
        return gain_table(content)
    except KeyError as error:
        raise ValueError(f"{file}: missing key {error}") from error
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


def gain_table(content: Mapping[str, Any]) -> GainTable:
    """Make a table of a mapping with `speed`, optional `lateral_reference`, and `gains`."""
    for key in content:
        if key not in ("speed", "lateral_reference", "gains"):
            raise ValueError(f"unknown key {key!r}; known are speed, lateral_reference, gains")
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
