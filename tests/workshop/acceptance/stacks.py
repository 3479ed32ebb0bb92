"""Drive a lane change over ROS with each stack's own messages, and with ours, and compare.

`python -m tests.workshop.acceptance.stacks [--only nav2] [--update PAGE]` drives every case of
CASES, replays its recording, and writes a table. Exit code 0: no largest error is above RATIO times
that with our own types (medians of three drives), and every recording replays bit for bit.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from launch_scripts import replay
from launch_scripts.reporting.pages import markdown_table
from tests.foreign_messages import PACKAGES
from tests.message_packages import environment_with
from tests.workshop.attacks.attack import update

RATIO = 1.2
"""Largest error relative to that with our own planner and types."""
OWN = "own"
REPEATED = 3
"""Number of drives of each case."""
TIMEOUT = 600.0
"""Wall time of one drive [s]."""


class Case(NamedTuple):
    """One drive."""

    stack: str
    vehicle: str
    speed: float = 9.0
    """[m/s]."""
    scale: float = 1.0
    """Size of the lane change."""


ROBOT = "gazebo_ackermann"
CASES = (
    *(Case("autoware", car) for car in ("autoware_sample", "ordinary", "paper")),
    *(Case("carla", car) for car in ("carla", "ordinary", "paper")),
    *(Case("nav2", car) for car in (ROBOT, "ordinary", "paper")),
    *(Case("ros2_control", car) for car in (ROBOT, "ordinary", "paper")),
    *(Case("gazebo", car) for car in (ROBOT, "ordinary", "paper")),
    Case("f1tenth", "f1tenth", 2.0, 0.1),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive all cases, print a row for each, write the table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", help="one stack")
    parser.add_argument("--output", type=Path, default=Path("runs/stacks"), help="folder")
    parser.add_argument("--update", type=Path, help="page whose table is replaced")
    chosen = parser.parse_args(arguments)
    console = Console(highlight=False, soft_wrap=True)
    environment = environment_with(PACKAGES)
    own: dict[Case, dict[str, Any]] = {}
    rows = []
    for case in CASES:
        if chosen.only not in (None, case.stack):
            continue
        ours = case._replace(stack=OWN)
        if ours not in own:
            own[ours] = median(ours, chosen.output, environment)
        found = median(case, chosen.output, environment)
        rows.append(row(case, found, own[ours]))
        console.print(f"{', '.join(map(str, rows[-1]))}", markup=False)
    heads = ("stack", "car", "speed [m/s]", "largest error [m]", "with our types [m]", "ratio")
    text = "\n".join(markdown_table((*heads, f"<= {RATIO}", "replay"), rows, "llrrrrll")) + "\n"
    (chosen.output / "stacks.md").write_text(text, encoding="utf-8")
    console.print(text, markup=False)
    if chosen.update:
        update(chosen.update, text)
    return int(any("no" in each or "differs" in each for each in rows))


def median(case: Case, output: Path, environment: dict[str, str]) -> dict[str, Any]:
    """Return the drive of REPEATED whose largest error is the median; one that failed counts."""
    drives = [drive(case, output, environment) for _ in range(REPEATED)]
    failed = [each for each in drives if each["replay"] != "equal"]
    return (failed or sorted(drives, key=lambda each: float(each["largest_error"])))[
        0 if failed else REPEATED // 2
    ]


def drive(case: Case, output: Path, environment: dict[str, str]) -> dict[str, Any]:
    """Drive a case, replay its bag, and return the result."""
    folder = output / "_".join(map(str, case))
    words = [
        sys.executable,
        "-m",
        "tests.workshop.acceptance.stack_world",
        case.stack,
        "--vehicle",
        case.vehicle,
    ]
    words += ["--speed", str(case.speed), "--scale", str(case.scale), "--output", str(folder)]
    words += ["--overwrite"]
    done = subprocess.run(
        words, env=environment, capture_output=True, text=True, timeout=TIMEOUT, check=False
    )
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        return {"largest_error": float("nan"), "replay": done.stderr.strip()[-200:] or "no result"}
    result: dict[str, Any] = json.loads(lines[-1])
    words = [sys.executable, replay.__file__, str(folder / "bag")]
    replayed = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    result["replay"] = "equal" if replayed.returncode == 0 else "differs"
    return result


def row(case: Case, found: dict[str, Any], own: dict[str, Any]) -> tuple[Any, ...]:
    """Return the cells of a case."""
    errors = [each["largest_error"] for each in (found, own)]
    ratio = errors[0] / errors[1]
    texts = [f"{error:.4f}" for error in errors]
    met = "yes" if ratio <= RATIO else "no"
    return case.stack, case.vehicle, f"{case.speed:g}", *texts, f"{ratio:.2f}", met, found["replay"]


if __name__ == "__main__":
    sys.exit(main())
