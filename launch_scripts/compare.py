"""Compare controllers: drive each of them on each road, with the same car and noise.

`python launch_scripts/compare.py --controllers preview preview=mine.yaml --scenarios sc1 road.csv`
writes a table, a heat map and a page to `runs/compare`. A controller is NAME, NAME=GAINS with a
YAML file or a shipped table, or `my_file.py:MyController` (a class with `period` and
`step(state, path)`). The exit code is 0, even if a controller loses the car, and 2 if an option is
invalid.
"""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.text import Text

from ampc_msgs_config.config import shipped
from ampc_ros.configuration import CONTROLLERS
from launch_scripts.comparing.conditions import COMPARED_METRICS, Conditions
from launch_scripts.reporting.pages import add_format_option
from launch_scripts.run.options import add_speed_options

PAPERS = ("sc1", "sc2", "sc3_constant", "sc3_varying", "sc3_wind", "sc3_fast_wind", "sc1_falcone")
"""Roads of the paper and those derived from them, which are driven first."""
WRONG = 2
"""Exit code for an invalid option."""


def read_compare_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    roads = [*PAPERS, *(name for name in shipped("scenarios") if name not in PAPERS)]
    default = Conditions()._asdict()

    def add(name: str, text: str, **how: Any) -> None:
        value = how.setdefault("default", default.get(name))
        shown = "; default: %(default)s" if value and not isinstance(value, list) else ""
        parser.add_argument(f"--{name}", help=text + shown, **how)

    text = f"{', '.join(CONTROLLERS)}, each also as NAME=GAINS, or FILE.py:CLASS; default: all"
    add("controllers", text, nargs="+", metavar="NAME[=GAINS]", default=list(CONTROLLERS))
    text = f"{', '.join(roads)}, YAML or CSV files; default: all of these"
    add("scenarios", text, nargs="+", metavar="ROAD", default=roads)
    add_speed_options(parser)
    add("vehicle", "the car")
    add("settings", "settings of all controllers")
    text = "friction of the road, unknown to the controllers; default: that of the tyres"
    add("friction", text, type=float)
    text = "additional steering delay, unknown to the controllers [s]; default: 0"
    add("delay", text, type=float)
    add("noise", "measurement noise, such as x1; default: none")
    add("seed", "seed of the noise, equal in all cells; default: 0", type=int)
    text = "metric of table and heat map; the page shows all"
    add("quantity", text, choices=COMPARED_METRICS, default="rms")
    add("output", "folder", type=Path, default=Path("runs/compare"))
    add_format_option(parser, "table, figures, or figures on the pages of one file")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive all cells, print and write the result, and return the exit code."""
    options, console = read_compare_options(arguments), Console(highlight=False, soft_wrap=True)
    words = shlex.join(sys.argv[1:] if arguments is None else arguments)
    from launch_scripts.comparing.run_comparison import compare_chosen  # loads compiled code

    try:
        compare_chosen(options, f"python launch_scripts/compare.py {words}".strip(), console)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    return 0


if __name__ == "__main__":
    sys.exit(main())
