"""Replay of one bag: read it, repeat its ticks, compare and print."""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find
from ampc_msgs_config.metrics import METRICS, RESULT, Drive, evaluate_drive
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, REASONS, RUNGS, TickRecord
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.configuration import Choices, Configuration, configuration
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.warm_up import warm_up
from launch_scripts.replaying.histories import History, describe_gaps, history_of
from launch_scripts.replaying.recorded_run import RecordedRun, RecordedTick, read_run
from launch_scripts.replaying.repetition import (
    Difference,
    differences,
    replay_ticks,
    with_controller,
    with_gains,
    with_value,
)
from sim_vehicle.closed_loop import drive
from sim_vehicle.configuration import simulation_of

WRONG_INPUT, NOT_COMPARABLE = 2, 3
"""Exit codes."""


def replay_bag(bag: Path, options: argparse.Namespace, console: Console) -> int:
    """Replay one bag, compare, print; return the exit code."""
    try:
        changes = [with_controller(options.controller)] if options.controller else []
        changes += [with_gains(options.gain_table)] if options.gain_table else []
        changes += [with_value(text) for text in options.set]
        begin = time.perf_counter()
        file = find("vehicles", options.vehicle)
        steering = load_section(SteeringParameters, file, "steering", "the replay")
        run = read_run(bag, options.namespace, options.odom, steering)
        reading = time.perf_counter() - begin
        configs, notes = run.config, run.notes
        if not configs:
            notes.append("no controller/configuration: the default of --vehicle is used")
            choices = Choices(vehicle=options.vehicle, static_path=True, simulated_time=True)
            configs = {1: configuration(choices)}
        if run.version not in ("", __version__):
            notes.append(f"recorded by version {run.version}, this is {__version__}")
        history = history_of(run, configs)
        notes += describe_gaps(history)
        for change in changes:
            configs = {number: change(each) for number, each in configs.items()}
        for note in notes:
            console.print(f"note: {note}", markup=False)
        if options.close_loop:
            return close_loop(run, configs[min(configs)], console)
        for config in configs.values():
            warm_up(config)  # the time to compile does not count
        begin = time.perf_counter()
        records = list(replay_ticks(history.ticks, configs, synchronised=bool(changes)))
        took = reading + time.perf_counter() - begin
        if changes or options.tolerance > 0:  # the memory is not compared
            history = history.all_compared()
        code = compare_ticks(run, history, records, options.tolerance, took, console)
        if changes:
            console.print("open loop: each tick answers the recorded situation and angle in force")
        return 0 if changes else code
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG_INPUT


def compare_ticks(
    run: RecordedRun,
    history: History,
    records: Sequence[TickRecord],
    tolerance: float,
    took: float,
    console: Console,
) -> int:
    """Compare a replay with the recording, print the first difference; return the exit code."""
    pairs = list(zip(history.ticks, records, strict=True))
    pairs = [(tick, record) for tick, record in pairs if tick.is_exact]
    different = [differences(tick, record, tolerance) for tick, record in pairs]
    console.print(replay_table(run, history, pairs, sum(map(bool, different)), took))
    for (tick, _), difference in zip(pairs, different, strict=True):
        if difference:
            print_difference(tick, tick.now_ns - run.ticks[0].now_ns, difference, console)
            return 1
    if not pairs:
        console.print("no tick can be compared bit for bit; --tolerance compares the angles")
        return NOT_COMPARABLE
    what = "every command" if len(pairs) == len(records) else f"each of {len(pairs)} commands"
    console.print(f"{what} equals the recorded one" + ("" if tolerance else ", bit for bit"))
    return 0


def replay_table(
    run: RecordedRun,
    history: History,
    pairs: Sequence[tuple[RecordedTick, TickRecord]],
    different: int,
    took: float,
) -> Table:
    """Return the table of differences and speed of a replay."""
    off = np.degrees([tick.values["steering"] - each.command.steering for tick, each in pairs])
    length = (run.ticks[-1].now_ns - run.ticks[0].now_ns) / NANOSECONDS
    table = Table(title=Text(f"replay of {run.bag}"), title_justify="left")
    for heading in ("quantity", "value", "unit"):
        table.add_column(heading, justify="right" if heading == "value" else "left")
    table.add_row("ticks", f"{len(run.ticks)}", "")
    if history.gaps:
        table.add_row("ticks missing in the bag", f"{history.missing}", "")
        table.add_row("ticks behind them, not compared", f"{len(run.ticks) - len(pairs)}", "")
    table.add_row("ticks that differ", f"{different}", "")
    if pairs:
        table.add_row("difference of the angle, RMS", f"{np.sqrt(np.mean(off**2)):.3g}", "deg")
        table.add_row("difference of the angle, largest", f"{np.abs(off).max():.3g}", "deg")
    table.add_row("times real time, reading included", f"{length / took:.0f}", "")
    return table


def print_difference(
    tick: RecordedTick, since_ns: int, difference: Sequence[Difference], console: Console
) -> None:
    """Print the first difference with the inputs of its tick."""
    table = Table(
        "quantity", "recorded", "replayed", title="first difference", title_justify="left"
    )
    for each in difference:
        table.add_row(each.quantity, f"{each.recorded:.17g}", f"{each.replayed:.17g}")
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
    """Drive the simulated car of the bag, and print its metrics beside the recorded ones."""
    if not run.simulator:
        raise ValueError(f"{run.bag}: no simulator/configuration, so there is no car to drive")
    simulation = simulation_of(run.simulator, f"{run.bag}: simulator/configuration")
    start_ns = run.ticks[0].state.stamp_ns
    closed = drive(simulation, Supervisor(config._replace(static_path=True)), start_ns)
    steering = np.array([tick.values["steering"] for tick in run.ticks])
    solve_time = np.array([tick.values.get("solve_time", np.nan) for tick in run.ticks])
    recorded = Drive([tick.state for tick in run.ticks], steering, solve_time)
    path = make_path(run.ticks[-1].path.points)
    before, after = (
        evaluate_drive(each, path, config.base_link_to_cg, config.settings.sample_time)
        for each in (recorded, closed)
    )
    table = Table("quantity", "recorded", "closed loop", "unit", title="closed loop in simulation")
    for key in RESULT:
        if np.isfinite(before[key]) and not key.startswith("solve_time"):
            values = f"{before[key]:.4g}", f"{after[key]:.4g}"
            table.add_row(METRICS[key].title, *values, METRICS[key].unit)
    console.print(table)
    return 0
