"""Tune a gain table by particle swarm, judge it on unseen cars, and write it with its proof.

`python launch_scripts/tune.py --vehicle my_car.yaml`. Exit code 0: a table or a single gain set is
written; 2: wrong option, file or cluster; 130: interrupted, continue with `--resume`.
"""

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.text import Text

from ampc_msgs_config.config import shipped
from launch_scripts.tuning.choices import (
    FITNESS,
    FORMULATIONS,
    METHOD_NAMES,
    SCHEDULES,
    SETTINGS,
    SYMBOLS,
)

WRONG, INTERRUPTED = 2, 130
"""Exit codes."""
NOT_PART_OF_RESULT = ("output", "resume", "workers", "processes", "scheduler", "trust_scheduler")
"""Options that do not influence the result."""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--vehicle", default="paper", help=f"YAML file, or {', '.join(shipped('vehicles'))}")
    add(
        "--formulation",
        default="preview",
        choices=FORMULATIONS,
        help="of the controller",
    )
    add("--settings", default=SETTINGS, help=f"controller: {', '.join(shipped('controllers'))}")
    add(
        "--method",
        default="pso",
        choices=METHOD_NAMES,
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
    add("--schedule", choices=SCHEDULES, help="learn a schedule by speed, curvature and latency")
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    chosen = build_parser().parse_args(arguments)
    console = Console(highlight=False, soft_wrap=True)
    from launch_scripts.tuning.run_tuning import run_tuning  # loads compiled code

    try:
        run_tuning(chosen, command_of(chosen), console)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    except KeyboardInterrupt:
        console.print("interrupted: continue with --resume")
        return INTERRUPTED
    return 0


if __name__ == "__main__":
    sys.exit(main())
