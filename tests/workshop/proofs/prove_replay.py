"""Record drives over ROS, and replay each in two processes and with code that is compiled again.

`python -m tests.workshop.proofs.prove_replay` (about 5 minutes). The exit code is 0 where every
command of every drive is repeated bit for bit.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ampc_msgs_config.config import find

SCENARIOS = (
    *("sc1", "sc1_falcone", "sc2", "sc3_constant", "sc3_varying", "sc3_wind", "sc3_fast_wind"),
    *("iso3888_1", "circle", "sine"),
)
COLUMNS = ("once", "in another process", "compiled again", "times real time")


def main(arguments: Sequence[str] | None = None) -> int:
    """Record and replay, print a table, return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS, help="names or files")
    parser.add_argument("--real-time", action="store_true", help="record in real time")
    parser.add_argument(
        "--output", type=Path, help="folder of the drives; default: a temporary one"
    )
    chosen, console = parser.parse_args(arguments), Console(highlight=False)
    try:
        for name in chosen.scenarios:
            find("scenarios", name)
    except ValueError as error:
        parser.error(str(error))
    table = Table("scenario", *COLUMNS, title="commands that are repeated bit for bit")
    all_same = True
    with tempfile.TemporaryDirectory() as scratch:
        folder = chosen.output or Path(scratch) / "drives"
        fresh = {**os.environ, "NUMBA_CACHE_DIR": str(Path(scratch) / "cache")}
        for name in chosen.scenarios:
            bag = record(name, folder / Path(name).stem, real_time=chosen.real_time)
            results = [replay(bag, environment) for environment in (os.environ, os.environ, fresh)]
            table.add_row(Path(name).stem, *(same for same, _ in results), results[0][1])
            all_same &= all(same == "all" for same, _ in results)
            console.print(f"{name}: {', '.join(same for same, _ in results)}")
    console.print(table)
    return int(not all_same)


def record(name: str, folder: Path, *, real_time: bool) -> Path:
    """Drive over ROS; return the bag."""
    command = [sys.executable, "-m", "launch_scripts.start", "--output", str(folder)]
    command += ["--scenario", name] + ["--real-time"] * real_time
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return folder / "bag"


def replay(bag: Path, environment: Mapping[str, str]) -> tuple[str, str]:
    """Replay in a new process; return whether all commands agree, and the times of real time."""
    command = [sys.executable, "-m", "launch_scripts.replay", str(bag)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    speed = re.search(r"times real time[^\d]*(\d+)", ran.stdout)
    return "NOT ALL" if ran.returncode else "all", speed[1] if speed else "-"


if __name__ == "__main__":
    sys.exit(main())
