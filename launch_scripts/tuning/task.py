"""A tuning task: the gains to search, their bounds, the nodes of the table, and the searches.

A task is read from the command line. It has one search for each node and seed, one for a single
gain set that serves all nodes, and one random search for each node as a baseline.
"""

import argparse
import hashlib
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find
from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import check_range, number
from ampc_msgs_config.vehicle_file import read_vehicle
from ampc_ros.mpc.gain_table import BOUNDS, INTEGERS, Gains, GainTable
from ampc_ros.pso.swarm import Dimension, PsoSettings, swarm_space
from launch_scripts.tuning.drives import DEFINITION
from launch_scripts.tuning.fitness import Node, fitness
from sim_vehicle.parameters import load_vehicle_file

SYMBOLS = ("N_p", "N_c", "N", "alpha", "Q", "R")
"""Symbols of the paper, in the order of the fields of `Gains`."""
FIELDS = dict(zip(SYMBOLS, Gains._fields, strict=True))
LOGARITHMIC = ("Q", "R")
"""Gains that are searched in the logarithm: they span decades, and only Q/R matters."""
GAIN_DIGITS = 6
"""Significant digits of a gain."""
REACH = 2.0
"""Largest reachable lateral reference, divided by the speed [s]."""
TABLE_SEARCH, SINGLE, RANDOM = "table", "single", "random"
"""Purposes of a search: swarm for one node, swarm for all nodes, random samples for one node."""
Bounds = tuple[float, float]


class SearchSpace(NamedTuple):
    """Bounds of the gains that are searched, and the values of the others."""

    bounds: tuple[tuple[str, float, float], ...]
    """Symbol, lower and upper bound."""
    fixed: Gains

    @property
    def dimensions(self) -> list[Dimension]:
        """Dimensions of the swarm, in the logarithm of LOGARITHMIC gains."""
        return [
            Dimension(symbol, math.log10(low), math.log10(high))
            if symbol in LOGARITHMIC
            else Dimension(symbol, low, high, FIELDS[symbol] in INTEGERS)
            for symbol, low, high in self.bounds
        ]

    def gains_at(self, positions: Array) -> Array:
        """Return the gains (n, 6) of particles (n, d), with N_c and N limited to N_p."""
        rows = np.tile(np.array(self.fixed, dtype=float), (len(positions), 1))
        for column, (symbol, _, _) in enumerate(self.bounds):
            values = positions[:, column]
            values = 10.0**values if symbol in LOGARITHMIC else values
            rows[:, SYMBOLS.index(symbol)] = [float(f"{value:.{GAIN_DIGITS}g}") for value in values]
        rows[:, 1:3] = np.minimum(rows[:, 1:3], rows[:, :1])
        return rows

    def mean_fitness(self, nodes: tuple[Node, ...], positions: Array) -> Array:
        """Return the geometric mean over nodes of the fitness (n,) of particles (n, d)."""
        gains = self.gains_at(positions)
        return geometric_mean(np.array([fitness(node, gains) for node in nodes]))


def geometric_mean(values: Array) -> Array:
    """Return the geometric mean over the first axis; infinite where one value is infinite."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.exp(np.log(values).mean(axis=0)))


def search_space(bounds: Mapping[str, Bounds], fixed: Gains) -> SearchSpace:
    """Check the bounds, by symbol, and the fixed gains.

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
    space = SearchSpace(ends, fixed)
    swarm_space([Dimension(*bound) for bound in space.bounds])
    swarm_space(space.dimensions)
    return space


class Search(NamedTuple):
    """One run of the particle swarm."""

    purpose: str
    """TABLE, SINGLE or RANDOM."""
    seed: int
    number: int
    """Index of the node; for a single set the number of all nodes."""
    nodes: tuple[Node, ...]
    space: SearchSpace
    settings: PsoSettings

    @property
    def name(self) -> str:
        """Name of the checkpoint file, also shown to the user."""
        return f"{self.purpose}_{self.seed}_{self.number:03d}"

    @property
    def rng(self) -> np.random.Generator:
        """Random generator, independent of those of all other searches."""
        key = [self.seed, self.number] + [1] * (self.purpose == RANDOM)
        return np.random.default_rng(key)

    @property
    def cost(self) -> partial[Array]:
        """Fitness (n,) as a function of particles (n, d); can be pickled."""
        return partial(self.space.mean_fitness, self.nodes)

    @property
    def drives(self) -> int:
        """Number of nodes that are evaluated in a generation."""
        return self.settings.particles * len(self.nodes)


