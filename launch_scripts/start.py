"""Drive once over ROS 2: simulator, planner, controller, gate and recorder; write the result.

`python launch_scripts/start.py --scenario sc2`, or `--path my_road.csv --speed 9`. The exit code
is 0 after a complete drive, 1 if a node died or the car did not reach the end, 2 if an option is
invalid, 3 if a node stopped publishing, 130 after Ctrl-C, 143 after SIGTERM.
"""

import argparse
import os
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.text import Text

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ControllerSettings
from launch_scripts.run.options import (
    Run,
    prepare_run,
    print_vehicle_warnings,
    read_run_options,
    write_path,
)
from launch_scripts.run.processes import (
    COMPLETED,
    NODE_DIED,
    WRONG_SET_UP,
    Processes,
    ros_environment,
)

START_TIME_OUT = 180.0
"""Wall time for the discovery of the nodes, including compilation after an update [s]."""
LEAST_RATE, LARGEST_RATE = 50.0, 200.0
"""Rates of the states in real time; between them, that of the controller [Hz]."""
GRACE_AFTER_NODE_DEATH = 1.5
"""Wall time during which the other nodes continue without a dead node, in real time [s]."""
STOP_REQUESTED = "a stop is requested"
"""In the log line of the controller about a stop request."""
DISPENSABLE = {"markers"}
"""Nodes whose end does not end the drive."""
NOT_COMPLETED = NODE_DIED
"""Exit code of a drive that did not reach its end."""


class RunEnded(Exception):
    """The run has ended; the text is the reason."""

    def __init__(self, reason: str, code: int) -> None:
        """Store reason and exit code."""
        super().__init__(reason)
        self.code = code


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, write and print the result, and return the exit code."""
    options = read_run_options(arguments, __doc__)
    console = Console(highlight=False, soft_wrap=True)
    if options.write_path:
        return write_manoeuvre_file(options, console)
    os.environ.update(ros_environment())
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    try:
        run = prepare_run(options)
        print_vehicle_warnings(options.vehicle, console)
        if run.scenario.note:
            console.print(f"{options.path}: {run.scenario.note}", markup=False, highlight=False)
        return finish(run, drive_run(run, console), console)
    except (ValueError, RunEnded) as error:
        print_error(console, error)
        return error.code if isinstance(error, RunEnded) else WRONG_SET_UP


def write_manoeuvre_file(options: argparse.Namespace, console: Console) -> int:
    """Write the path of the manoeuvre for a real car, and return the exit code."""
    try:
        if not options.manoeuvre:
            raise ValueError("--write-path needs --manoeuvre identification")
        from sim_vehicle.parameters import load_vehicle_file

        write_path(options.write_path, load_vehicle_file(find("vehicles", options.vehicle)))
    except ValueError as error:
        print_error(console, error)
        return WRONG_SET_UP
    console.print(f"{options.write_path}: x_m,y_m,v_mps of {options.manoeuvre}", markup=False)
    return 0


def interrupt(number: int, _: Any) -> NoReturn:
    """End the run on a signal; further signals do not stop the shutdown, whose time is limited."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    raise RunEnded(f"interrupted by {signal.Signals(number).name}", 128 + number)


def drive_run(run: Run, console: Console) -> RunEnded:
    """Start the nodes, wait for the end of the drive, end the nodes, and return the reason."""
    try:
        with Processes(run.folder / "log", run.options["namespace"]) as nodes:
            try:
                start_nodes(nodes, run)
                follow(nodes, run, console)
            except RunEnded as ended:
                print_error(console, ended)
                if ended.code == NODE_DIED and run.options["real_time"]:
                    print_reactions(nodes, console)
                raise
    except RunEnded as ended:
        return ended
    return RunEnded(COMPLETED, 0)


def start_nodes(nodes: Processes, run: Run) -> None:
    """Start all nodes, the recorder first."""
    from ampc_msgs_config import topics
    from ampc_msgs_config.paths.path_file import Route
    from ampc_msgs_config.recording.message_types import TOPIC_TYPES

    # Parameters of each node
    options = run.options
    lock_step = not (options["real_time"] or options["faults"])
    common = {"lock_step": lock_step, "wait_for_recorder": True, "vehicle": options["vehicle"]}
    route = {key: options[key] for key in Route._fields}
    control = {key: options[key] for key in ("controller", "settings", "gain_table", "guard")}
    if options["require_certificate"]:
        control["require_certificate"] = True
    control["static_path"] = not options["faults"]  # the injector publishes the path repeatedly
    control["store_estimates"] = False
    plant = {key: options[key] for key in ("friction", "noise", "seed", "time_out")}
    plant["start_time_out"] = START_TIME_OUT
    plant["rate"] = state_rate(options["settings"])
    plant["vehicle"] = options["true_vehicle"] or options["vehicle"]
    record = {"output": str(run.bag), "use_sim_time": lock_step, "vehicle": options["vehicle"]}
    look = {key: common[key] for key in ("lock_step", "vehicle")}
    renamed = (
        {topic: f"{topics.FAULTY}{topic}" for topic in topics.FAULTED} if options["faults"] else {}
    )
    if options["faults"]:
        record["topics"] = [f"{new}:{TOPIC_TYPES[topic]}" for topic, new in renamed.items()]
    # Nodes
    nodes.start("recorder", "ampc_msgs_config.nodes.recorder_node", record)
    nodes.start("planner", "ampc_ros.nodes.planner_node", common | route)
    if options["faults"]:
        faults = {"faults": options["faults"], "vehicle": options["vehicle"]}
        nodes.start("injector", "launch_scripts.nodes.injector_node", faults)
    nodes.start("controller", "ampc_ros.nodes.controller_node", common | control, renamed)
    gated = {}
    if not options["no_gate"]:
        limits = {key: options[key] for key in ("guard", "settings")}
        nodes.start("gate", "ampc_ros.nodes.gate_node", common | limits)
        gated = {
            topics.STEERING_COMMAND: topics.GATE_STEERING,
            topics.TARGET_SPEED: topics.GATE_SPEED,
        }
    nodes.start("simulator", "sim_vehicle.nodes.simulator_node", common | route | plant, gated)
    nodes.start("markers", "ampc_msgs_config.nodes.marker_node", look)


