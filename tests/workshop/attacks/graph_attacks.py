"""The whole graph with the gate: each node is killed and started again, and stopped for a time."""

import os
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import rclpy

from launch_scripts.run.processes import Processes, ros_environment
from tests.workshop.attacks.attempts import Attempt, Choice
from tests.workshop.proofs.prove_restarts import LONGEST_PAUSE, WITH_GATE, Restarts

PATIENCE = 120.0
"""Wall time after which a moment has failed [s]."""
PAIRS = (("controller", "gate"), ("planner", "gate"), ("simulator", "controller"))
"""Nodes that are killed together."""


def attempts(choice: Choice) -> Iterator[Attempt]:
    """Kill and stop nodes of a drive in real time; a failed moment is followed by another drive."""
    moments: dict[str, Callable[[Restarts, float], str]] = {}
    for name in WITH_GATE:
        moments[f"{name} killed"] = partial(kill, (name,))
        moments[f"{name} stopped"] = partial(freeze, name)
    for pair in PAIRS:
        title = " and ".join(pair)
        moments[f"{title} killed"] = partial(kill, pair)
    left = [name for name in moments if choice.has(name)]
    os.environ.update(ros_environment())
    number = 0
    while left:
        number += 1
        rclpy.init()
        try:
            with Processes(choice.folder / f"graph_{number}") as nodes:
                graph = Restarts(nodes, PATIENCE, WITH_GATE)
                while left:
                    name = left.pop(0)
                    failure = one_moment(choice, graph, name, moments[name])
                    yield Attempt(choice.area, name, failure)
                    if failure:
                        break
        finally:
            rclpy.shutdown()


def kill(names: Sequence[str], graph: Restarts, pause: float) -> str:
    """Kill nodes and start them again."""
    return graph.moment(names, pause)


def freeze(name: str, graph: Restarts, pause: float) -> str:
    """Stop a node for a time."""
    return graph.freeze(name, pause)


def one_moment(
    choice: Choice, graph: Restarts, name: str, moment: Callable[[Restarts, float], str]
) -> str:
    """Attack at a random moment; return what is wrong."""
    rng = choice.rng(name)
    graph.spin(rng.uniform(0.0, LONGEST_PAUSE))
    try:
        moment(graph, rng.uniform(0.3, LONGEST_PAUSE))
    except ValueError as error:
        return str(error)
    return ""
