"""Certify a gain table for a vehicle: check stability, margins and disturbances at all speeds.

`python launch_scripts/certify.py --vehicle my_car.yaml --gain-table t.yaml` writes a certificate
next to the gain table, where the controller finds it, and a page. Exit code 0: certified; 1: not
certified; 2: wrong option or file; 130: interrupted.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.text import Text

from ampc_msgs_config.config import shipped
from ampc_ros.configuration import CERTIFIED_CONTROLLERS, Choices

NOT_CERTIFIED, WRONG, INTERRUPTED = 1, 2, 130
"""Exit codes."""


def certify_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add, default = parser.add_argument, Choices()
    add(
        "--vehicle", default=default.vehicle, help=f"YAML file, or {', '.join(shipped('vehicles'))}"
    )
    text = f"YAML file, or {', '.join(shipped('gains'))}; default: that of start.py"
    add("--gain-table", default="", help=text)
    add("--controller", default=default.controller, help=" or ".join(CERTIFIED_CONTROLLERS))
    text = f"YAML file, or {', '.join(shipped('controllers'))}; default: %(default)s"
    add("--settings", default=default.settings, help=text)
    text = "folder of certificate and page; default: where the controller looks for them"
    add("--output", type=Path, help=text)
    add("--figures", type=Path, help="folder for the figures as PNG; default: none")
    add("--workers", type=int, default=os.cpu_count() or 1, help="number of threads")
    add("--shipped", action="store_true", help="certify every shipped table, into the package")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    chosen = certify_parser().parse_args(arguments)
    console = Console(highlight=False, soft_wrap=True)
    from launch_scripts.certifying.run_certify import certify_chosen  # loads compiled code

    try:
        return 0 if certify_chosen(chosen, console) else NOT_CERTIFIED
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    except KeyboardInterrupt:
        console.print("interrupted: nothing is written")
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
