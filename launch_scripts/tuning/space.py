"""What of the gains is searched for, within which bounds, and how a particle becomes gains."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.parameters import check_range
from ampc_ros.mpc.gain_table import BOUNDS, INTEGERS, Gains
from ampc_ros.pso.swarm import Dimension, swarm_space
from launch_scripts.tuning.fleet import Array

SYMBOLS = ("N_p", "N_c", "N", "alpha", "Q", "R")
"""Of the gains in their order, as the paper writes them."""
FIELDS = dict(zip(SYMBOLS, Gains._fields, strict=True))
LOGARITHMIC = ("Q", "R")
"""Searched for in the logarithm: they range over decades, and only Q/R matters."""
DIGITS = 6
"""Significant ones of a gain that is written down."""
Bounds = tuple[float, float]


class SearchSpace(NamedTuple):
    """Some gains with bounds; the others are fixed."""

    bounds: tuple[tuple[str, float, float], ...]
    """Symbol, low, high."""
    fixed: Gains


class Preset(NamedTuple):
    """What a formulation is tuned with unless a user says otherwise."""

    kind: str
    speeds: tuple[float, ...]
    references: tuple[float, ...]
    tuned: tuple[str, ...]
    bounds: dict[str, Bounds]
    fixed: Gains
    particles: int
    generations: int


PRESETS = {
    "paper": Preset(
        kind="paper",
        speeds=tuple(np.round(np.linspace(3.0, 27.0, 11), 6).tolist()),
        references=(-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0),
        tuned=("N_p", "N_c", "alpha", "R"),  # an alpha between two nodes fits the N of neither
        bounds={  # of the authors' code; theirs of Q and R give R/Q from 1e-4 to 1
            "N_p": (1, 55),
            "N_c": (1, 18),
            "N": (1, 9),
            "alpha": (0.75, 0.99),
            "Q": (0.1, 10.0),
            "R": (0.001, 10.0),
        },
        fixed=Gains(45, 15, 3, 0.75, 10.0, 0.01),
        particles=20,
        generations=15,
    ),
    "preview": Preset(
        kind="robust",
        speeds=(3.0, 5.0, 8.0, 11.0, 15.0, 20.0, 27.0, 33.0, 40.0),
        references=(0.0,),
        tuned=("alpha", "R"),  # what else there is differs from node to node by chance
        bounds={
            "N_p": (10, 45),
            "N_c": (4, 30),
            "N": (2, 8),
            "alpha": (0.0, 0.9),
            "Q": (0.1, 1000.0),
            "R": (1.0, 1.0e5),
        },
        fixed=Gains(25, 20, 4, 0.3, 10.0, 100.0),
        particles=10,
        generations=8,
    ),
}


def search_space(bounds: Mapping[str, Bounds], fixed: Gains) -> SearchSpace:
    """Check bounds, by symbol, and the fixed gains.

    Raises:
        ValueError: Names symbol, value and bound.
    """
    for symbol in bounds:
        if symbol not in SYMBOLS:
            raise ValueError(f"unknown gain {symbol!r}; known are {', '.join(SYMBOLS)}")
    for symbol, field in FIELDS.items():
        for end, value in zip(("low", "high"), bounds.get(symbol, ()), strict=False):
            check_range(f"bounds: {symbol}.{end}", value, BOUNDS[field])
        check_range(f"fixed: {symbol}", getattr(fixed, field), BOUNDS[field])
    ends = tuple((symbol, float(low), float(high)) for symbol, (low, high) in bounds.items())
    result = SearchSpace(ends, fixed)
    swarm_space([Dimension(*bound) for bound in result.bounds])
    swarm_space(dimensions(result))
    return result


def dimensions(where: SearchSpace) -> list[Dimension]:
    """Give the dimensions in which the swarm flies."""
    return [
        Dimension(symbol, math.log10(low), math.log10(high))
        if symbol in LOGARITHMIC
        else Dimension(symbol, low, high, FIELDS[symbol] in INTEGERS)
        for symbol, low, high in where.bounds
    ]


def gains_at(where: SearchSpace, positions: Array) -> Array:
    """Give the gains (n, 6) of particles (n, d); N_c and N are kept within N_p."""
    rows = np.tile(np.array(where.fixed, dtype=float), (len(positions), 1))
    for column, (symbol, _, _) in enumerate(where.bounds):
        values = positions[:, column]
        values = 10.0**values if symbol in LOGARITHMIC else values
        rows[:, SYMBOLS.index(symbol)] = [float(f"{value:.{DIGITS}g}") for value in values]
    rows[:, 1:3] = np.minimum(rows[:, 1:3], rows[:, :1])
    return rows


def read_bounds(texts: Sequence[str]) -> dict[str, Bounds]:
    """Read bounds as a user writes them: `R=1:1e4`.

    Raises:
        ValueError: Names what is wrong.
    """
    bounds = {}
    for text in texts:
        symbol, _, ends = text.partition("=")
        low, _, high = ends.partition(":")
        try:
            bounds[symbol] = (float(low), float(high))
        except ValueError as error:
            raise ValueError(f"--bounds {text}: must look like R=1:1e4") from error
    return bounds


def read_fixed(texts: Sequence[str], default: Gains) -> Gains:
    """Read fixed gains as a user writes them: `N_p=25`.

    Raises:
        ValueError: Names what is wrong.
    """
    fixed = default
    for text in texts:
        symbol, _, value = text.partition("=")
        if symbol not in SYMBOLS:
            raise ValueError(f"--fix {text}: unknown gain; known are {', '.join(SYMBOLS)}")
        try:
            number = int(value) if FIELDS[symbol] in INTEGERS else float(value)
        except ValueError as error:
            raise ValueError(f"--fix {text}: must look like {symbol}=25") from error
        fixed = Gains(**(fixed._asdict() | {FIELDS[symbol]: number}))
    return fixed
