"""Set up the workspace: ``.venv``, locked requirements, colcon build, compiled code.

``python3 launch_scripts/bootstrap.py [--dev] [--bench]`` can be repeated at any time; it executes
only the missing steps. If ROS 2 Jazzy is sourced, its rclpy, numpy and colcon are used, otherwise
the ROS wheels. This file needs nothing but the standard library.
"""

import sys

if sys.version_info < (3, 10):  # noqa: UP036 - older versions get a message instead of a SyntaxError
    sys.exit(f"bootstrap: Python 3.10 or newer is needed, this is {sys.version.split()[0]}")

import argparse
import hashlib
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

WORKSPACE = Path(__file__).resolve().parents[1]
VENV = WORKSPACE / ".venv"
PYTHON = VENV / "bin" / "python"
LOCKS = WORKSPACE / "lock"
LOG = WORKSPACE / "log" / "bootstrap.log"
COLCON_PACKAGES = ("ampc_msgs_config", "ampc_ros", "sim_vehicle", "launch_scripts")
SOURCES = (WORKSPACE, *(WORKSPACE / package for package in COLCON_PACKAGES[:-1]))
QUIET_START = '''"""SIGINT ends a node silently from the first moment of Python on."""

import _signal  # the module signal takes longer to import
import os
import sys

if any("/lib/ampc_" in each or "/lib/sim_vehicle/" in each for each in sys.orig_argv[1:2]):
    _signal.signal(_signal.SIGINT, lambda *_: os._exit(0))
'''
"""Module that .venv imports at the start of Python. A node installs its own handlers later, after
the modules are imported with which setuptools looks up the entry point."""

PIP_FAILURES = {
    r"Failed to establish a new connection|Temporary failure in name resolution|ProxyError"
    r"|Name or service not known|Network is unreachable|Connection refused|timed out|SSLError": (
        "the package index cannot be reached: check network and proxy, then run this again"
    ),
    r"command '\S+' failed: No such file|unable to execute '\S+'|Unknown compiler"
    r"|No such file or directory: '(?:gcc|cc|g\+\+|c\+\+)'": (
        "a package must be compiled but there is no compiler: apt install build-essential"
    ),
    r"DO NOT MATCH THE HASHES": (
        "the hash of a package differs from the lock file (lock/): do not use that index"
    ),
    r"No space left on device": "the disk is full: .venv needs about 1 GB",
    r"No matching distribution found for ([\w.\[\]-]+)": (
        "there is no wheel of {wheel} for Python {version} on {machine}: "
        "use Python 3.10 to 3.14 on x86-64 (make PYTHON=python3.12)"
    ),
}
"""Cause and remedy by regular expression for the output of pip; the first match counts."""


