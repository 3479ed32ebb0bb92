"""Replay a recorded run through the controller, and compare every command with the recorded one.

`python launch_scripts/replay.py BAG ...`: the same version on the same kind of machine gives the
same bits; the first difference is printed with its inputs. With `--controller`, `--gain-table` or
`--set` the changed controller answers the recorded situations (open loop: the recorded car does not
react to it). With `--close-loop` it drives the simulated car of the bag from its start.

Ticks that are missing in the bag are reported. Behind them the replay is exact from the next
`controller/memory` on; ticks before it are compared with `--tolerance` only.

The exit code is the largest of all bags: 0 where all commands are equal or the configuration was
changed, 1 where one differs, 2 where the bag or an option is wrong, 3 where no tick could be
compared bit for bit.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console

from ampc_msgs_config.config import shipped
from ampc_ros.configuration import CONTROLLERS, Choices


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("bags", nargs="+", type=Path, metavar="BAG", help="folder of a bag, or one of its files")
    add("--namespace", help="namespace of the topics, such as /car1; default: of the first command")
    add("--odom", metavar="TOPIC", help="odometry that the controller used; default: odom")
    add("--tolerance", type=float, default=0.0, help="of the angle [rad]; 0: bit for bit")
    add("--controller", help=f"another controller: {', '.join(CONTROLLERS)}, or FILE.py:CLASS")
    add("--gain-table", help=f"other gains: YAML file, or {', '.join(shipped('gains'))}")
    add("--set", nargs="+", default=[], metavar="KEY=VALUE", help="such as settings.friction=0.5")
    add("--close-loop", action="store_true", help="drive the simulated car of the bag")
    text = "the car, if the bag does not name it: YAML file, or " + ", ".join(shipped("vehicles"))
    add("--vehicle", default=Choices().vehicle, help=text + "; default: %(default)s")
    options = parser.parse_args(arguments)
    if not options.tolerance >= 0.0:
        parser.error(f"--tolerance {options.tolerance:g} must be at least 0 rad")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Replay, compare, print; return the exit code."""
    options, console = read_options(arguments), Console(highlight=False, soft_wrap=True)
    from launch_scripts.replaying.replay_bag import replay_bag  # loads compiled code

    codes = []
    for bag in options.bags:
        if len(options.bags) > 1:
            console.print(f"{bag}:", markup=False)
        codes.append(replay_bag(bag, options, console))
    return max(codes)


if __name__ == "__main__":
    sys.exit(main())
