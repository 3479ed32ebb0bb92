"""A tuning task: the gains to search, their bounds, the nodes of the table, and the searches.

A task is read from the command line. For each seed it has one search for each node, and one for a
single gain set that serves all nodes, with the same number of drives.
"""

import argparse
import hashlib
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import check_range, number
from ampc_msgs_config.vehicle_file import read_vehicle
from ampc_ros.mpc.gain_table import BOUNDS, INTEGERS, Gains, GainTable
from ampc_ros.pso.swarm import Dimension, swarm_space
from launch_scripts.tuning.choices import SETTINGS, SYMBOLS
from launch_scripts.tuning.drives import DEFINITION
from launch_scripts.tuning.fitness import REFERENCE_PERIOD, Node, fitness
from launch_scripts.tuning.methods import NO_CMA, has_cma
from sim_vehicle.parameters import load_vehicle_file

FIELDS = dict(zip(SYMBOLS, Gains._fields, strict=True))
SYMBOL_OF = {field: symbol for symbol, field in FIELDS.items()}
LOGARITHMIC = ("Q", "R")
"""Gains that are searched in the logarithm: they span decades, and only Q/R matters."""
GAIN_DIGITS = 6
"""Significant digits of a gain."""
REACH = 2.0
"""Largest reachable lateral reference, divided by the speed [s]."""
TABLE_SEARCH, SINGLE, POLISH = "table", "single", "polish"
"""Purposes of a search: one node, all nodes with the same gains, one node near its neighbours."""
BY_SPEED = "R/v^2"
"""Bounds of R that grow with the square of the speed, as the effort in the fitness does."""
LITERAL = "paper"
"""Method that follows the paper literally: each node by itself, horizons included."""
POLISH_SHARE = 1 / 3
"""Share of a node's evaluations that are left for its polish."""
Bounds = tuple[float, float]


class SearchSpace(NamedTuple):
    """Bounds of the gains that are searched, and the values of the others."""

    bounds: tuple[tuple[str, float, float], ...]
    """Symbol, or BY_SPEED, lower and upper bound."""
    fixed: Gains

    def at(self, speeds: Sequence[float]) -> "SearchSpace":
        """Return the space at some speeds [m/s]: bounds by speed become those of R."""
        low, high = min(speeds) ** 2, max(speeds) ** 2
        ends = tuple(
            ("R", a * low, b * high) if key == BY_SPEED
            else (key, a, b)
            for key, a, b in self.bounds
        )  # fmt: skip
        return self._replace(bounds=ends)

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


