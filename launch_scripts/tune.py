"""Tune gains by particle swarm: vehicle and grid in, gain table with proof and provenance out.

`python launch_scripts/tune.py --vehicle my_car.yaml`. The exit code is 0 when a table or a single
gain set is written, 2 where something is wrong, 130 after Ctrl-C (`--resume` goes on).
"""

import argparse
import json
import os
import shlex
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from ampc_msgs_config.config import shipped
from ampc_ros.pso.swarm import PsoSettings, Swarm
from launch_scripts.tuning.files import Checkpoints, write_whole
from launch_scripts.tuning.fitness import FITNESS
from launch_scripts.tuning.report import Report, as_json, lines_of, prove
from launch_scripts.tuning.search import carry_out
from launch_scripts.tuning.space import PRESETS, SYMBOLS, read_bounds, read_fixed, search_space
from launch_scripts.tuning.table import provenance_of, text_of
from launch_scripts.tuning.task import Job, Task, check, describe, jobs_of
from launch_scripts.tuning.workers import Workers, open_workers

WRONG, INTERRUPTED = 2, 130
NOT_PART_OF_RESULT = ("output", "resume", "workers", "processes", "scheduler", "trust_scheduler")
"""Options that do not decide about the outcome."""


def parser() -> argparse.ArgumentParser:
    """Give the command line."""
    names = ", ".join(shipped("vehicles"))
    new = argparse.ArgumentParser(description=__doc__)
    new.add_argument("--vehicle", default="paper", help=f"YAML file, or {names}")
    new.add_argument("--formulation", default="preview", choices=PRESETS, help="of the controller")
    new.add_argument("--fitness", choices=FITNESS, help="default: the formulation's")
    new.add_argument("--speeds", nargs="*", type=float, metavar="V", help="grid [m/s]")
    new.add_argument("--references", nargs="*", type=float, metavar="Y", help="grid [m]")
    new.add_argument("--tune", nargs="+", choices=SYMBOLS, metavar="GAIN", help=" ".join(SYMBOLS))
    new.add_argument("--bounds", nargs="+", default=[], metavar="GAIN=LOW:HIGH")
    new.add_argument("--fix", nargs="+", default=[], metavar="GAIN=VALUE", help="not searched for")
    new.add_argument("--particles", type=int, help="default: 20, preview 10")
    new.add_argument("--generations", type=int, help="default: 15, preview 8")
    new.add_argument("--seeds", nargs="+", type=int, default=[1, 2], help="the best one counts")
    new.add_argument("--output", type=Path, help="file; default: runs/tune/<vehicle>_<...>.yaml")
    new.add_argument("--resume", action="store_true", help="go on after an interruption")
    new.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="threads")
    new.add_argument("--processes", action="store_true", help="use processes, not threads")
    new.add_argument("--scheduler", default="", help="of a Dask cluster, tls://host:port or tcp://")
    text = "take pickles from the scheduler: whoever reaches it runs code here"
    new.add_argument("--trust-scheduler", action="store_true", help=text)
    return new


def task_of(chosen: argparse.Namespace) -> Task:
    """Read what is asked for.

    Raises:
        ValueError: Names what is wrong.
    """
    preset = PRESETS[chosen.formulation]
    kind = chosen.fitness or preset.kind
    references = preset.references if kind == "paper" else (0.0,)
    particles = preset.particles if chosen.particles is None else chosen.particles
    generations = preset.generations if chosen.generations is None else chosen.generations
    given = read_bounds(chosen.bounds)
    tuned = chosen.tune or preset.tuned
    for symbol in given:
        if symbol in SYMBOLS and symbol not in tuned:
            raise ValueError(f"--bounds {symbol}: is not among the tuned, {', '.join(tuned)}")
    bounds = {**{symbol: preset.bounds[symbol] for symbol in tuned}, **given}
    task = Task(
        chosen.vehicle,
        chosen.formulation,
        kind,
        preset.speeds if chosen.speeds is None else tuple(chosen.speeds),
        references if chosen.references is None else tuple(chosen.references),
        search_space(bounds, read_fixed(chosen.fix, preset.fixed)),
        PsoSettings(particles=particles, generations=generations),
        tuple(chosen.seeds),
    )
    if chosen.workers < 1:
        raise ValueError(f"--workers {chosen.workers}: must be at least 1")
    check(task)
    return task


def command_of(chosen: argparse.Namespace) -> str:
    """Give the command that leads to the same table."""
    words = ["python", "launch_scripts/tune.py"]
    for key, value in vars(chosen).items():
        if key in NOT_PART_OF_RESULT or value == parser().get_default(key):
            continue
        values = value if isinstance(value, list) else [value]
        words += [f"--{key}", *(f"{v:g}" if isinstance(v, float) else str(v) for v in values)]
    return shlex.join(words)


def tune(task: Task, workers: Workers, checkpoints: Checkpoints, console: Console) -> Report:
    """Search with a progress bar, then judge."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[best]}"))
    clocks = TimeElapsedColumn(), TimeRemainingColumn(elapsed_when_finished=True)
    jobs = jobs_of(task)
    with Progress(*columns, *clocks, console=console) as bar:
        # work is counted in particles x nodes
        total = sum(_work(job) * (job.settings.generations + 1) for job in jobs)
        line = bar.add_task("compiling", total=total, best="")
        seen: dict[str, int] = {}
        lock = threading.Lock()

        def show(job: Job, swarm: Swarm) -> None:
            best = f"best fitness {swarm.best_fitness.min():.3g}"
            with lock:
                new = swarm.generation + 1 - seen.get(job.name, 0)
                seen[job.name] = swarm.generation + 1
            bar.update(line, advance=new * _work(job), description=job.name, best=best)

        outcome = carry_out(jobs, workers, checkpoints, show)
        bar.update(line, description="proof", best="")
        return prove(task, outcome, workers)


def _work(job: Job) -> int:
    return job.settings.particles * len(job.nodes)


def main(arguments: Sequence[str] | None = None) -> int:
    """Tune, prove, write; gives the exit code."""
    chosen, console = parser().parse_args(arguments), Console(highlight=False, soft_wrap=True)
    try:
        run(chosen, console)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    except KeyboardInterrupt:
        console.print("interrupted: --resume goes on")
        return INTERRUPTED
    return 0


def run(chosen: argparse.Namespace, console: Console) -> None:
    """Do what is asked for.

    Raises:
        ValueError: In one sentence what is wrong.
    """
    task, command = task_of(chosen), command_of(chosen)
    name = f"{Path(task.vehicle).stem}_{task.formulation}_{task.kind}.yaml"
    output = chosen.output or Path("runs/tune") / name
    checkpoints = Checkpoints(output.with_suffix(".checkpoint"))
    begin = checkpoints.resume if chosen.resume else checkpoints.begin
    hired = chosen.workers, chosen.processes, chosen.scheduler, chosen.trust_scheduler
    with open_workers(*hired) as workers:
        begin(describe(task))
        report = tune(task, workers, checkpoints, console)
    console.print(lines_of(report))
    console.print(report.verdict)
    proof = as_json(report) | {"task": provenance_of(task, report, command)}
    write_whole(output, text_of(task, report, command))
    write_whole(output.with_suffix(".json"), json.dumps(proof, indent=1, allow_nan=False) + "\n")
    checkpoints.clear()
    console.print(f"written: {output}, and the proof beside it", markup=False)


if __name__ == "__main__":
    sys.exit(main())