class TuningTask(NamedTuple):
    """Everything that determines the result of a tuning."""

    vehicle: str
    """Name of a shipped vehicle, or file."""
    formulation: str
    """`preview` or `paper`."""
    kind: str
    """Key of FITNESS."""
    speeds: tuple[float, ...]
    """Speeds of the table [m/s]."""
    references: tuple[float, ...]
    """Lateral references of the table [m]."""
    space: SearchSpace
    settings: PsoSettings
    seeds: tuple[int, ...]

    def check(self) -> None:
        """Check the axes of the table, the seeds, and that a node is reachable.

        Raises:
            ValueError: Names key, value and bound.
        """
        for key, axis, low in (("speeds", self.speeds, 0.5), ("references", self.references, -100)):
            if not axis:
                raise ValueError(f"{key} = [] must have at least one value")
            for i, value in enumerate(axis):
                check_range(f"{key}[{i}]", value, number(low, 100.0))
                if i and value <= axis[i - 1]:
                    raise ValueError(f"{key}[{i}] = {value:g} must be greater than {axis[i - 1]:g}")
        if self.kind != "paper" and self.references != (0.0,):
            raise ValueError(f"references = {list(self.references)} must be [0] for fitness robust")
        if not self.seeds or min(self.seeds) < 0 or len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds = {list(self.seeds)} must be different and not negative")
        if not any(map(is_reachable, self.nodes())):
            raise ValueError(f"references: none is reachable, |y| <= {REACH:g} s v, at any speed")

    def nodes(self, speeds: tuple[float, ...] | None = None) -> list[Node]:
        """Return the nodes in the order of a gain table, at its speeds or at others [m/s]."""
        vehicle = load_vehicle_file(find("vehicles", self.vehicle))
        return [
            Node(vehicle, self.formulation, self.kind, speed, reference)
            for speed in (self.speeds if speeds is None else speeds)
            for reference in self.references
        ]

    def held_out_nodes(self) -> list[Node]:
        """Return the nodes half-way between the speeds of the table, which no search evaluates."""
        between = tuple((a + b) / 2 for a, b in zip(self.speeds, self.speeds[1:], strict=False))
        return [node for node in self.nodes(between) if is_reachable(node)]

    def searches(self) -> list[Search]:
        """Return all searches, the largest first; each purpose drives the same number of cars."""
        nodes, swarm = self.nodes(), self.settings
        reachable = [(i, (node,)) for i, node in enumerate(nodes) if is_reachable(node)]
        everywhere = [(len(nodes), tuple(node for _, (node,) in reachable))]
        samples = PsoSettings(particles=swarm.particles * (swarm.generations + 1), generations=0)
        return [
            Search(purpose, seed, i, chosen, self.space, settings)
            for purpose, group, settings in (
                (SINGLE, everywhere, swarm),
                (TABLE_SEARCH, reachable, swarm),
                (RANDOM, reachable, samples),
            )
            for seed in self.seeds
            for i, chosen in group
        ]

    def describe(self) -> dict[str, Any]:
        """Return the task as JSON and YAML values, for checkpoints and the origin of a table."""
        tuned = {symbol: [low, high] for symbol, low, high in self.space.bounds}
        fixed = zip(SYMBOLS, self.space.fixed, strict=True)
        file = Path(self.vehicle)
        return {
            "version": __version__,
            "vehicle": file.name if file.is_file() else self.vehicle,
            "vehicle_sha256": read_vehicle(find("vehicles", self.vehicle)).digest,
            "drives_sha256": sha256(DEFINITION.encode()),
            "formulation": self.formulation,
            "fitness": self.kind,
            "speed": list(self.speeds),
            "lateral_reference": list(self.references),
            "bounds": tuned,
            "fixed": {symbol: value for symbol, value in fixed if symbol not in tuned},
            "swarm": "proposed",
            "particles": self.settings.particles,
            "generations": self.settings.generations,
            "seeds": list(self.seeds),
        }

    def build_table(self, gains: Mapping[Bounds, Gains]) -> GainTable:
        """Build a gain table from gains by speed and lateral reference.

        A node without gains takes those of the nearest node, at the same speed where one exists.
        """

        def nearest(speed: float, y: float) -> Gains:
            return gains[min(gains, key=lambda at: (abs(at[0] - speed), abs(at[1] - y)))]

        nodes = [nearest(speed, y) for speed in self.speeds for y in self.references]
        return GainTable(list(self.speeds), list(self.references), nodes)


