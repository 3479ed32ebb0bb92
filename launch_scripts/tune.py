"""Tune a gain table by particle swarm, judge it on unseen cars, and write it with its proof.

`python launch_scripts/tune.py --vehicle my_car.yaml`. Exit code 0: a table or a single gain set is
written; 2: wrong option, file or cluster; 130: interrupted, continue with `--resume`.
"""

import argparse
import json
import os
import shlex
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.text import Text

from ampc_msgs_config.config import schema_line, shipped, shipped_schema
from ampc_ros.certificate import certify_command
from ampc_ros.configuration import Choices
from launch_scripts.run.options import print_vehicle_warnings
from launch_scripts.run.progress import Advance, show_progress
from launch_scripts.tuning.fitness import FITNESS, SETTINGS
from launch_scripts.tuning.learning import (
    KINDS,
    check_learnable,
    learn,
    schedule_searches,
    schedule_yaml,
)
from launch_scripts.tuning.methods import SEARCH_METHODS, SearchRecord
from launch_scripts.tuning.report import (
    TuningReport,
    polish_searches,
    prove,
    provenance,
    table_yaml,
)
from launch_scripts.tuning.search import Checkpoints, run_searches, write_atomically
from launch_scripts.tuning.task import (
    PRESETS,
    SYMBOLS,
    TABLE_SEARCH,
    Search,
    TuningTask,
    read_task,
)
from launch_scripts.tuning.workers import Workers, open_workers

WRONG, INTERRUPTED = 2, 130
"""Exit codes."""
NOT_PART_OF_RESULT = ("output", "resume", "workers", "processes", "scheduler", "trust_scheduler")
"""Options that do not influence the result."""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--vehicle", default="paper", help=f"YAML file, or {', '.join(shipped('vehicles'))}")
    add("--formulation", default="preview", choices=PRESETS, help="formulation of the controller")
    add("--settings", default=SETTINGS, help=f"controller: {', '.join(shipped('controllers'))}")
    add(
        "--method",
        default="pso",
        choices=SEARCH_METHODS,
        help="search method; paper: Eqs. (31)-(34)",
    )
    add("--fitness", choices=FITNESS, help="default: that of the formulation")
    add("--speeds", nargs="*", type=float, metavar="V", help="speeds of the table [m/s]")
    add("--references", nargs="*", type=float, metavar="Y", help="lateral references [m]")
    add("--tune", nargs="+", choices=SYMBOLS, metavar="GAIN", help=" ".join(SYMBOLS))
    add("--bounds", nargs="+", default=[], metavar="GAIN=LOW:HIGH", help="bounds of tuned gains")
    add("--fix", nargs="+", default=[], metavar="GAIN=VALUE", help="gains that are not tuned")
    add("--evaluations", type=int, help="at each node; default: paper 96, preview 48")
    add("--particles", type=int, help="of --method paper; default: 20")
    add("--generations", type=int, help="of --method paper; default: 15")
    add("--seeds", nargs="+", type=int, default=[1, 2], help="the best seed counts")
    add("--schedule", choices=KINDS, help="learn a schedule by speed, curvature and latency")
    add("--output", type=Path, help="file; default: runs/tune/<vehicle>_<...>.yaml")
    add("--resume", action="store_true", help="continue an interrupted tuning")
    add("--workers", type=int, default=os.cpu_count() or 1, help="number of threads")
    add("--processes", action="store_true", help="use processes instead of threads")
    add("--scheduler", default="", help="address of a Dask scheduler, tls://host:port or tcp://")
    text = "accept pickles from the scheduler: anyone who can reach it can run code here"
    add("--trust-scheduler", action="store_true", help=text)
    return parser


def command_of(chosen: argparse.Namespace) -> str:
    """Return the command that reproduces the table."""
    words = ["python", "launch_scripts/tune.py"]
    parser = build_parser()
    for key, value in vars(chosen).items():
        if key in NOT_PART_OF_RESULT or value == parser.get_default(key):
            continue
        values = value if isinstance(value, list) else [value]
        words += [f"--{key}", *(f"{v:g}" if isinstance(v, float) else str(v) for v in values)]
    return shlex.join(words)


