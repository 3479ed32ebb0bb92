"""Identify a car from a recorded drive, and write its vehicle file.

`python launch_scripts/identify.py runs/a/bag --vehicle start.yaml` estimates steering, tyres, yaw
inertia and measured point from odometry, commands and, where recorded, measured steering. It
writes a vehicle file, a JSON file and a page. Mass and axle distances are taken from the start
vehicle. The exit code is 2 if an argument or the bag is invalid.
"""

import argparse
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.text import Text

from ampc_msgs_config.config import find
from launch_scripts.reporting.pages import terminal_table

WRONG, STOPPED = 2, 130
"""Exit codes."""
TABLE_WIDTH = 100
"""Smallest width of the printed tables [characters]."""


def read_identify_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("bag", type=Path, metavar="BAG", help="folder, or MCAP file")
    text = "vehicle to start from, name or YAML file; default: that of the recorded controller"
    add("--vehicle", help=text)
    add("--output", type=Path, help="folder of the results; default: next to the bag")
    add("--namespace", help="of the topics, as /car1; default: the first steered")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the bag, identify, write and print the results, and return the exit code."""
    options, console = read_identify_options(arguments), Console(highlight=False, soft_wrap=True)
    console.width = max(console.width, TABLE_WIDTH)
    command = f"identify {shlex.join(sys.argv[1:] if arguments is None else arguments)}"
    try:
        identify_bag(options, console, command)
    except (ValueError, OSError) as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    except KeyboardInterrupt:
        console.print("interrupted: the results are incomplete")
        return STOPPED
    return 0


def identify_bag(options: argparse.Namespace, console: Console, command: str) -> None:
    """Identify, and write and print everything.

    Raises:
        ValueError: Bag or vehicle are invalid, or no part of the drive can be used.
        OSError: A file cannot be written.
    """
    begin = time.monotonic()

    def log(text: str) -> None:
        console.print(f"[{time.monotonic() - begin:5.1f} s] {text}", markup=False)

    # Read
    log(f"reading {options.bag}")
    from launch_scripts.identifying.bag_recording import (  # loads compiled code
        read_recording,
        vehicle_of_file,
    )

    vehicle = vehicle_of_file(find("vehicles", options.vehicle)) if options.vehicle else None
    recording, vehicle, notes = read_recording(options.bag, options.namespace, vehicle)
    count = f"{len(recording.time)} states, {len(recording.command)} commands"
    log(f"{count}, {len(recording.steering)} measured steering angles; start: {vehicle.name}")
    # Identify
    from ampc_msgs_config.compilation import log_compilation
    from ampc_ros.identification.estimate import compile_model
    from ampc_ros.identification.result import identify

    with log_compilation("model of the identification", log):
        compile_model()
    try:
        result = identify(recording, vehicle.start(), log)
    except ValueError as error:
        raise ValueError(f"{options.bag}: {error}") from error
    # Write
    log("writing the results")
    from launch_scripts.identifying.files import write_json, write_vehicle
    from launch_scripts.identifying.page import identification_page
    from launch_scripts.identifying.tables import notes_of, quantity_rows, unknown_rows
    from launch_scripts.run.options import create_folder, naming

    folder = options.output or options.bag.resolve().parent
    with naming("output"):
        create_folder(folder, exist_ok=True)
    files = [folder / name for name in ("identified.yaml", "identified.json", "identified.html")]
    write_vehicle(files[0], result, vehicle, f"Written by {command}")
    write_json(files[1], result, vehicle, options.bag)
    page = identification_page(result, vehicle, notes, command)
    files[2].write_text(page, encoding="utf-8")
    # Print
    heads = ["quantity", "value", "95 % interval", "unit"]
    console.print(terminal_table(heads, quantity_rows(result), "lrrl"))
    for title, quantity in unknown_rows(result):
        line = f"{title}: not identifiable from this drive: {quantity.reason}."
        console.print(f"{line} What helps: {quantity.help}.", markup=False)
    for note in (*notes_of(result), *notes):
        console.print(f"note: {note}", markup=False)
    console.print(f"{', '.join(file.name for file in files)}: {folder}", markup=False)


if __name__ == "__main__":
    sys.exit(main())