def geometric_mean(values: Array | Sequence[float]) -> Array:
    """Return the geometric mean over the first axis; infinite where one value is infinite."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.exp(np.log(values).mean(axis=0)))


def search_space(bounds: Mapping[str, Bounds], fixed: Gains) -> SearchSpace:
    """Check the bounds, by symbol, and the fixed gains.

    Raises:
        ValueError: Names symbol, value and bound.
    """
    for symbol in bounds:
        if symbol not in (*SYMBOLS, BY_SPEED):
            raise ValueError(f"unknown gain {symbol!r}; known are {', '.join(SYMBOLS)}")
    for symbol, field in (*FIELDS.items(), (BY_SPEED, FIELDS["R"])):
        for end, value in zip(("low", "high"), bounds.get(symbol, ()), strict=False):
            check_range(f"bounds: {symbol}.{end}", value, BOUNDS[field])
        check_range(f"fixed: {SYMBOL_OF[field]}", getattr(fixed, field), BOUNDS[field])
    ends = tuple((symbol, float(low), float(high)) for symbol, (low, high) in bounds.items())
    space = SearchSpace(ends, fixed)
    swarm_space([Dimension(*bound) for bound in space.bounds])
    swarm_space(space.at((1.0,)).dimensions)
    return space


class Neighbours(NamedTuple):
    """Start of a polish, and the gains of the nodes beside it, which it shall resemble."""

    start: Gains
    beside: tuple[Gains, ...]


class Search(NamedTuple):
    """One search."""

    purpose: str
    """TABLE_SEARCH, SINGLE or POLISH."""
    seed: int
    number: int
    """Index of the node; for a single set the number of all nodes."""
    nodes: tuple[Node, ...]
    space: SearchSpace
    method: str
    """Key of SEARCH_METHODS."""
    evaluations: int
    """Largest number of gain sets that are evaluated."""
    generation: int
    """Number of gain sets in a generation of the method."""
    neighbours: Neighbours | None = None
    """Of a POLISH."""

    @property
    def name(self) -> str:
        """Name of the checkpoint file, also shown to the user."""
        return f"{self.purpose}_{self.seed}_{self.number:03d}"

    @property
    def rng(self) -> np.random.Generator:
        """Random generator, independent of those of all other searches."""
        return np.random.default_rng([self.seed, self.number])

    @property
    def cost(self) -> partial[Array]:
        """Fitness (n,) as a function of positions (n, d); can be pickled."""
        return partial(self.space.mean_fitness, self.nodes)

    @property
    def drives(self) -> int:
        """Number of gain sets times nodes that are evaluated at most."""
        return self.evaluations * len(self.nodes)


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
    method: str
    """Key of SEARCH_METHODS."""
    evaluations: int
    """Number of gain sets that are evaluated at each node."""
    generation: int
    """Number of gain sets in a generation of the method."""
    seeds: tuple[int, ...]
    settings: str = SETTINGS
    """Shipped controller settings, or file."""

    def check(self) -> None:
        """Check the axes of the table, the seeds, the tuned gains, and that a node is reachable.

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
        whole = [symbol for symbol, _, _ in self.space.bounds if FIELDS.get(symbol) in INTEGERS]
        if whole and self.method != LITERAL:
            raise ValueError(
                f"--tune {' '.join(whole)}: horizons and terms are equal at all nodes: choose them "
                f"with --fix, or --method {LITERAL}"
            )
        if not self.seeds or min(self.seeds) < 0 or len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds = {list(self.seeds)} must be different and not negative")
        if not any(map(is_reachable, self.nodes())):
            raise ValueError(f"references: none is reachable, |y| <= {REACH:g} s v, at any speed")

    def nodes(self, speeds: tuple[float, ...] | None = None) -> list[Node]:
        """Return the nodes in the order of a gain table, at its speeds or at others [m/s]."""
        vehicle = load_vehicle_file(find("vehicles", self.vehicle))
        return [
            Node(vehicle, self.formulation, self.kind, speed, reference, self.settings)
            for speed in (self.speeds if speeds is None else speeds)
            for reference in self.references
        ]

    def held_out_nodes(self) -> list[Node]:
        """Return the nodes half-way between the speeds of the table, which no search evaluates."""
        between = tuple((a + b) / 2 for a, b in zip(self.speeds, self.speeds[1:], strict=False))
        return [node for node in self.nodes(between) if is_reachable(node)]

    @property
    def is_smooth(self) -> bool:
        """Whether neighbouring nodes are made similar: no method LITERAL, a single reference."""
        return self.method != LITERAL and len(self.references) == 1 and len(self.speeds) > 1

    def searches(self) -> list[Search]:
        """Return the searches, the largest first; each purpose drives the same number of cars."""
        nodes = self.nodes()
        reachable = [(i, (node,)) for i, node in enumerate(nodes) if is_reachable(node)]
        everywhere = [(len(nodes), tuple(node for _, (node,) in reachable))]
        left = round(POLISH_SHARE * self.evaluations) if self.is_smooth else 0
        return [
            self.search(purpose, seed, i, chosen, evaluations)
            for purpose, group, evaluations in (
                (SINGLE, everywhere, self.evaluations),
                (TABLE_SEARCH, reachable, self.evaluations - left),
            )
            for seed in self.seeds
            for i, chosen in group
        ]

    def search(
        self, purpose: str, seed: int, number: int, nodes: tuple[Node, ...], evaluations: int
    ) -> Search:
        """Return a search for the same gains at some nodes."""
        space = self.space.at([node.speed for node in nodes])
        method, generation = self.method, min(self.generation, evaluations)
        return Search(purpose, seed, number, nodes, space, method, evaluations, generation)

    def polishes(self, seed: int, gains: Sequence[Gains]) -> list[Search]:
        """Return the searches that polish the gains of all nodes, in the order of the nodes."""
        left = round(POLISH_SHARE * self.evaluations)
        return [
            self.search(POLISH, seed, i, (node,), left)._replace(
                neighbours=Neighbours(gains[i], (*gains[max(i - 1, 0) : i], *gains[i + 1 : i + 2]))
            )
            for i, node in enumerate(self.nodes())
        ]

    def describe(self) -> dict[str, Any]:
        """Return the task as JSON and YAML values, for checkpoints and the origin of a table."""
        tuned = {symbol: [low, high] for symbol, low, high in self.space.bounds}
        searched = {symbol.removesuffix("/v^2") for symbol in tuned}
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
            "fixed": {symbol: value for symbol, value in fixed if symbol not in searched},
            "settings": Path(self.settings).name,
            "settings_sha256": sha256(find("controllers", self.settings).read_bytes()),
            "method": self.method,
            "evaluations": self.evaluations,
            "generation": self.generation,
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
        BY_SPEED: (0.05, 20.0),
    },
}
"""Bounds by formulation and symbol, at 10 Hz."""
DEFAULT_TUNED = {"paper": ("alpha", "R"), "preview": ("alpha", "R")}
"""Gains tuned by default. The horizons and the number of terms are equal at all nodes: an alpha
interpolated between two nodes does not suit the N of either."""
LITERAL_TUNED = ("N_p", "N_c", "alpha", "R")
"""Gains of the formulation `paper` that its authors tune."""
LITERAL_FIXED = Gains(45, 15, 3, 0.75, 10.0, 0.01)
"""Gains that the authors do not tune: N and Q."""
MAX_HORIZON = 100
"""Longest prediction horizon that is chosen for settings with a shorter period [ticks]."""
LOWEST_POLE = 0.03
"""Lower bound of the pole of fast controllers, as that of the same decay in 0.1 s."""
PRESETS = {
    "paper": TuningTask(
        vehicle="paper",
        formulation="paper",
        kind="paper",
        speeds=tuple(np.round(np.linspace(3.0, 27.0, 11), 6).tolist()),
        references=(-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0),
        space=SearchSpace((), Gains(25, 12, 3, 0.75, 10.0, 0.01)),
        method="pso",
        evaluations=96,
        generation=10,
        seeds=(1, 2),
    ),
    "preview": TuningTask(
        vehicle="paper",
        formulation="preview",
        kind="robust",
        speeds=(3.0, 4.0, 5.0, 6.5, 8.0, 11.0, 15.0, 20.0, 27.0, 40.0),
        references=(0.0,),
        space=SearchSpace((), Gains(25, 20, 3, 0.75, 10.0, 100.0)),
        method="pso",
        evaluations=48,
        generation=8,
        seeds=(1, 2),
    ),
}
"""Default task of each formulation; its space holds the fixed gains."""
LITERAL_PARTICLES, LITERAL_GENERATIONS = 20, 15
"""Table 2 of the paper: defaults of the method LITERAL."""