def counting(advance: Advance) -> Callable[[Search, SearchRecord], None]:
    """Return a function that counts new evaluations of searches, in any thread."""
    shown: dict[str, int] = {}
    lock = threading.Lock()

    def show(search: Search, record: SearchRecord) -> None:
        with lock:
            new = len(record.fitness) - shown.get(search.name, 0)
            shown[search.name] = len(record.fitness)
            stage = f"{search.name}, best fitness {record.fitness.min():.3g}"
            advance(new * len(search.nodes), stage)

    return show


def search_and_prove(
    task: TuningTask, workers: Workers, checkpoints: Checkpoints, console: Console
) -> TuningReport:
    """Run all searches, show their progress, and compare their results."""
    searches = task.searches()
    total = sum(search.drives for search in searches)
    if task.is_smooth:
        total += sum(task.evaluations * len(task.speeds) for _ in task.seeds) - sum(
            search.drives for search in searches if search.purpose == TABLE_SEARCH
        )
    with show_progress(console, "tuning", total) as advance:
        show = counting(advance)
        results = run_searches(searches, workers, checkpoints, show)
        if polishes := polish_searches(task, results):
            results |= run_searches(polishes, workers, checkpoints, show)
        advance(0.0, "proof")
        return prove(task, results, workers)


def train_schedule(
    task: TuningTask,
    chosen: argparse.Namespace,
    output: Path,
    workers: Workers,
    checkpoints: Checkpoints,
    console: Console,
) -> None:
    """Learn a schedule of pole and increment weight, and write its gain file."""
    check_learnable(task)
    checkpoints.begin({**task.describe(), "schedule": chosen.schedule}, chosen.resume)
    total = sum(search.drives for search in schedule_searches(task))
    with show_progress(console, "training", total) as advance:
        learned = learn(task, chosen.schedule, workers, checkpoints, counting(advance))
    write_atomically(output, schedule_yaml(task, learned, command_of(chosen), output))
    checkpoints.clear()
    console.print(f"written: {output}, {len(learned.targets)} targets", markup=False)


def run_tuning(chosen: argparse.Namespace, console: Console) -> None:
    """Tune, show the proof, and write the files.

    Raises:
        ValueError: Names option or file, key, value and bound.
    """
    if chosen.workers < 1:
        raise ValueError(f"--workers {chosen.workers}: must be at least 1")
    task = read_task(chosen)
    print_vehicle_warnings(task.vehicle, console)
    words = [Path(task.vehicle).stem, task.formulation, task.kind]
    words += [Path(task.settings).stem] * (task.settings != SETTINGS)
    words += [chosen.schedule] * bool(chosen.schedule)
    name = f"{'_'.join(words)}.yaml"
    output = chosen.output or Path("runs/tune") / name
    if output.suffix not in (".yaml", ".yml") or output.is_dir():
        raise ValueError(f"--output {output}: must be a file that ends with .yaml")
    checkpoints = Checkpoints(output.with_suffix(".checkpoint"))
    options = chosen.workers, chosen.processes, chosen.scheduler, chosen.trust_scheduler
    with open_workers(*options) as workers:
        if chosen.schedule:
            train_schedule(task, chosen, output, workers, checkpoints, console)
            return
        checkpoints.begin(task.describe(), chosen.resume)
        report = search_and_prove(task, workers, checkpoints, console)
    console.print(report.screen_table())
    console.print(report.verdict)
    if report.warning:
        console.print(f"note: {report.warning}", markup=False)
    origin = provenance(task, report, command_of(chosen))
    proof = json.dumps(report.to_json() | {"task": origin}, indent=1, allow_nan=False)
    first = schema_line(shipped_schema("gains"), output)
    write_atomically(output, f"{first}\n{table_yaml(task, report, origin)}")
    write_atomically(output.with_suffix(".json"), f"{proof}\n")
    checkpoints.clear()
    console.print(f"written: {output} and the proof {output.stem}.json", markup=False)
    tuned = Choices(controller=task.formulation, vehicle=task.vehicle, settings=task.settings)
    console.print(f"certify it: {certify_command(tuned, output)}", markup=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    chosen = build_parser().parse_args(arguments)
    console = Console(highlight=False, soft_wrap=True)
    try:
        run_tuning(chosen, console)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    except KeyboardInterrupt:
        console.print("interrupted: continue with --resume")
        return INTERRUPTED
    return 0


if __name__ == "__main__":
    sys.exit(main())
