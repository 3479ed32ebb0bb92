"""Gains by speed and lateral reference, from YAML."""

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from itertools import pairwise
from pathlib import Path as File
from typing import Annotated, Any, NamedTuple, get_args

import numpy as np

from ampc_msgs_config import config
from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.interpolation import section
from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import Checked, described, hints, number
from ampc_ros.mpc.gain_schedule import GainSchedule

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


@dataclass(frozen=True, kw_only=True)
class GainSet(Checked):
    """Gains of one node in a file; the horizons and the number of terms are whole numbers."""

    prediction_horizon: Annotated[
        float, number(1, 200, "ticks", "Prediction horizon, N_p.", whole=True)
    ]
    control_horizon: Annotated[
        float, number(1, 200, "ticks", "Control horizon, N_c, at most N_p.", whole=True)
    ]
    laguerre_terms: Annotated[
        float, number(1, 20, "", "Laguerre functions, N, at most N_p.", whole=True)
    ]
    laguerre_pole: Annotated[float, number(0.0, 0.999, "", "Laguerre pole, alpha.")]
    output_weight: Annotated[float, number(1.0e-9, 1.0e9, "", "Output weight, Q.")]
    increment_weight: Annotated[float, number(1.0e-9, 1.0e9, "", "Increment weight, R.")]

    def __post_init__(self) -> None:
        """Check the gains, and the horizons against each other."""
        super().__post_init__()
        for key in ("control_horizon", "laguerre_terms"):
            if getattr(self, key) > self.prediction_horizon:
                raise ValueError(
                    f"{key} = {getattr(self, key):g} must not exceed prediction_horizon = "
                    f"{self.prediction_horizon:g}"
                )

    @property
    def gains(self) -> Gains:
        """Gains for the controller."""
        rows = zip(Gains._fields, astuple(self), strict=True)
        return Gains._make(int(value) if key in INTEGERS else value for key, value in rows)


INTEGERS = ("prediction_horizon", "control_horizon", "laguerre_terms")
"""Gains that are whole numbers."""
BOUNDS = {key: get_args(kind)[1] for key, kind in hints(GainSet).items()}
"""Declared range of each gain."""


@dataclass(frozen=True, kw_only=True)
class GainTableFile(Checked):
    """Content of a gain table file: axes, and a gain set for each node, the references fastest."""

    speed: Annotated[
        tuple[Annotated[float, number(-1.0e4, 1.0e4, "m/s", "Speed of a node.")], ...],
        described("Speeds of the nodes, increasing.", most=1000),
    ]
    lateral_reference: Annotated[
        tuple[Annotated[float, number(-1.0e4, 1.0e4, "m", "Lateral reference.")], ...],
        described("Lateral references of the nodes, increasing.", most=1000),
    ] = (0.0,)
    gains: tuple[GainSet, ...]
    schedule: GainSchedule | None = None
    provenance: Annotated[dict[str, Any], described("Origin of the gains, not evaluated.")] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        """Check the fields, the order of the axes and the number of gain sets."""
        super().__post_init__()
        for key in ("speed", "lateral_reference"):
            for i, (low, high) in enumerate(pairwise(getattr(self, key)), start=1):
                if high <= low:
                    raise ValueError(f"{key}[{i}] = {high} must be greater than {low} before it")
        nodes = len(self.speed) * len(self.lateral_reference)
        if len(self.gains) != nodes:
            raise ValueError(f"gains has {len(self.gains)} entries, must have {nodes} for the axes")
        if self.schedule and nodes != 1:
            raise ValueError(f"gains has {nodes} entries, must have 1 beside a schedule")


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

    def __init__(
        self,
        speeds: list[float],
        references: list[float],
        nodes: list[Gains],
        schedule: GainSchedule | None = None,
    ) -> None:
        """Arrange `nodes` over speeds [m/s] x lateral references [m]; references vary fastest.

        A `schedule` replaces pole and increment weight of a single node in formulation `preview`.
        """
        axes = np.array(speeds, dtype=float), np.array(references, dtype=float)
        self.table = Table(*axes, np.array(nodes, dtype=float))
        self.nodes, self.schedule = nodes, schedule
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
        ValueError: File, key, value and bound.
    """
    file = config.find("gains", name)
    return gain_table(config.read(file), str(file))


def read_gain_table(file: File) -> dict[str, Any]:
    """Read the content of a table's file, and check it.

    Raises:
        ValueError: File, key, value and bound.
    """
    content = config.read(file)
    gain_table(content, str(file))
    return content


def gain_table(content: Mapping[str, Any], where: str = "gain table", key: str = "") -> GainTable:
    """Build a table from the content of a file.

    Args:
        content: Mapping of the fields of `GainTableFile`.
        where: Source of the content, for the message.
        key: Dotted key of the content in its source, for the message.

    Raises:
        ValueError: Source, key, value and bound.
    """
    table = config.build(GainTableFile, content, where, key)
    nodes = [node.gains for node in table.gains]
    return GainTable(list(table.speed), list(table.lateral_reference), nodes, table.schedule)
