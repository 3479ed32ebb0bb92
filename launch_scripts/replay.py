"""Feed a recorded run through the controller again, and compare every command with the old one.

`python launch_scripts/replay.py BAG`: the same programme on the same kind of machine gives the same
bits; the first difference is shown with its inputs. With `--controller`, `--gain-table` or `--set`
the changed controller answers the recorded situations (open loop: the recorded car does not react
to it); with `--close-loop` besides, it drives the simulated car of the bag from its start.

The exit code is 0 where all commands agree or something was changed, 1 where one differs, 2 where
the bag or an option is wrong.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ampc_msgs_config import __version__
from ampc_msgs_config.config import shipped
from ampc_msgs_config.metrics import METRICS, RESULT, Drive, evaluate
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, REASONS, RUNGS
from ampc_ros.configuration import CONTROLLERS, Choices, Configuration, configuration
from ampc_ros.supervision.rehearsal import rehearse
from ampc_ros.supervision.supervisor import Decision, Supervisor
from launch_scripts.replaying.recorded_run import RecordedRun, RecordedTick, read_run
from launch_scripts.replaying.repetition import (
    Change,
    Difference,
    differences,
    repeat,
    with_controller,
    with_gains,
    with_value,
)
from sim_vehicle.closed_loop import drive
from sim_vehicle.configuration import simulation_of

WRONG_SET_UP = 2


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("bag", type=Path, help="folder of a bag, or one MCAP file")
    add("--namespace", help="of the topics, such as /car1; default: where steering begins")
    add("--tolerance", type=float, default=0.0, help="of the angle [rad]; 0: bit for bit")
    add("--controller", choices=CONTROLLERS, help="another controller")
    add("--gain-table", help=f"other gains: YAML file, or {', '.join(shipped('gains'))}")
    add("--set", nargs="+", default=[], metavar="KEY=VALUE", help="such as settings.friction=0.5")
    add("--close-loop", action="store_true", help="drive the simulated car of the bag")
    text = "the car, where the bag does not say: YAML file, or " + ", ".join(shipped("vehicles"))
    add("--vehicle", default=Choices().vehicle, help=text + "; default: %(default)s")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Repeat, compare, show; gives the exit code."""
    chosen, console = options(arguments), Console(highlight=False, soft_wrap=True)
    try:
        changes, begin = changes_of(chosen), time.perf_counter()
        run = read_run(chosen.bag, chosen.namespace)
        reading = time.perf_counter() - begin
        config = changed(made_of(run, chosen), changes)
        say(run, console)
        if chosen.close_loop:
            return close_loop(run, config[min(config)], console)
        decisions, took = repeated(run, config, is_changed=bool(changes))
        code = compare(run, decisions, chosen.tolerance, reading + took, console)
        if changes:
            console.print("open loop: each tick answers the recorded situation and angle in force")
        return 0 if changes else code
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG_SET_UP


def changes_of(chosen: argparse.Namespace) -> list[Change]:
    """Give what is to be changed, in the order in which it acts."""
    changes = [with_controller(chosen.controller)] if chosen.controller else []
    changes += [with_gains(chosen.gain_table)] if chosen.gain_table else []
    return changes + [with_value(text) for text in chosen.set]


def made_of(run: RecordedRun, chosen: argparse.Namespace) -> dict[int, Configuration]:
    """Give what the controller was made of; where the bag is silent, what the options say."""
    if run.config:
        return run.config
    run.notes.append("no controller/configuration: taken as the default of --vehicle")
    choices = Choices(vehicle=chosen.vehicle, static_path=True, simulated_time=True)
    return {1: configuration(choices)}


def changed(
    configs: dict[int, Configuration], changes: Sequence[Change]
) -> dict[int, Configuration]:
    """Apply changes to every configuration of a run."""
    for change in changes:
        configs = {number: change(each) for number, each in configs.items()}
    return configs


def say(run: RecordedRun, console: Console) -> None:
    """Print what is missing in a bag."""
    if run.version not in ("", __version__):
        run.notes.append(f"recorded by version {run.version}, this is {__version__}")
    first = run.ticks[0].values.get("commands", 1.0)
    if first > 1:
        run.notes.append(f"begins at tick {first:.0f}: what the controller remembered is not known")
    for note in run.notes:
        console.print(f"note: {note}", markup=False)


def repeated(
    run: RecordedRun, config: dict[int, Configuration], *, is_changed: bool
) -> tuple[list[Decision], float]:
    """Replay a run; gives what was decided at each tick, and the time that it took [s]."""
    for each in config.values():
        rehearse(each)  # what has to be compiled does not count
    begin = time.perf_counter()
    decisions = list(repeat(run.ticks, config, synchronised=is_changed))
    return decisions, time.perf_counter() - begin


