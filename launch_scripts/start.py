"""Drive once over ROS 2: simulator, planner, controller and recorder, then the result.

`python launch_scripts/start.py --scenario sc2`, or `--path my_road.csv --speed 9`. The exit code
is 0 after a whole drive, 1 where a node died, 2 where an option is wrong, 3 where a node fell
silent, 130 after Ctrl-C, 143 after SIGTERM.
"""

import os
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from typing import Any, NoReturn

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from ampc_msgs_config import ros
from ampc_msgs_config.paths.path_file import Route
from ampc_msgs_config.recording.message_types import TYPES
from ampc_msgs_config.scenarios.scenario import Scenario
from launch_scripts.bags.bag import open_bag
from launch_scripts.bags.recovery import default_output, recover
from launch_scripts.run.environment import ros_environment
from launch_scripts.run.options import options, prepare
from launch_scripts.run.processes import Processes
from launch_scripts.run.result import Run, judge

START_TIME_OUT = 180.0
"""Wall time for the nodes to find each other, which includes compiling after an update [s]."""
FAULTY = (ros.ODOM, ros.STEERING_STATE, ros.REFERENCE_PATH)
"""What the controller gets from the injector where there are faults."""
GRACE_AFTER_NODE_DEATH = 1.5
"""Wall time in which the others show, in real time, what they do without a lost node [s]."""
DISPENSABLE = {"markers"}
"""Nodes without which a drive goes on."""
WRONG_SET_UP = 2
"""Exit code of this script and of a node whose options are wrong."""


class Ending(Exception):
    """What ended a run early, in one sentence, and the exit code."""

    def __init__(self, sentence: str, code: int) -> None:
        """Note sentence and exit code."""
        super().__init__(sentence)
        self.code = code


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, judge, show; gives the exit code."""
    chosen, console = options(arguments, __doc__), Console(highlight=False, soft_wrap=True)
    os.environ.update(ros_environment())
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    try:
        run = prepare(chosen)
        return finish(run, drive(run, console), console)
    except ValueError as error:
        print_error(console, error)
        return WRONG_SET_UP
    except Ending as ending:
        print_error(console, ending)
        return ending.code


def interrupt(number: int, _: Any) -> NoReturn:
    """End the run at a signal; the tidying up that follows is bounded in time and goes on."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    raise Ending(f"interrupted by {signal.Signals(number).name}", 128 + number)


def drive(run: Run, console: Console) -> Ending:
    """Start the nodes, follow the drive, end the nodes; tells how it ended."""
    try:
        with Processes(run.folder / "log") as nodes:
            try:
                start_nodes(nodes, run)
                follow(nodes, run.scenario, console)
            except Ending as ending:
                print_error(console, ending)
                if ending.code == 1 and run.options["real_time"]:
                    listen_to_the_others(nodes, console)
                raise
    except Ending as ending:
        return ending
    return Ending("completed", 0)


def start_nodes(nodes: Processes, run: Run) -> None:
    """Start the nodes, the recorder first."""
    given = run.options
    lock_step = not (given["real_time"] or given["faults"])
    common = {"lock_step": lock_step, "wait_for_recorder": True, "vehicle": given["vehicle"]}
    route = {key: given[key] for key in Route._fields}
    control = {key: given[key] for key in ("controller", "settings", "gain_table", "guard")}
    control["static_path"] = not given["faults"]  # published once, or anew by the injector
    plant = {key: given[key] for key in ("friction", "noise", "seed", "time_out")}
    plant["start_time_out"] = START_TIME_OUT
    record = {"output": str(run.bag), "use_sim_time": lock_step}
    renamed = {topic: f"{ros.FAULTY}{topic}" for topic in FAULTY} if given["faults"] else {}
    if given["faults"]:
        record["topics"] = [f"{new}:{TYPES[topic]}" for topic, new in renamed.items()]
    nodes.start("recorder", "ampc_msgs_config.nodes.recorder_node", record)
    nodes.start("planner", "ampc_ros.nodes.planner_node", common | route)
    if given["faults"]:
        nodes.start("injector", "launch_scripts.nodes.injector_node", {"faults": given["faults"]})
    nodes.start("controller", "ampc_ros.nodes.controller_node", common | control, renamed)
    nodes.start("simulator", "sim_vehicle.nodes.simulator_node", common | route | plant)
    look = {key: common[key] for key in ("lock_step", "vehicle")}
    nodes.start("markers", "ampc_msgs_config.nodes.marker_node", look)


