"""Calls in processes in which nothing is compiled or loaded yet, but all modules are imported."""

import multiprocessing
import sys
from collections.abc import Callable
from functools import cache
from multiprocessing.context import ForkServerContext
from typing import Any

from numba.core.dispatcher import Dispatcher

PRELOADED = [
    "tests.fresh_process",
    "ampc_ros.nodes.controller_node",
    "ampc_ros.nodes.planner_node",
    "sim_vehicle.nodes.simulator_node",
]


@cache
def fork_server() -> ForkServerContext:
    """Return a context whose processes are copies of one that has only imported our modules."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context


def in_a_fresh_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function of a test module in a process of its own; return its result."""
    with fork_server().Pool(1) as fresh:
        return fresh.apply(function, arguments)


def compiled_signatures() -> dict[str, int]:
    """Count the compiled signatures of every function of our packages."""
    return {
        f"{module}.{name}": len(value.signatures)
        for module, content in list(sys.modules.items())
        if module.split(".")[0] in ("ampc_msgs_config", "ampc_ros", "sim_vehicle")
        for name, value in vars(content).items()
        if isinstance(value, Dispatcher)
    }