def is_reachable(node: Node) -> bool:
    """Check whether a car can reach the lateral reference of a node at its speed."""
    return abs(node.reference) <= REACH * node.speed


def sha256(content: bytes) -> str:
    """Return the SHA-256 of some bytes in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


DEFAULT_BOUNDS: dict[str, dict[str, Bounds]] = {
    "paper": {  # of the authors' code; its bounds of Q and R allow R/Q from 1e-4 to 1
        "N_p": (1, 55),
        "N_c": (1, 18),
        "N": (1, 9),
        "alpha": (0.75, 0.99),
        "Q": (0.1, 10.0),
        "R": (0.001, 10.0),
    },
    "preview": {
        "N_p": (10, 45),
        "N_c": (4, 30),
        "N": (2, 8),
        "alpha": (0.0, 0.9),
        "Q": (0.1, 1000.0),
        "R": (1.0, 1.0e5),
    },
}
"""Bounds by formulation and symbol."""
DEFAULT_TUNED = {"paper": ("N_p", "N_c", "alpha", "R"), "preview": ("alpha", "R")}
"""Gains tuned by default. An alpha interpolated between two nodes does not suit the N of either;
with the preview formulation the optima of the other gains vary randomly from node to node."""
PRESETS = {
    "paper": TuningTask(
        vehicle="paper",
        formulation="paper",
        kind="paper",
        speeds=tuple(np.round(np.linspace(3.0, 27.0, 11), 6).tolist()),
        references=(-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0),
        space=SearchSpace((), Gains(45, 15, 3, 0.75, 10.0, 0.01)),
        settings=PsoSettings(particles=20, generations=15),
        seeds=(1, 2),
    ),
    "preview": TuningTask(
        vehicle="paper",
        formulation="preview",
        kind="robust",
        speeds=(3.0, 5.0, 8.0, 11.0, 15.0, 20.0, 27.0, 33.0, 40.0),
        references=(0.0,),
        space=SearchSpace((), Gains(25, 20, 4, 0.3, 10.0, 100.0)),
        settings=PsoSettings(particles=10, generations=8),
        seeds=(1, 2),
    ),
}
"""Default task of each formulation; its space holds the fixed gains."""


def read_task(chosen: argparse.Namespace) -> TuningTask:
    """Build the task from the options of `tune.py`; an option that is None is that of the preset.

    Raises:
        ValueError: Names option or key, value and bound.
    """
    preset = PRESETS[chosen.formulation]
    kind = chosen.fitness or preset.kind
    references = preset.references if kind == "paper" else (0.0,)
    swarm = {key: getattr(chosen, key) for key in ("particles", "generations")}
    for key, value in swarm.items():
        swarm[key] = getattr(preset.settings, key) if value is None else value
    task = preset._replace(
        vehicle=chosen.vehicle,
        kind=kind,
        speeds=preset.speeds if chosen.speeds is None else tuple(chosen.speeds),
        references=references if chosen.references is None else tuple(chosen.references),
        space=read_space(chosen, preset.space.fixed._asdict()),
        settings=PsoSettings(**swarm),
        seeds=tuple(chosen.seeds),
    )
    task.check()
    return task


def read_space(chosen: argparse.Namespace, fixed: dict[str, Any]) -> SearchSpace:
    """Return the search space: `--tune`, `--bounds R=1:1e4` and `--fix N_p=25`.

    Raises:
        ValueError: Names the text that cannot be parsed, or the gain that is not tuned.
    """
    tuned = chosen.tune or DEFAULT_TUNED[chosen.formulation]
    bounds = {symbol: DEFAULT_BOUNDS[chosen.formulation][symbol] for symbol in tuned}
    for text in chosen.bounds:
        symbol, _, ends = text.partition("=")
        low, _, high = ends.partition(":")
        if symbol in SYMBOLS and symbol not in tuned:
            raise ValueError(f"--bounds {symbol}: is not among the tuned, {', '.join(tuned)}")
        try:
            bounds[symbol] = (float(low), float(high))
        except ValueError as error:
            raise ValueError(f"--bounds {text}: must look like R=1:1e4") from error
    for text in chosen.fix:
        symbol, _, value = text.partition("=")
        if symbol not in SYMBOLS:
            raise ValueError(f"--fix {text}: unknown gain; known are {', '.join(SYMBOLS)}")
        field = FIELDS[symbol]
        try:
            fixed[field] = int(value) if field in INTEGERS else float(value)
        except ValueError as error:
            raise ValueError(f"--fix {text}: must look like {symbol}=25") from error
    return search_space(bounds, Gains(**fixed))
