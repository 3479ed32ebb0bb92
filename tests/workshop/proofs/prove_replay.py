"""Record drives over ROS, and replay each in two processes and with code that is compiled anew.

`python tests/workshop/proofs/prove_replay.py` (about 5 minutes); the exit code is 0 where every
command of every drive comes out again, bit for bit.
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
from rich.progress import track
from rich.table import Table

from ampc_msgs_config.config import find

SCENARIOS = (
    "sc1",
    "sc1_falcone",
    "sc2",
    "sc3_constant",
    "sc3_varying",
    "sc3_wind",
    "sc3_fast_wind",
    "iso3888_1",
    "circle",
    "sine",
)
WAYS = ("once", "in another process", "compiled anew", "times real time")


def main(arguments: Sequence[str] | None = None) -> int:
    """Record, replay, show; gives the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS, help="shipped ones, or files")
    parser.add_argument("--real-time", action="store_true", help="record in real time")
    parser.add_argument("--output", type=Path, default=None, help="folder of the drives")
    chosen, console = parser.parse_args(arguments), Console(highlight=False)
    try:
        for name in chosen.scenarios:
            find("scenarios", name)
    except ValueError as error:
        parser.error(str(error))
    table = Table("scenario", *WAYS, title="commands that come out again, bit for bit")
    held = True
    with tempfile.TemporaryDirectory() as scratch:
        folder = chosen.output or Path(scratch) / "drives"
        fresh = {**os.environ, "NUMBA_CACHE_DIR": str(Path(scratch) / "cache")}
        for name in track(chosen.scenarios, "drives", console=console):
            bag = recorded(name, folder / Path(name).stem, real_time=chosen.real_time)
            answers = [replayed(bag, env) for env in (os.environ, os.environ, fresh)]
            table.add_row(Path(name).stem, *(same for same, _ in answers), answers[0][1])
            held &= all(same == "all" for same, _ in answers)
    console.print(table)
    return int(not held)


def recorded(name: str, folder: Path, *, real_time: bool) -> Path:
    """Drive over ROS; gives the bag."""
    command = [sys.executable, "-m", "launch_scripts.start", "--output", str(folder)]
    command += ["--scenario", name] + ["--real-time"] * real_time
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return folder / "bag"


def replayed(bag: Path, environment: Mapping[str, str]) -> tuple[str, str]:
    """Replay in a process of its own; gives whether all commands agree, and how fast it was."""
    command = [sys.executable, "-m", "launch_scripts.replay", str(bag)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    speed = re.search(r"times real time[^\d]*(\d+)", done.stdout)
    return "NOT ALL" if done.returncode else "all", speed[1] if speed else "-"


if __name__ == "__main__":
    sys.exit(main())
