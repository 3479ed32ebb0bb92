"""Recorders that are killed, or whose file or disk goes away."""

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from launch_scripts.run.processes import ros_environment
from tests.waiting import wait_for
from tests.workshop.attacks.attempts import Attempt, Choice, one_line
from tests.workshop.proofs.killed_recorder import Car, running_car
from tests.workshop.proofs.prove_recording import BOUND, prove

KILLS = 6
SMALL = 100_000
"""Largest file where the disk is full [bytes]."""
RECORDED = 2.0
"""Time for which messages are recorded before the attack, and after it [s]."""


def attempts(choice: Choice) -> Iterator[Attempt]:
    """Kill recorders, end them by signals, and take their files away."""
    os.environ.update(ros_environment())
    if choice.has("kill"):
        seed = choice.rng("kill").randrange(1000)
        folder = choice.folder / f"kills_{time.time_ns()}"
        folder.mkdir()
        for number, kill in enumerate(prove(folder, KILLS, seed)):
            what = f"lost {kill.loss:.2f} s of {BOUND:g}, gaps {kill.gaps}, opens {kill.opened}"
            yield Attempt(choice.area, f"kill {number}", "" if kill.is_good else what)
    attacks: dict[str, Callable[[], str]] = {
        f"{number.name}": partial(signalled, choice, number)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
    }
    for name, damage in DAMAGES.items():
        attacks[name] = partial(damaged, choice, name, damage)
    for name, path in {
        "read-only folder": "/proc/bag",
        "path below a file": "/dev/null/bag",
    }.items():
        attacks[name] = partial(refused, path)
    yield from choice.attempts(attacks)


def unlink(file: Path, _: subprocess.Popen[str]) -> None:
    """Remove the file."""
    file.unlink()


def replace(file: Path, _: subprocess.Popen[str]) -> None:
    """Put another file in its place."""
    other = file.with_suffix(".other")
    other.write_bytes(b"other")
    other.rename(file)


def truncate(file: Path, _: subprocess.Popen[str]) -> None:
    """Truncate the file."""
    os.truncate(file, 0)


def remove(file: Path, _: subprocess.Popen[str]) -> None:
    """Remove the folder."""
    shutil.rmtree(file.parent)


def fill(_: Path, process: subprocess.Popen[str]) -> None:
    """Allow no larger file, as on a full disk."""
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (SMALL, SMALL))


DAMAGES = {
    "file vanishes": unlink,
    "file is replaced": replace,
    "file is truncated": truncate,
    "folder vanishes": remove,
    "full disk": fill,
}


def start(bag: Path | str) -> subprocess.Popen[str]:
    """Start a recorder."""
    command = [sys.executable, "-m", "ampc_msgs_config.nodes.recorder_node", "--ros-args"]
    command += ["-p", f"output:={bag}"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def new_bag(choice: Choice) -> Path:
    """Return the path of a bag that does not exist."""
    return choice.folder / f"bag_{time.time_ns()}"


def record(car: Car, process: subprocess.Popen[str], bag: Path) -> None:
    """Record for a while."""
    wait_for(lambda: (bag / "metadata.yaml").exists() or process.poll() is not None)
    wait_for(car.is_matched)
    car.publish_for(RECORDED, 0.0)


def end(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Wait for the end of a recorder; return exit code and output."""
    try:
        text, _ = process.communicate(timeout=60.0)
    except subprocess.TimeoutExpired:
        process.kill()
        text, _ = process.communicate()
        return process.returncode, f"does not end: {text}"
    return process.returncode, text


def signalled(choice: Choice, number: int) -> str:
    """End a recorder by a signal: the bag is closed, with its index."""
    bag = new_bag(choice)
    with running_car() as car:
        process = start(bag)
        record(car, process, bag)
        process.send_signal(number)
        code, text = end(process)
    content = next(bag.glob("*.mcap")).read_bytes()
    is_closed = content[-8:] == content[:8]
    if code not in (0, 128 + number) or "Traceback" in text or not is_closed:
        return one_line(f"exit code {code}, closed: {is_closed}: {text}")
    return ""


def damaged(
    choice: Choice, name: str, damage: Callable[[Path, subprocess.Popen[str]], None]
) -> str:
    """Take the file of a running recorder away: it ends by itself with one line and exit code 1."""
    bag = new_bag(choice)
    with running_car() as car:
        process = start(bag)
        record(car, process, bag)
        damage(next(bag.glob("*.mcap")), process)
        until = time.monotonic() + 60.0
        while process.poll() is None and time.monotonic() < until:
            car.publish_for(RECORDED, 0.0)
        code, text = end(process)
    errors = [line for line in text.splitlines() if line.startswith("error: ")]
    if code != 1 or len(errors) != 1 or "Traceback" in text:
        return one_line(f"{name}: exit code {code}: {text[-300:]}")
    return ""


def refused(path: str) -> str:
    """Start a recorder whose bag cannot be written: one line, exit code 1 or 2."""
    code, text = end(start(path))
    is_one_line = len(text.strip().splitlines()) == 1 and text.startswith("error: ")
    return "" if code in (1, 2) and is_one_line else one_line(f"exit code {code}: {text[-300:]}")