class SetupError(Exception):
    """Raised with one sentence that states why the set-up cannot continue."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Set up the workspace and return the exit code."""
    parser = argparse.ArgumentParser(description="Set up .venv and build the colcon workspace.")
    parser.add_argument("--dev", action="store_true", help="also install tools for tests and lint")
    parser.add_argument("--bench", action="store_true", help="also install the benchmark's solvers")
    chosen = parser.parse_args(arguments)
    try:
        bootstrap(dev=chosen.dev, bench=chosen.bench)
    except SetupError as error:
        print(f"bootstrap: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"bootstrap: {error.strerror}: {error.filename}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nbootstrap: interrupted; run it again to continue", file=sys.stderr)
        return 130
    return 0


def bootstrap(*, dev: bool, bench: bool = False) -> None:
    """Create ``.venv``, install the requirements, build and compile; skip what is up to date."""
    with_ros = uses_installed_ros(os.environ.get("ROS_DISTRO", ""))
    LOG.parent.mkdir(exist_ok=True)
    LOG.write_text("", encoding="utf-8")
    home = f"{WORKSPACE}, Python {platform.python_version()}, installed ROS: {with_ros}"
    # .venv for this folder, Python and kind of ROS
    if done_steps(VENV) != {home}:
        create_venv(with_ros)
        mark(VENV, {home})
    # requirements, by name and content of the lock files
    needed = {"": True, "-ros": not with_ros, "-dev": dev, "-bench": bench}
    requirements = [LOCKS / f"requirements{name}.txt" for name in needed if needed[name]]
    wanted = {f"{file.name} {digest([file])}" for file in requirements}
    installed = done_steps(VENV / "lib")
    if not wanted <= installed:
        install(requirements)
        mark(VENV / "lib", installed | wanted)
    # colcon build and compiled code, by content of the sources
    files = (file for name in COLCON_PACKAGES for file in sorted((WORKSPACE / name).rglob("*")))
    sources = digest(file for file in files if file.is_file() and "__pycache__" not in file.parts)
    if done_steps(WORKSPACE / "install") != {sources}:
        build_workspace()
        mark(WORKSPACE / "install", {sources})


def uses_installed_ros(distribution: str) -> bool:
    """Check whether ROS 2 Jazzy is sourced.

    Raises:
        SetupError: Neither ROS 2 Jazzy nor the wheels can be used.
    """
    if not distribution:
        require_wheels(platform.system(), platform.machine())
        return False
    if distribution != "jazzy":
        raise SetupError(f"ROS 2 {distribution} is sourced: use a shell without it, or with Jazzy")
    if subprocess.run([sys.executable, "-c", "import rclpy"], capture_output=True).returncode:
        raise SetupError(
            f"ROS 2 Jazzy is sourced, but {sys.executable} cannot import its rclpy: "
            "use the Python of that ROS installation (make PYTHON=/usr/bin/python3)"
        )
    if importlib.util.find_spec("colcon_core") is None:
        raise SetupError("colcon is missing: apt install python3-colcon-common-extensions")
    return True


def require_wheels(system: str, machine: str) -> None:
    """Raise a SetupError if there are no ROS 2 wheels for an operating system and machine."""
    if (system, machine) != ("Linux", "x86_64"):
        raise SetupError(
            f"ROS 2 wheels exist only for Linux on x86-64, and this is {system} on {machine}: "
            "install ROS 2 Jazzy, source it and run this again"
        )


def digest(files: Iterable[Path]) -> str:
    """Return one hash over names and contents of files."""
    total = hashlib.sha256()
    for file in files:
        total.update(f"{file.relative_to(WORKSPACE)}\0".encode() + file.read_bytes() + b"\0")
    return total.hexdigest()


def done_steps(folder: Path) -> set[str]:
    """Return the steps that are marked as done in a folder."""
    stamp = folder / "bootstrap-stamp"
    return set(stamp.read_text(encoding="utf-8").splitlines()) if stamp.exists() else set()


def mark(folder: Path, steps: set[str]) -> None:
    """Mark steps as done, in the folder that they create."""
    text = "\n".join(sorted(steps)) + "\n"
    (folder / "bootstrap-stamp").write_text(text, encoding="utf-8")


def create_venv(with_ros: bool) -> None:
    """Create an empty ``.venv`` whose path contains the sources, as an editable installation."""
    if not (importlib.util.find_spec("venv") and importlib.util.find_spec("ensurepip")):
        raise SetupError("Python's venv module is missing: apt install python3-venv")
    for built in ("build", "install"):  # they contain the path of the previous interpreter
        shutil.rmtree(WORKSPACE / built, ignore_errors=True)
    command = [sys.executable, "-m", "venv", "--clear", str(VENV)]
    command += ["--system-site-packages"] if with_ros else []
    output, failed = run(f"creating .venv with Python {platform.python_version()}", command)
    if failed:
        raise SetupError(f".venv cannot be created: {last_line(output)}")
    site_packages = next(VENV.glob("lib/python3*/site-packages"))
    lines = "".join(f"{source}\n" for source in SOURCES)
    lines += "import ampc_quiet_start\n"
    (site_packages / "ampc_workspace.pth").write_text(lines, encoding="utf-8")
    (site_packages / "ampc_quiet_start.py").write_text(QUIET_START, encoding="utf-8")


def install(requirements: Sequence[Path]) -> None:
    """Install lock files with pip: verified hashes and wheels only, no compilation."""
    command = [str(PYTHON), "-m", "pip", "install", "--retries=2", "--require-hashes"]
    command += ["--disable-pip-version-check"]
    command += ["--only-binary=:all:", "--no-binary=empy"]  # EmPy is pure Python without a wheel
    command += [argument for file in requirements for argument in ("-r", str(file))]
    output, failed = run("installing the requirements (about a minute)", command)
    if failed:
        raise SetupError(explain_pip(output, platform.python_version(), platform.machine()))


def explain_pip(output: str, version: str, machine: str) -> str:
    """Return cause and remedy of a failure of pip with a Python version, in one sentence."""
    for pattern, cause in PIP_FAILURES.items():
        if match := re.search(pattern, output):
            return cause.format(wheel=(*match.groups(), "")[0], version=version, machine=machine)
    return f"pip failed: {last_line(output)} ({LOG.relative_to(WORKSPACE)})"


def build_workspace() -> None:
    """Build the colcon workspace, and compile, so that the first drive does not wait for it."""
    output, failed = run("building the workspace", [str(PYTHON), "-m", "colcon", "build"])
    if failed:
        cause = re.search(r"^\w*Error: .*", output, re.MULTILINE)
        line = cause[0] if cause else last_line(output)
        raise SetupError(f"colcon build failed: {line} ({LOG.relative_to(WORKSPACE)})")
    command = [str(PYTHON), "-m", "launch_scripts.compile_all"]
    output, failed = run(
        "compiling control tick, simulated car and fleet", command, shown="compiling"
    )
    if failed:
        raise SetupError(f"compiling failed: {last_line(output)} ({LOG.relative_to(WORKSPACE)})")


def run(title: str, command: Sequence[str], shown: str = "") -> tuple[str, bool]:
    """Run a command in the root folder, show its duration, and log its output.

    Args:
        title: What the command does.
        command: Program and arguments.
        shown: Pattern of the lines of its output that are printed as they come; empty: none.

    Returns:
        Output of the command, and whether it failed.
    """
    start, lines = time.monotonic(), []
    print(f"bootstrap: {title} ...", end="", flush=True)
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    pipes |= {"encoding": "utf-8", "errors": "replace", "stdin": subprocess.DEVNULL}
    with (
        LOG.open("a", encoding="utf-8", errors="replace") as log,
        subprocess.Popen(command, cwd=WORKSPACE, **pipes) as process,
    ):
        assert process.stdout
        for line in process.stdout:
            log.write(line)
            log.flush()
            lines.append(line)
            if shown and re.match(shown, line):
                print(f"\nbootstrap: {line.rstrip()}", end="", flush=True)
    done = "\nbootstrap: done in" if shown and any(re.match(shown, line) for line in lines) else ""
    print(f"{done} {time.monotonic() - start:.0f} s", flush=True)
    return "".join(lines), process.returncode != 0


def last_line(output: str) -> str:
    """Return the last line that is not empty."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    return lines[-1] if lines else "no output"


if __name__ == "__main__":
    sys.exit(main())