def summary(run: RecordedRun, decisions: Sequence[Decision], differ: int, took: float) -> Table:
    """Lay out how far a replay is from the recording, and how fast it was."""
    pairs = zip(run.ticks, decisions, strict=True)
    off = np.degrees([tick.values["steering"] - d.supervision.steering for tick, d in pairs])
    length = (run.ticks[-1].now_ns - run.ticks[0].now_ns) / NANOSECONDS
    table = Table(title=Text(f"replay of {run.bag}"), title_justify="left")
    for heading in ("quantity", "value", "unit"):
        table.add_column(heading, justify="right" if heading == "value" else "left")
    table.add_row("ticks", f"{len(run.ticks)}", "")
    table.add_row("ticks that differ", f"{differ}", "")
    table.add_row("difference of the angle, RMS", f"{np.sqrt(np.mean(off**2)):.3g}", "deg")
    table.add_row("difference of the angle, largest", f"{np.abs(off).max():.3g}", "deg")
    table.add_row("times real time, reading included", f"{length / took:.0f}", "")
    return table


def compare(
    run: RecordedRun, decisions: Sequence[Decision], tolerance: float, took: float, console: Console
) -> int:
    """Compare a replay with the recording, and show the first difference; gives the exit code."""
    pairs = list(zip(run.ticks, decisions, strict=True))
    found = [differences(tick, decision, tolerance) for tick, decision in pairs]
    console.print(summary(run, decisions, sum(map(bool, found)), took))
    for (tick, _), difference in zip(pairs, found, strict=True):
        if difference:
            show(tick, tick.now_ns - run.ticks[0].now_ns, difference, console)
            return 1
    console.print("every command is the recorded one" + (", bit for bit" if not tolerance else ""))
    return 0


def show(
    tick: RecordedTick, since_ns: int, difference: Sequence[Difference], console: Console
) -> None:
    """Print the first difference with the inputs of its tick."""
    table = Table(
        "quantity", "recorded", "repeated", title="first difference", title_justify="left"
    )
    for each in difference:
        table.add_row(each.quantity, f"{each.recorded:.17g}", f"{each.repeated:.17g}")
    console.print(table)
    console.print(f"at {since_ns / NANOSECONDS:.3f} s, stamp {tick.state.stamp_ns} ns")
    for name, value in tick.state._asdict().items():
        console.print(f"  {name} = {value!r}", markup=False)
    for name in ("state_age", "path_age", "measured_steering", "qp_fault", "configuration"):
        if name in tick.values:
            console.print(f"  {name} = {tick.values[name]!r}", markup=False)
    if "rung" in tick.values:
        rung, reason = RUNGS[int(tick.values["rung"])], REASONS[int(tick.values["reason"])]
        console.print(f"  rung = {rung}, reason = {reason}", markup=False)


def close_loop(run: RecordedRun, config: Configuration, console: Console) -> int:
    """Drive the simulated car of the bag, and show the result beside the recorded one."""
    if not run.simulator:
        raise ValueError(f"{run.bag}: no simulator/configuration, so there is no car to drive")
    simulation = simulation_of(run.simulator, f"{run.bag}: simulator/configuration")
    start_ns = run.ticks[0].state.stamp_ns
    closed = drive(simulation, Supervisor(config._replace(static_path=True)), start_ns)
    table = Table("quantity", "recorded", "closed loop", "unit", title="closed loop in simulation")
    before, after = (judged(each, run, config) for each in (recorded(run), closed))
    for key in RESULT:
        if np.isfinite(before[key]) and not key.startswith("solve_time"):
            values = f"{before[key]:.4g}", f"{after[key]:.4g}"
            table.add_row(METRICS[key].title, *values, METRICS[key].unit)
    console.print(table)
    return 0


def recorded(run: RecordedRun) -> Drive:
    """Give a recorded run as a drive."""
    steering = np.array([tick.values["steering"] for tick in run.ticks])
    solve_time = np.array([tick.values.get("solve_time", np.nan) for tick in run.ticks])
    return Drive([tick.state for tick in run.ticks], steering, solve_time)


def judged(finished: Drive, run: RecordedRun, config: Configuration) -> dict[str, Any]:
    """Give the numbers of a drive."""
    path = make_path(run.ticks[-1].path.points)
    return evaluate(finished, path, config.base_link_to_cg, config.settings.sample_time)


if __name__ == "__main__":
    sys.exit(main())
