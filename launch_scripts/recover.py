"""Recover bags that are cut or damaged: ``recover BAG ... [--output NEW]``.

The recorder or `ros2 bag record` was killed, the disk was full, or bytes were damaged: all that is
undamaged is written into a new folder with index and `metadata.yaml`. The bag itself stays as it
is. A bag in SQLite is converted to MCAP. Exit code 0: recovered, or the bag is complete; 2: of one
of the bags nothing can be read.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing


def main(arguments: Sequence[str] | None = None) -> int:
    """Recover all bags and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    text = "folder of a bag, or one of its files"
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help=text)
    text = "new folder, for one bag (default: BAG_recovered)"
    parser.add_argument("--output", type=Path, help=text)
    options = parser.parse_args(arguments)
    if options.output and len(options.bags) > 1:
        parser.error(f"--output is for one bag, not for {len(options.bags)}")
    return max(recover_bag(bag, options.output) for bag in options.bags)


def recover_bag(bag: Path, chosen: Path | None) -> int:
    """Recover one bag into the chosen folder, print what came of it, and return the exit code."""
    from launch_scripts.bags.bag import reason_of
    from launch_scripts.bags.recovery import default_output, recover

    output = chosen or default_output(bag)
    try:
        print("\n".join(recover(bag, output)))
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: {output}: cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    except Exception as error:  # such as MemoryError
        print(f"error: {bag}: nothing can be read: {reason_of(error)}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