def state_rate(settings: str) -> float:
    """Return the rate of the states in real time: at least that of the controller [Hz].

    Args:
        settings: Settings of the controller: shipped ones, or file.
    """
    period = load(ControllerSettings, find("controllers", settings)).sample_time
    return min(max(1.0 / period, LEAST_RATE), LARGEST_RATE)


def follow(nodes: Processes, run: Run, console: Console) -> None:
    """Show the progress until the simulator has ended the drive."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from launch_scripts.nodes.drive_watch import DriveWatch  # needs the environment set by main()

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[at]}"))
    printed: set[str] = set()
    scenario, namespace = run.scenario, run.options["namespace"]
    with (
        DriveWatch(namespace) as watch,
        Progress(*columns, TimeElapsedColumn(), console=console) as bar,
    ):
        task = bar.add_task(scenario.name, total=scenario.duration, at="starting")
        while not is_over(nodes):
            watch.look(0.1)
            if not watch.has_begun:
                print_compilation(nodes, console, printed)
            else:
                at = f"{watch.elapsed:.1f} of {scenario.duration:.1f} s, {watch.speed:.1f} m/s"
                bar.update(task, completed=watch.elapsed, at=at)
        bar.update(task, completed=scenario.duration, at=f"{scenario.duration:.1f} s driven")


def print_compilation(nodes: Processes, console: Console, printed: set[str]) -> None:
    """Print the log lines of the nodes about compilation that are not in `printed` yet."""
    for line in (line for name in nodes.running for line in nodes.lines(name)):
        if line.startswith(("compiling", "compiled")) and line not in printed:
            printed.add(line)
            console.print(line, markup=False)


def is_over(nodes: Processes) -> bool:
    """Return whether the simulator has ended the drive.

    Raises:
        RunEnded: Another node has ended, or the simulator failed.
    """
    ended = nodes.ended()
    if ended.get("simulator") == 0:
        return True
    for name, code in ended.items():
        if name in DISPENSABLE:
            continue
        if code < 0:
            raise RunEnded(f"{name} was killed by {signal.Signals(-code).name}", NODE_DIED)
        last = nodes.last_line(name)
        raise RunEnded(f"{name} ended with exit code {code}: {last}", code or NODE_DIED)
    return False


def print_reactions(nodes: Processes, console: Console) -> None:
    """Let the remaining nodes continue for a short time, and print what they log."""
    left = [name for name in nodes.running if name not in nodes.ended()]
    before = {name: len(nodes.lines(name)) for name in left}
    if "gate" in before:  # it reacts faster than this script
        before["gate"] = max(before["gate"] - 1, 0)
    console.print(f"{', '.join(left)} continue for {GRACE_AFTER_NODE_DEATH:g} s before they end:")
    time.sleep(GRACE_AFTER_NODE_DEATH)
    for name in left:
        for line in nodes.lines(name)[before[name] :]:
            console.print(f"  {name}: {line}", markup=False)


def print_stop_request(log: Path, console: Console) -> None:
    """Print the first line of the controller about a stop request, if there is one."""
    lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    for line in lines:
        if STOP_REQUESTED in line:
            said = line[line.index(STOP_REQUESTED) :]
            console.print(Text.assemble(("warning:", "yellow"), f" controller: {said}"))
            return


def print_error(console: Console, error: Exception) -> None:
    """Print one line."""
    console.print(Text.assemble(("error:", "red"), f" {error}"))


def finish(run: Run, ended: RunEnded, console: Console) -> int:
    """Write and print the result, and return the exit code."""
    # These modules load plotly, which the nodes need not wait for.
    from launch_scripts.bags.bag import open_bag
    from launch_scripts.bags.recovery import default_output, recover
    from launch_scripts.run.result import write_result

    code = ended.code
    try:
        table, incomplete = write_result(run, str(ended))
        console.print(table)
        print_stop_request(run.folder / "log" / "controller.log", console)
        files = "bag, report.html, report.json, metrics.json, logs"
        console.print(f"{files}: {run.folder}", markup=False)
        with open_bag(run.bag) as bag:
            is_complete = bag.is_complete
        if not is_complete:
            recovered = default_output(run.bag)
            recover(run.bag, recovered)
            text = f"the bag was not closed; complete except for its end: {recovered}"
            console.print(text, markup=False)
    except ValueError as error:
        if ended.code == WRONG_SET_UP:
            shutil.rmtree(run.folder)
        else:
            console.print(f"no result: {error}; logs: {run.folder / 'log'}", markup=False)
        return code or NODE_DIED
    if incomplete and not code:
        print_error(console, ValueError(f"not completed: {incomplete}"))
        code = NOT_COMPLETED
    return code


if __name__ == "__main__":
    sys.exit(main())
