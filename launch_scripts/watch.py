"""Watch a running drive in the terminal: `ros2 run launch_scripts watch`.

Shows cross-track and heading error, steering, speed, fallback, gate, stop request, solve time, and
rate and age of each topic, five times a second; without a terminal one line per second. Before a
drive it names the topics that it waits for. Ctrl-C ends it with exit code 0.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console

from ampc_msgs_config.signals import handle_ending_signals
from launch_scripts.run.options import check_namespace
from launch_scripts.run.processes import ros_environment

if TYPE_CHECKING:
    from launch_scripts.watching.live_drive import LiveDrive

PICTURE_RATE = 5.0
"""Pictures a second."""
LINE_PERIOD = 1.0
"""Time between two lines without a terminal [s]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Show the drive until a signal arrives; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--namespace", default="", help="of the drive, such as car1; default: none")
    options = parser.parse_args(arguments)
    try:
        check_namespace(options.namespace)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    signals: list[int] = []
    handle_ending_signals(lambda number, _: signals.append(number))
    os.environ.update(ros_environment())
    show_live(options.namespace, Console(highlight=False), lambda: bool(signals))
    return 0


def show_live(namespace: str, console: Console, is_over: Callable[[], bool]) -> None:
    """Show a drive until `is_over` returns True."""
    from rich.live import Live

    from launch_scripts.nodes.drive_listener import open_listener  # needs the environment
    from launch_scripts.watching.live_drive import picture_of_drive

    with open_listener(namespace) as listen:
        if console.is_terminal:
            with Live(console=console, auto_refresh=False) as live:
                while not is_over():
                    live.update(picture_of_drive(listen(1.0 / PICTURE_RATE)), refresh=True)
            return
        while not is_over():
            print_line(console, listen(LINE_PERIOD))


def print_line(console: Console, drive: "LiveDrive") -> None:
    """Print one line with the time of day."""
    from launch_scripts.watching.live_drive import line_of_drive

    line = f"{time.strftime('%H:%M:%S')} {line_of_drive(drive)}"
    console.print(line, markup=False, soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main())
