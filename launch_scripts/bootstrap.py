"""Set-up of the workspace: ``.venv``, the pinned requirements and the colcon build.

``python3 launch_scripts/bootstrap.py [--dev]`` may be run at any time: what is already there is left alone.
Where ROS 2 Jazzy is sourced its own rclpy, numpy and colcon are used; elsewhere the ROS wheels are installed.
"""

import sys

if sys.version_info < (3, 10):  # noqa: UP036 - whoever has an older Python shall read why
    sys.exit("bootstrap: Python 3.10 or newer is needed, this is %s" % sys.version.split()[0])

import argparse
import hashlib
import importlib.util
import os
import platform
import re
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / ".venv"
PYTHON = VENV / "bin" / "python"
STAMP = VENV / "bootstrap-stamp"
LOG = ROOT / "log" / "bootstrap.log"
SOURCES = ("ampc_msgs_config", "ampc_ros", "sim_vehicle", ".")
MACHINES = ("x86_64", "AMD64")

NO_NETWORK = re.compile(
    r"Failed to establish a new connection|Temporary failure in name resolution|Name or service not known"
    r"|Network is unreachable|Connection refused|timed out|ProxyError|SSLError|ConnectionError",
)
NO_COMPILER = re.compile(
    r"command '\S+' failed: No such file|unable to execute '\S+'|No such file or directory: '(?:gcc|cc|c\+\+|g\+\+)'"
    r"|Microsoft Visual C\+\+|Unknown compiler",
)
NO_WHEEL = re.compile(r"No matching distribution found for ([\w.\[\]-]+)")


class SetupError(Exception):
    """What stops the set-up, in one sentence."""


def main(argv: Sequence[str] | None = None) -> int:
    """Sets the workspace up and returns the exit code."""
    parser = argparse.ArgumentParser(description="Set up .venv and build the colcon workspace.")
    parser.add_argument("--dev", action="store_true", help="also install what tests and lint need")
    options = parser.parse_args(argv)
    try:
        bootstrap(dev=options.dev)
    except SetupError as error:
        print(f"bootstrap: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nbootstrap: interrupted; run it again to go on", file=sys.stderr)
        return 130
    return 0


def bootstrap(*, dev: bool) -> None:
    """Creates ``.venv``, installs into it and builds the workspace, each where needed."""
    with_ros = uses_installed_ros()
    LOG.parent.mkdir(exist_ok=True)
    LOG.write_text("", encoding="utf-8")
    wanted = f"{platform.python_version()} ros={with_ros} {ROOT}"
    stamp = STAMP.read_text(encoding="utf-8").splitlines() if STAMP.exists() else []
    if stamp[:1] != [wanted]:
        create_venv(with_ros)
        stamp = [wanted]
    files = requirement_files(with_ros=with_ros, dev=dev)
    if missing := [file for file in files if digest(file) not in stamp]:
        install(files)
        stamp += [digest(file) for file in missing]
        STAMP.write_text("\n".join(stamp) + "\n", encoding="utf-8")
    build(with_ros)


def uses_installed_ros() -> bool:
    """Tells whether ROS 2 Jazzy is sourced, and raises where neither it nor its wheels can be used."""
    distribution = os.environ.get("ROS_DISTRO", "")
    if distribution == "jazzy":
        if importlib.util.find_spec("rclpy") is None:
            raise SetupError(
                f"ROS 2 Jazzy is sourced, but Python {platform.python_version()} at {sys.executable} finds no "
                "rclpy: use the system's Python (make PYTHON=/usr/bin/python3)"
            )
        return True
    if distribution:
        raise SetupError(
            f"ROS 2 {distribution} is sourced, but Jazzy is needed: use a shell without it"
        )
    if sys.platform != "linux" or platform.machine() not in MACHINES:
        raise SetupError(no_ros_wheels(f"{platform.system()} on {platform.machine()}"))
    return False


def no_ros_wheels(machine: str) -> str:
    """The sentence for machines without ROS wheels."""
    return f"there are ROS 2 wheels for Linux on x86-64 only, this is {machine}: install ROS 2 Jazzy and source it"


