"""A tuning task: what decides about its outcome, and the searches that it is made of."""

import hashlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import check_range
from ampc_ros.mpc.gain_table import Gains, GainTable
from ampc_ros.pso.swarm import PsoSettings
from launch_scripts.tuning.drives import DEFINITION
from launch_scripts.tuning.fitness import FITNESS, Node, fitness, gains_of_row
from launch_scripts.tuning.fleet import Array
from launch_scripts.tuning.space import SYMBOLS, SearchSpace, gains_at
from sim_vehicle.parameters import Vehicle, load_vehicle

REACH = 2.0
"""Largest lateral reference that can be reached, per speed [s]."""
TABLE, SINGLE, RANDOM = "table", "single", "random"
"""What a search is for: one node; one set for all nodes; one node, by chance alone."""


class Task(NamedTuple):
    """All that decides about the outcome."""

    vehicle: str
    """Shipped name, or file."""
    formulation: str
    kind: str
    """Key of FITNESS."""
    speeds: tuple[float, ...]
    references: tuple[float, ...]
    space: SearchSpace
    settings: PsoSettings
    seeds: tuple[int, ...]


class Job(NamedTuple):
    """One search, and what it is known by."""

    purpose: str
    seed: int
    number: int
    """Of the node, or the number of nodes where it is for all of them."""
    nodes: tuple[Node, ...]
    space: SearchSpace
    settings: PsoSettings

    @property
    def name(self) -> str:
        """For files and people."""
        return f"{self.purpose}_{self.seed}_{self.number:03d}"

    @property
    def rng(self) -> np.random.Generator:
        """Random numbers of this search alone."""
        key = [self.seed, self.number] + [1] * (self.purpose == RANDOM)
        return np.random.default_rng(key)

    @property
    def cost(self) -> partial[Array]:
        """Fitness (n,) of particles (n, d), fit to be pickled."""
        return partial(cost, self.nodes, self.space)

    def gains(self, position: Array) -> Gains:
        """Gains of one particle (d,)."""
        return gains_of_row(gains_at(self.space, position[None])[0])


def cost(nodes: tuple[Node, ...], where: SearchSpace, positions: Array) -> Array:
    """Geometric mean over nodes of the fitness (n,) of particles (n, d)."""
    gains = gains_at(where, positions)
    return geometric_mean(np.array([fitness(node, gains) for node in nodes]))


def geometric_mean(values: Array) -> Array:
    """Over the first axis; infinite where one of them is."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.exp(np.log(values).mean(axis=0)))


def check(task: Task) -> None:
    """Refuse a task that makes no sense.

    Raises:
        ValueError: Names key, value and bound.
    """
    if task.kind not in FITNESS:
        raise ValueError(f"fitness = {task.kind!r} must be one of {', '.join(FITNESS)}")
    for key, axis in (("speeds", task.speeds), ("references", task.references)):
        low = 0.5 if key == "speeds" else -100.0
        if not axis:
            raise ValueError(f"{key} = [] must have at least one place")
        for i, place in enumerate(axis):
            check_range(f"{key}[{i}]", place, {"low": low, "high": 100.0, "unit": ""})
            if i and place <= axis[i - 1]:
                raise ValueError(f"{key}[{i}] = {place:g} must be greater than {axis[i - 1]:g}")
    if task.kind != "paper" and task.references != (0.0,):
        raise ValueError(f"references = {list(task.references)} must be [0] for fitness robust")
    if not task.seeds or min(task.seeds) < 0 or len(set(task.seeds)) < len(task.seeds):
        raise ValueError(f"seeds = {list(task.seeds)} must be different, and not negative")
    if not any(map(reached, nodes_of(task))):
        raise ValueError(f"references: none is reached, |y| <= {REACH:g} s v, at any speed")


def nodes_of(task: Task, speeds: tuple[float, ...] = ()) -> list[Node]:
    """Give the nodes in the order of a gain table, of the task's speeds or of others."""
    vehicle: Vehicle = load_vehicle(find("vehicles", task.vehicle))
    return [
        Node(vehicle, task.formulation, task.kind, speed, reference)
        for speed in speeds or task.speeds
        for reference in task.references
    ]


def reached(node: Node) -> bool:
    """Whether a car can be expected at the node's lateral reference at all."""
    return abs(node.reference) <= REACH * node.speed


def held_out(task: Task) -> list[Node]:
    """Give the nodes half-way between the speeds of the grid, which no search has seen."""
    between = tuple((a + b) / 2 for a, b in zip(task.speeds, task.speeds[1:], strict=False))
    return [node for node in nodes_of(task, between) if reached(node)] if between else []


def jobs_of(task: Task) -> list[Job]:
    """Give all searches, those with most work first; table, single set and chance cost the same."""
    nodes = nodes_of(task)
    places = [(i, node) for i, node in enumerate(nodes) if reached(node)]
    everywhere = tuple(node for _, node in places)
    swarm = task.settings
    particles = swarm.particles * (swarm.generations + 1)
    scattered = PsoSettings(particles=particles, generations=0)
    singles, tables, chances = [], [], []
    for seed in task.seeds:
        singles.append(Job(SINGLE, seed, len(nodes), everywhere, task.space, swarm))
        tables += [Job(TABLE, seed, i, (node,), task.space, swarm) for i, node in places]
        chances += [Job(RANDOM, seed, i, (node,), task.space, scattered) for i, node in places]
    return singles + tables + chances


def describe(task: Task) -> dict[str, Any]:
    """Give the task as JSON and YAML hold it: for checkpoints, and for the table's provenance."""
    searched = {symbol for symbol, _, _ in task.space.bounds}
    return {
        "version": __version__,
        "vehicle": task.vehicle if not Path(task.vehicle).is_file() else Path(task.vehicle).name,
        "vehicle_sha256": digest(find("vehicles", task.vehicle).read_bytes()),
        "drives_sha256": digest(DEFINITION.encode()),
        "formulation": task.formulation,
        "fitness": task.kind,
        "speed": list(task.speeds),
        "lateral_reference": list(task.references),
        "bounds": {symbol: [low, high] for symbol, low, high in task.space.bounds},
        "fixed": {
            symbol: value
            for symbol, value in zip(SYMBOLS, task.space.fixed, strict=True)
            if symbol not in searched
        },
        "swarm": "proposed",
        "particles": task.settings.particles,
        "generations": task.settings.generations,
        "seeds": list(task.seeds),
    }


def digest(content: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def lookup(content: Mapping[tuple[float, float], Gains], task: Task) -> GainTable:
    """Lay gains by speed and lateral reference out as a table; gaps take their neighbour's."""
    nodes = [content[nearest(content, s, y)] for s in task.speeds for y in task.references]
    return GainTable(list(task.speeds), list(task.references), nodes)


def nearest(
    content: Mapping[tuple[float, float], Gains], speed: float, reference: float
) -> tuple[float, float]:
    """Place of the nearest node that has gains: at the same speed if there is one."""
    return min(content, key=lambda at: (abs(at[0] - speed), abs(at[1] - reference)))