def follow(nodes: Processes, scenario: Scenario, console: Console) -> None:
    """Show the progress until the simulator has ended the drive."""
    from launch_scripts.nodes.drive_watch import DriveWatch  # needs the environment that main() set

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[at]}"))
    told: set[str] = set()
    with DriveWatch() as watch, Progress(*columns, TimeElapsedColumn(), console=console) as bar:
        task = bar.add_task(scenario.name, total=scenario.duration, at="starting")
        while not is_over(nodes):
            watch.look(0.1)
            if not watch.has_begun:
                tell_what_compiles(nodes, console, told)
            else:
                at = f"{watch.elapsed:.1f} of {scenario.duration:.1f} s, {watch.speed:.1f} m/s"
                bar.update(task, completed=watch.elapsed, at=at)
        bar.update(task, completed=scenario.duration, at=f"{scenario.duration:.1f} s driven")


def tell_what_compiles(nodes: Processes, console: Console, told: set[str]) -> None:
    """Print what the nodes say about compiling, each line once."""
    for name in nodes.running:
        for line in nodes.words(name):
            if line.startswith(("compiling", "compiled")) and line not in told:
                told.add(line)
                console.print(line, markup=False)


def is_over(nodes: Processes) -> bool:
    """Tell whether the simulator has ended the drive.

    Raises:
        Ending: Another node has ended, or the simulator failed.
    """
    ended = nodes.ended()
    if ended.get("simulator") == 0:
        return True
    for name, code in ended.items():
        if name in DISPENSABLE:
            continue
        if code < 0:
            raise Ending(f"{name} was killed by {signal.Signals(-code).name}", 1)
        raise Ending(f"{name} ended with exit code {code}: {nodes.last_line(name)}", code or 1)
    return False


def listen_to_the_others(nodes: Processes, console: Console) -> None:
    """Let the nodes that are left show what they do without the lost one, and print it."""
    left = [name for name in nodes.running if name not in nodes.ended()]
    known = {name: len(nodes.words(name)) for name in left}
    console.print(f"{', '.join(left)} go on for {GRACE_AFTER_NODE_DEATH:g} s, and are ended then:")
    time.sleep(GRACE_AFTER_NODE_DEATH)
    for name in left:
        for line in nodes.words(name)[known[name] :]:
            console.print(f"  {name}: {line}", markup=False)


def print_error(console: Console, error: Exception) -> None:
    """Print one sentence."""
    console.print(Text.assemble(("error:", "red"), f" {error}"))


def finish(run: Run, ending: Ending, console: Console) -> int:
    """Judge what was driven, show it, and give the exit code."""
    try:
        console.print(judge(run, str(ending)))
        console.print(
            f"bag, report.html, metrics.json, drive.png and logs: {run.folder}", markup=False
        )
        with open_bag(run.bag) as bag:
            is_complete = bag.is_complete
        if not is_complete:
            recover(run.bag, default_output(run.bag))
            console.print(
                "the bag was not closed; all but its last moments, whole: "
                f"{default_output(run.bag)}",
                markup=False,
            )
    except ValueError as error:
        if ending.code == WRONG_SET_UP:
            shutil.rmtree(run.folder)
        else:
            console.print(f"nothing to judge: {error}; logs: {run.folder / 'log'}", markup=False)
        return ending.code or 1
    return ending.code


if __name__ == "__main__":
    sys.exit(main())
