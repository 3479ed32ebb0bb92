"""Write a complete vehicle file from mass and wheelbase: `new_car --mass 2100 --wheelbase 2.85`.

Yaw inertia, cornering stiffness, tyres and everything else are estimated by published rules; the
file marks them as estimated with their spread. It covers model cars of 1:10 to buses. Exit code 0:
written; 2: the data sheet is impossible, or the file exists.
"""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.text import Text

from ampc_msgs_config.validation import hints
from launch_scripts.reporting.pages import terminal_table
from launch_scripts.run.options import print_vehicle_warnings
from launch_scripts.templates.vehicle_rules import TYPES, DataSheet, Template, vehicle_template

WRONG = 2
"""Exit code."""
SHOWN = ("chassis", "steering", "size", "body")
"""Sections of the printed table."""


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--mass", type=float, required=True, help="loaded as it is driven [kg]")
    add("--wheelbase", type=float, required=True, help="front axle to rear axle [m]")
    add("--front-share", type=float, help="front share of the mass, such as 0.55")
    add("--width", type=float, help="width of the body without mirrors [m]")
    text = "position on steering_command per road-wheel angle, such as 15 for a steering wheel"
    add("--steering-ratio", type=float, help=f"{text}; default: 1")
    add("--type", choices=list(TYPES), default="", help="default: by mass and wheelbase")
    add("--output", type=Path, default=Path("my_car.yaml"), help="file; default: %(default)s")
    add("--force", action="store_true", help="overwrite an existing file")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the file, print what is estimated, and return the exit code."""
    options, console = read_options(arguments), Console(highlight=False, soft_wrap=True)
    words = shlex.join(sys.argv[1:] if arguments is None else arguments)
    file: Path = options.output
    # These modules load compiled code.
    from launch_scripts.templates.vehicle_text import vehicle_text
    from sim_vehicle.parameters import load_vehicle_file

    try:
        sheet = DataSheet(**{key: getattr(options, key) for key in hints(DataSheet)})
        template = vehicle_template(sheet, options.type)
        if file.exists() and not options.force:
            raise ValueError(f"--output: {file} exists; --force overwrites it")
        try:
            file.write_text(vehicle_text(template, f"new_car {words}", file), encoding="utf-8")
        except OSError as error:
            raise ValueError(f"--output: {file} cannot be written: {error.strerror}") from error
        load_vehicle_file(file)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    console.print(terminal_table(("key", "value", ""), template_rows(template), "lrl", str(file)))
    print_vehicle_warnings(str(file), console)
    if options.steering_ratio:
        topics = "steering_command and steering_state carry"
        console.print(f"note: {topics} {options.steering_ratio:g} times the road-wheel angle")
    print_next(file, console)
    return 0


def template_rows(template: Template) -> list[tuple[str, str, str]]:
    """Return key, value and spread of the values that the controller and the road use."""
    from launch_scripts.templates.vehicle_text import spread_text

    return [
        (key, f"{value:g}", spread_text(key, spread) if spread is not None else "")
        for section in SHOWN
        for name, value in template.sections[section].items()
        for key in [f"{section}.{name}"]
        for spread in [template.estimated.get(key)]
    ]


def print_next(file: Path, console: Console) -> None:
    """Print the commands that use the file."""
    car = shlex.quote(str(file))
    console.print("next:")
    for command in (
        f"python launch_scripts/start.py --vehicle {car} --scenario sc2",
        f"python launch_scripts/tune.py --vehicle {car}",
        f"ros2 run ampc_ros controller --ros-args -p vehicle:={car}",
    ):
        console.print(f"  {command}", markup=False)


if __name__ == "__main__":
    sys.exit(main())