def read_task(chosen: argparse.Namespace) -> TuningTask:
    """Build the task from the options of `tune.py`; an option that is None is that of the preset.

    Raises:
        ValueError: Names option or key, value and bound.
    """
    preset = PRESETS[chosen.formulation]
    if chosen.method == "cma" and not has_cma():
        raise ValueError(NO_CMA)
    kind = chosen.fitness or preset.kind
    references = preset.references if kind == "paper" else (0.0,)
    evaluations, generation = read_budget(chosen, preset)
    task = preset._replace(
        vehicle=chosen.vehicle,
        kind=kind,
        speeds=preset.speeds if chosen.speeds is None else tuple(chosen.speeds),
        references=references if chosen.references is None else tuple(chosen.references),
        space=read_space(chosen, preset.space.fixed),
        method=chosen.method,
        evaluations=evaluations,
        generation=generation,
        seeds=tuple(chosen.seeds),
        settings=chosen.settings,
    )
    task.check()
    return task


def read_budget(chosen: argparse.Namespace, preset: TuningTask) -> tuple[int, int]:
    """Return the number of evaluations at a node and of gain sets in a generation.

    Raises:
        ValueError: An option does not suit the method, or is out of range.
    """
    sizes = {"particles": chosen.particles, "generations": chosen.generations}
    if chosen.method != LITERAL:
        for key, value in sizes.items():
            if value is not None:
                raise ValueError(
                    f"--{key}: is an option of --method {LITERAL}, not {chosen.method}"
                )
        evaluations = preset.evaluations if chosen.evaluations is None else chosen.evaluations
        check_range("evaluations", evaluations, number(12, 1_000_000))
        return evaluations, preset.generation
    if chosen.evaluations is not None:
        raise ValueError(
            f"--evaluations: is no option of --method {LITERAL}, which has --particles"
        )
    particles = LITERAL_PARTICLES if sizes["particles"] is None else sizes["particles"]
    generations = LITERAL_GENERATIONS if sizes["generations"] is None else sizes["generations"]
    check_range("particles", particles, number(2, 1_000_000))
    check_range("generations", generations, number(1, 1_000_000))
    return particles * (generations + 1), particles


