"""Fuzz the controller with random inputs: no exception, no command outside the limits.

`python -m tests.workshop.fuzz.fuzz`, for example with `--target core --seed 2`. Targets: `core`,
the node's core with changing configurations; `messages`, the same with ROS messages, a tenth of the
inputs; `guard`, checks and guard alone; `gate`, the core of the gate; `parameters`, the services of
all nodes, a hundredth. The same seed gives the same inputs on any number of workers. Exit code 1: a
guarantee is violated; the command that repeats the drive is printed.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed

from rich.console import Console
from rich.progress import Progress

from launch_scripts.tuning.workers import open_workers
from tests.workshop.fuzz.fuzz_core import core_drive
from tests.workshop.fuzz.fuzz_gate import gate_drive
from tests.workshop.fuzz.fuzz_guard import Violation, guard_drive
from tests.workshop.fuzz.fuzz_messages import message_drive
from tests.workshop.fuzz.fuzz_parameters import parameter_drive

TARGETS: dict[str, tuple[Callable[[int, int, int], Counter[str]], float]] = {
    "core": (core_drive, 1.0),
    "guard": (guard_drive, 1.0),
    "gate": (gate_drive, 1.0),
    "messages": (message_drive, 0.1),
    "parameters": (parameter_drive, 0.01),
}
"""Function of a target, and its share of --inputs."""
LENGTH = 5000
"""Number of inputs of a drive."""


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--target", choices=TARGETS, help="default: all")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--drive", type=int, help=f"only this one of {LENGTH} inputs each")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    return parser.parse_args(arguments)


def one_drive(target: str, seed: int, drive: int, count: int) -> Counter[str]:
    """Send the inputs of one drive.

    Raises:
        Violation: Its message ends with the command that repeats the drive.
    """
    try:
        return TARGETS[target][0](seed, drive, count)
    except Violation as violation:
        again = (
            f"python -m tests.workshop.fuzz.fuzz --target {target} --seed {seed} --drive {drive}"
        )
        raise Violation(f"{target}, seed {seed}, drive {drive}, {violation}\n{again}") from None


def all_drives(target: str, chosen: argparse.Namespace, console: Console) -> Counter[str]:
    """Send all inputs to one target.

    Raises:
        Violation: The first violation.
    """
    count = max(round(chosen.inputs * TARGETS[target][1]), 1)
    sizes = [min(LENGTH, count - begin) for begin in range(0, count, LENGTH)]
    done: Counter[str] = Counter()
    with (
        open_workers(chosen.workers, processes=True) as workers,
        Progress(console=console) as progress,
    ):
        task = progress.add_task(target, total=count)
        futures = {
            workers.executor.submit(one_drive, target, chosen.seed, drive, size): size
            for drive, size in enumerate(sizes)
        }
        try:
            for future in as_completed(futures):
                done += future.result()
                progress.advance(task, futures[future])
        finally:
            workers.executor.shutdown(wait=False, cancel_futures=True)
    return done


def summary(done: Counter[str]) -> str:
    """Return the numbers of inputs, rejections and commands, one kind in each line."""
    lines: dict[str, list[str]] = {}
    for name, count in sorted(done.items()):
        lines.setdefault(name.split()[0], []).append(f"{name} {count}")
    return "\n".join(", ".join(each) for each in lines.values())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    chosen, console = read_options(arguments), Console(highlight=False)
    try:
        for target in [chosen.target] if chosen.target else TARGETS:
            if chosen.drive is None:
                done = all_drives(target, chosen, console)
            else:
                done = one_drive(target, chosen.seed, chosen.drive, LENGTH)
            console.print(f"[bold]{target}[/bold]\n{summary(done)}")
    except Violation as violation:
        console.print(str(violation), markup=False)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
