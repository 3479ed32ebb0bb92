"""Connect controller, planner and gate to another stack: `connect.py nav2 --vehicle my_car.yaml`.

The shipped stacks are files of parameters and remappings; --parameter and --remap change single
ones. It starts the nodes, prints what they report, and ends them with Ctrl-C: exit code 0. The exit
code is 1 if a node died, 2 if an option is invalid.
"""

import argparse
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

import yaml
from rich.console import Console
from rich.text import Text

from ampc_msgs_config import config
from ampc_msgs_config.stack_file import Stack, load_stack
from launch_scripts.run.options import check_namespace
from launch_scripts.run.processes import (
    NODE_DIED,
    WRONG_SET_UP,
    Processes,
    ros_environment,
)

NODES = {
    "planner": "ampc_ros.nodes.planner_node",
    "controller": "ampc_ros.nodes.controller_node",
    "gate": "ampc_ros.nodes.gate_node",
}
"""Nodes that every stack starts, and their modules."""
WHOLE_NUMBERS = ("laps", "seed")
"""Parameters that ROS takes as whole numbers only."""
PERIOD = 0.2
"""Wall time between two looks at the nodes [s]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Start the nodes, print their reports until a signal arrives, and return the exit code."""
    options = read_options(arguments)
    console = Console(highlight=False, soft_wrap=True)
    os.environ.update(ros_environment())
    ended: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: ended.append(number))
    try:
        stack = choose_stack(options)
        console.print(f"{options.stack}: {stack.about}", markup=False)
        with Processes(options.log) as nodes:
            start_stack(nodes, stack, options)
            return watch(nodes, ended, console)
    except (ValueError, OSError) as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG_SET_UP


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = ", ".join(config.shipped("stacks"))
    add = parser.add_argument
    add("stack", help=f"YAML file, or {names}")
    add("--vehicle", help="YAML file, or shipped car; default: that of the stack")
    text = "parameter of the nodes instead of the stack's, such as speed=2.0; can be repeated"
    add("-p", "--parameter", action="append", default=[], metavar="NAME=VALUE", help=text)
    text = "topic of the stack, such as odom=/my/odom; can be repeated"
    add("-r", "--remap", action="append", default=[], metavar="TOPIC=OTHER", help=text)
    add("--output", type=Path, help="new folder for a recording; default: none")
    add("--namespace", default="", help="namespace of nodes and topics; default: none")
    text = "folder of the nodes' log files; default: below runs"
    add("--log", type=Path, help=text)
    options = parser.parse_args(arguments)
    name = f"connect_{Path(options.stack).stem}_{time.strftime('%Y%m%d_%H%M%S')}"
    options.log = options.log or Path("runs") / name
    return options


def choose_stack(options: argparse.Namespace) -> Stack:
    """Return the stack with the changes of the options.

    Raises:
        ValueError: File, key, value; or an option that is no NAME=VALUE.
    """
    check_namespace(options.namespace)
    stack = load_stack(options.stack)
    parameters = stack.parameters | {
        name: parsed(name, value) for name, value in map(pair, options.parameter)
    }
    if options.vehicle:
        parameters["vehicle"] = options.vehicle
    if missing := [name for name in stack.required if not parameters.get(name)]:
        raise ValueError(f"{options.stack} needs -p {missing[0]}=VALUE")
    return Stack(
        about=stack.about,
        parameters=parameters,
        required=stack.required,
        remappings=stack.remappings | dict(map(pair, options.remap)),
    )


def pair(text: str) -> tuple[str, str]:
    """Split NAME=VALUE, or NAME:=VALUE as ROS writes it.

    Raises:
        ValueError: There is no = or no name.
    """
    name, equals, value = text.partition("=")
    name = name.removesuffix(":")
    if not (equals and name):
        raise ValueError(f"{text!r} must be written NAME=VALUE")
    return name, value


def parsed(name: str, value: str) -> Any:
    """Return the value of a parameter as YAML reads it; whole numbers are numbers of ROS, too.

    Raises:
        ValueError: It is no single value.
    """
    try:
        content = yaml.safe_load(value) if value else ""
    except yaml.YAMLError as error:
        raise ValueError(f"--parameter {name} = {value!r}: no YAML value") from error
    if not isinstance(content, bool | int | float | str):
        raise ValueError(f"--parameter {name} = {value!r} must be one value")
    is_whole = isinstance(content, int) and not isinstance(content, bool)
    return float(content) if is_whole and name not in WHOLE_NUMBERS else content


def start_stack(nodes: Processes, stack: Stack, options: argparse.Namespace) -> None:
    """Start recorder, planner, controller and gate."""
    namespace = {"__ns": f"/{options.namespace.strip('/')}"} if options.namespace else {}
    renamed = stack.remappings | namespace
    if options.output:
        times = {"use_sim_time": bool(stack.parameters.get("use_sim_time", False))}
        car = {k: v for k, v in stack.parameters.items() if k in ("vehicle", "base_link_to_cg")}
        record = {"output": str(options.output)} | times | car
        nodes.start("recorder", "ampc_msgs_config.nodes.recorder_node", record, renamed)
    for name, module in NODES.items():
        nodes.start(name, module, stack.parameters, renamed)


def watch(nodes: Processes, ended: Sequence[int], console: Console) -> int:
    """Print new lines of the logs until a signal arrives or a node ends; return the exit code."""
    printed = dict.fromkeys(nodes.running, 0)
    while True:
        for name in nodes.running:
            for line in nodes.lines(name)[printed[name] :]:
                printed[name] += 1
                console.print(f"{name}: {line}", markup=False)
        if ended:
            return 0
        for name, code in nodes.ended().items():
            last = nodes.last_line(name)
            text = f" {name} ended with exit code {code}: {last}"
            console.print(Text.assemble(("error:", "red"), text))
            return code if code == WRONG_SET_UP else NODE_DIED
        time.sleep(PERIOD)


if __name__ == "__main__":
    sys.exit(main())
