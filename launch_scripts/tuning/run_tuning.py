"""Tuning from options to files: searches, proof, gain file."""

import argparse
import json
import threading
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from ampc_msgs_config.config import schema_line, shipped_schema
from ampc_ros.certificate import certify_command
from ampc_ros.configuration import Choices
from launch_scripts.run.options import print_vehicle_warnings
from launch_scripts.run.progress import Advance, show_progress
from launch_scripts.tuning.choices import SETTINGS
from launch_scripts.tuning.learning import (
    check_learnable,
    learn,
    schedule_searches,
    schedule_yaml,
)
from launch_scripts.tuning.methods import SearchRecord
from launch_scripts.tuning.report import (
    TuningReport,
    polish_searches,
    prove,
    provenance,
    table_yaml,
)
from launch_scripts.tuning.search import Checkpoints, run_searches, write_atomically
from launch_scripts.tuning.task import (
    TABLE_SEARCH,
    Search,
    TuningTask,
    read_task,
)
from launch_scripts.tuning.workers import Workers, open_workers


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
    command: str,
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
    write_atomically(output, schedule_yaml(task, learned, command, output))
    checkpoints.clear()
    console.print(f"written: {output}, {len(learned.targets)} targets", markup=False)


def run_tuning(chosen: argparse.Namespace, command: str, console: Console) -> None:
    """Tune, show the proof, and write the files.

    Args:
        chosen: Options of the command line.
        command: Command that repeats the tuning.
        console: Where progress and results appear.

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
            train_schedule(task, chosen, command, output, workers, checkpoints, console)
            return
        checkpoints.begin(task.describe(), chosen.resume)
        report = search_and_prove(task, workers, checkpoints, console)
    console.print(report.screen_table())
    console.print(report.verdict)
    if report.warning:
        console.print(f"note: {report.warning}", markup=False)
    origin = provenance(task, report, command)
    proof = json.dumps(report.to_json() | {"task": origin}, indent=1, allow_nan=False)
    first = schema_line(shipped_schema("gains"), output)
    write_atomically(output, f"{first}\n{table_yaml(task, report, origin)}")
    write_atomically(output.with_suffix(".json"), f"{proof}\n")
    checkpoints.clear()
    console.print(f"written: {output} and the proof {output.stem}.json", markup=False)
    tuned = Choices(controller=task.formulation, vehicle=task.vehicle, settings=task.settings)
    console.print(f"certify it: {certify_command(tuned, output)}", markup=False)