def requirement_files(*, with_ros: bool, dev: bool) -> list[Path]:
    """Requirement files of this kind of machine."""
    names = {
        "requirements.txt": True,
        "requirements-ros.txt": not with_ros,
        "requirements-dev.txt": dev,
    }
    return [ROOT / name for name, needed in names.items() if needed]


def digest(file: Path) -> str:
    """Name and hash of a requirement file: one line of the stamp."""
    content = file.read_bytes() + (ROOT / "constraints.txt").read_bytes()
    return f"{file.name} {hashlib.sha256(content).hexdigest()}"


def create_venv(with_ros: bool) -> None:
    """Creates an empty ``.venv`` that sees the workspace's sources, as an editable installation would."""
    if importlib.util.find_spec("venv") is None or importlib.util.find_spec("ensurepip") is None:
        raise SetupError(
            "this Python has no venv module: install it (Debian and Ubuntu: apt install python3-venv)"
        )
    command = [sys.executable, "-m", "venv", "--clear", str(VENV)]
    command += ["--system-site-packages"] if with_ros else []
    title = f"creating .venv with Python {platform.python_version()}"
    output, failed = run(title, command)
    if failed:
        raise SetupError(f"no .venv could be made: {last_line(output)}; the log is {shown(LOG)}")
    site_packages = next(VENV.glob("lib/python3*/site-packages"))
    paths = [str((ROOT / source).resolve()) for source in SOURCES]
    (site_packages / "ampc_workspace.pth").write_text("\n".join(paths) + "\n", encoding="utf-8")


def install(files: Sequence[Path]) -> None:
    """Installs requirement files with pip: wheels only, nothing is compiled."""
    command = [
        str(PYTHON),
        "-m",
        "pip",
        "install",
        "--disable-pip-version-check",
        "--progress-bar=off",
    ]
    command += [
        "--only-binary=:all:",
        "--no-binary=empy",
    ]  # EmPy, pure Python, comes as source only
    for file in files:
        command += ["-r", file.name]
    output, failed = run("installing the requirements, about half a minute", command)
    if failed:
        raise SetupError(f"{explain_pip(output)}; the log is {shown(LOG)}")


def explain_pip(output: str) -> str:
    """Turns what pip printed before it gave up into one sentence.

    Args:
        output: everything pip wrote.

    Returns:
        The cause and the way out, without a full stop.
    """
    if NO_NETWORK.search(output):
        return "the package index cannot be reached: check network and proxy, then run this again"
    if NO_COMPILER.search(output):
        return "pip wants to compile a package and finds no C compiler: apt install build-essential"
    if "No space left on device" in output:
        return "the disk is full: the set-up needs about 1 GB"
    if wheel := NO_WHEEL.search(output):
        return (
            f"there is no wheel of {wheel[1]} for Python {platform.python_version()} on {platform.machine()}: "
            "use Python 3.10 to 3.13 on x86-64 (make PYTHON=python3.12)"
        )
    return f"pip failed: {last_line(output)}"


def build(with_ros: bool) -> None:
    """Builds the colcon workspace with the Python of ``.venv``."""
    if with_ros and importlib.util.find_spec("colcon_core") is None:
        raise SetupError("colcon is missing: apt install python3-colcon-common-extensions")
    output, failed = run("building the workspace", [str(PYTHON), "-m", "colcon", "build"])
    if failed:
        raise SetupError(f"colcon build failed: {last_line(output)}; the log is {shown(LOG)}")


def run(title: str, command: Sequence[str]) -> tuple[str, bool]:
    """Runs a command from the root, its output into the log, and shows how long it takes.

    Returns:
        The command's output and whether it failed.
    """
    start = time.monotonic()
    print(f"bootstrap: {title} ...", end="", flush=True)
    with LOG.open("a+", encoding="utf-8", errors="replace") as log:
        begin = log.seek(0, os.SEEK_END)
        code = subprocess.call(
            command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL
        )
        print(f" {time.monotonic() - start:.1f} s", flush=True)
        log.seek(begin)
        return log.read(), code != 0


def last_line(output: str) -> str:
    """The last line that says something."""
    return next(
        (line.strip() for line in reversed(output.splitlines()) if line.strip()), "no output"
    )


def shown(path: Path) -> str:
    """A path relative to the root."""
    return str(path.relative_to(ROOT))


if __name__ == "__main__":
    sys.exit(main())