def read_space(chosen: argparse.Namespace, fixed_gains: Gains) -> SearchSpace:
    """Return the search space: `--tune`, `--bounds R=1:1e4` and `--fix N_p=25`.

    Raises:
        ValueError: Names the text that cannot be parsed, or the gain that is not tuned.
    """
    literal = chosen.method == LITERAL and chosen.formulation == "paper"
    fixed = dict((LITERAL_FIXED if literal else fixed_gains)._asdict())
    bounds_of = dict(DEFAULT_BOUNDS[chosen.formulation])
    if chosen.formulation != "paper":
        scale_to_period(chosen.settings, bounds_of, fixed)
    tuned = chosen.tune or (LITERAL_TUNED if literal else DEFAULT_TUNED[chosen.formulation])
    bounds = {
        key: bounds_of[key]
        for symbol in tuned
        for key in [BY_SPEED if symbol == "R" and BY_SPEED in bounds_of else symbol]
    }
    for text in chosen.bounds:
        symbol, _, ends = text.partition("=")
        low, _, high = ends.partition(":")
        if symbol in (*SYMBOLS, BY_SPEED) and symbol.removesuffix("/v^2") not in tuned:
            raise ValueError(f"--bounds {symbol}: is not among the tuned, {', '.join(tuned)}")
        if symbol in ("R", BY_SPEED):  # one of them replaces the other
            if sum(each.startswith(("R=", f"{BY_SPEED}=")) for each in chosen.bounds) > 1:
                raise ValueError(f"--bounds {text}: R has bounds already: name R or {BY_SPEED}")
            bounds = {key: ends for key, ends in bounds.items() if key not in ("R", BY_SPEED)}
        try:
            bounds[symbol] = (float(low), float(high))
        except ValueError as error:
            raise ValueError(f"--bounds {text}: must look like R=1:1e4") from error
    for text in chosen.fix:
        symbol, _, value = text.partition("=")
        if symbol not in SYMBOLS:
            raise ValueError(f"--fix {text}: unknown gain; known are {', '.join(SYMBOLS)}")
        if symbol in tuned:
            raise ValueError(f"--fix {text}: {symbol} is tuned: name the tuned gains with --tune")
        field = FIELDS[symbol]
        try:
            fixed[field] = int(value) if field in INTEGERS else float(value)
        except ValueError as error:
            raise ValueError(f"--fix {text}: must look like {symbol}=25") from error
    return search_space(bounds, Gains(**fixed))


def sample_time(settings: str) -> float:
    """Return the period of shipped controller settings, or of a file [s]."""
    return float(load(ControllerSettings, find("controllers", settings)).sample_time)


def scale_to_period(settings: str, bounds: dict[str, Bounds], fixed: dict[str, Any]) -> None:
    """Change bounds and fixed gains for 10 Hz to the period of other settings.

    With k ticks in 0.1 s the same loop has a pole that is the k-th root, and an increment weight
    k^2 times as large. The horizon spans the same time, up to MAX_HORIZON.
    """
    k = REFERENCE_PERIOD / sample_time(settings)
    if k <= 1.0:
        return
    N_p = min(round(k * fixed["prediction_horizon"]), MAX_HORIZON)
    fixed["control_horizon"] = round(fixed["control_horizon"] * N_p / fixed["prediction_horizon"])
    fixed["prediction_horizon"] = N_p
    low, high = bounds["alpha"]
    bounds["alpha"] = (max(low, LOWEST_POLE) ** (1 / k), high ** (1 / k))
    low, high = bounds[BY_SPEED]
    bounds[BY_SPEED] = (low * k**2, high * k**2)
