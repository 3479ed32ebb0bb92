"""Measure how long each function takes to compile, for the estimates of the remaining time.

`python -m tests.workshop.proofs.compile_times` compiles everything anew, each program in a process
of its own, and writes `ampc_msgs_config/config/compile_times.json` (some minutes of processor
time). The programs share one cache, empty at first: each function is compiled and measured once.
The times depend on the machine; an estimate uses their ratios.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba.core.dispatcher import Dispatcher

from ampc_msgs_config.compilation import TIMES, on_compilation
from launch_scripts import compile_all

LEAST = 0.02
"""Functions that compile faster are left out [s]."""


def compile_node(module: str, name: str) -> None:
    """Create a node, which compiles everything that it calls."""
    import rclpy

    rclpy.init()
    getattr(__import__(module, fromlist=[name]), name)().destroy_node()
    rclpy.shutdown()


def compile_drive() -> None:
    """Compile what `make setup` compiles."""
    for pair in compile_all.PAIRS:
        for part in pair:
            part()


def compile_identification() -> None:
    """Compile the model of `identify.py`."""
    from ampc_ros.identification.estimate import compile_model

    compile_model()


COMPILATIONS: dict[str, Callable[[], None]] = {
    compile_all.WHAT: compile_drive,
    "controller": lambda: compile_node("ampc_ros.nodes.controller_node", "ControllerNode"),
    "simulator": lambda: compile_node("sim_vehicle.nodes.simulator_node", "SimulatorNode"),
    "planner": lambda: compile_node("ampc_ros.nodes.planner_node", "PlannerNode"),
    "marker": lambda: compile_node("ampc_msgs_config.nodes.marker_node", "MarkerNode"),
    "fleet of cars": lambda: compile_all.compile_fleet("preview"),
    "model of the identification": compile_identification,
}
"""By the name with which `log_compilation` reports it."""


def measure(what: str) -> tuple[dict[str, float], list[str]]:
    """Run a program in this process.

    Returns:
        Time of each function that was compiled [s], and names of all functions that are needed.
    """
    times: Counter[str] = Counter()
    with on_compilation(lambda: None, lambda name, own: times.update({name: own})):
        COMPILATIONS[what]()
    used = [each for each in dispatchers() if each.signatures]
    needed: dict[str, Any] = {}
    while used:
        each = used.pop()
        if name_of(each) not in needed:
            needed[name_of(each)] = each
            used += called_by(each)
    return dict(times), sorted(needed)


def dispatchers() -> list[Any]:
    """Return the compiled functions of all modules that are loaded."""
    modules = [each for each in list(sys.modules.values()) if each is not None]
    values = (value for each in modules for value in list(vars(each).values()))
    return [value for value in values if isinstance(value, Dispatcher)]


def called_by(function: Any) -> list[Any]:
    """Return the compiled functions that a compiled function calls by a global name."""
    python = function.py_func
    values = (python.__globals__.get(name) for name in python.__code__.co_names)
    return [value for value in values if isinstance(value, Dispatcher)]


def name_of(function: Any) -> str:
    """Return module and name of a compiled function."""
    return f"{function.py_func.__module__}.{function.py_func.__qualname__}"


def measure_elsewhere(what: str, cache: str) -> tuple[dict[str, float], list[str]]:
    """Run a program in a process of its own; return the result of `measure`."""
    with tempfile.NamedTemporaryFile("r") as result:
        command = [sys.executable, "-m", __spec__.name if __spec__ else "", what, result.name]
        subprocess.run(command, env=os.environ | {"NUMBA_CACHE_DIR": cache}, check=True)
        times, needed = json.load(result)
    return times, needed


def main() -> int:
    """Measure everything, or with two arguments one program into a file."""
    if len(sys.argv) == 3:
        Path(sys.argv[2]).write_text(json.dumps(measure(sys.argv[1])), encoding="utf-8")
        return 0
    times: dict[str, float] = {}
    table = {}
    with tempfile.TemporaryDirectory() as cache:
        for what in COMPILATIONS:
            compiled_now, needed = measure_elsewhere(what, cache)
            times |= compiled_now
            table[what] = {
                name: round(times[name], 2) for name in needed if times.get(name, 0.0) >= LEAST
            }
            print(f"{what}: {len(table[what])} functions, {sum(table[what].values()):.0f} s")
    Path(str(TIMES)).write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
