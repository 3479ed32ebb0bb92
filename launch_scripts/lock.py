"""Write lock/: every package that requirements*.txt lead to, by version and hash. `make lock`.

All files are resolved together, for Linux and for every Python that this project serves. A version
that is in lock/ already stays as long as it fits; `make lock UPGRADE=1` takes the newest ones.
"""

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOCKS = ROOT / "lock"
HEAD = "# Written by `make lock` from {}: do not edit.\n"
COMPILE = [
    *("pip", "compile", "--quiet", "--universal", "--python-version=3.10"),
    *("--no-header", "--no-annotate", "--only-binary=:all:", "--no-binary=empy"),
]
WITH_ROS = "numpy"
"""Where ROS 2 is installed, its messages need its own numpy: only the ROS wheels bring one."""


def requirement_files() -> list[Path]:
    """Give the files that people edit."""
    return sorted(ROOT.glob("requirements*.txt"))


def lock_of(file: Path) -> Path:
    """Give the lock of a requirement file."""
    return LOCKS / file.name


def uv(*words: str) -> None:
    """Run the resolver; raises RuntimeError with what it said where it finds no way."""
    command = [str(Path(sys.executable).with_name("uv")), *COMPILE, *words]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    except FileNotFoundError:
        raise RuntimeError("uv is missing: make dev installs it") from None
    if done.returncode:
        raise RuntimeError(done.stderr.strip())


def without_hashes(text: str) -> str:
    """Give the pins of a lock alone."""
    return re.sub(r" \\\n( +--hash=\S+( \\)?\n?)+", "\n", text)


def lock(*, upgrade: bool) -> None:
    """Resolve all together, then write what each file needs of that."""
    files, found = requirement_files(), ""
    if not upgrade:
        found = "".join(without_hashes(path.read_text()) for path in sorted(LOCKS.glob("*.txt")))
    with tempfile.TemporaryDirectory() as folder:
        pins = Path(folder) / "pins.txt"
        pins.write_text("".join(sorted(set(found.splitlines(keepends=True)))), encoding="utf-8")
        uv("--output-file", str(pins), *(file.name for file in files))
        LOCKS.mkdir(exist_ok=True)
        for file in files:
            write(file, pins)


def write(file: Path, pins: Path) -> None:
    """Write the lock of one file."""
    left_out = [] if "ros" in file.stem else ["--no-emit-package", WITH_ROS]
    new = pins.with_name(file.name)
    hashed = "--generate-hashes", "--no-strip-extras"  # pip asks for the hash of name and extra
    uv(file.name, "--constraints", str(pins), *hashed, "--output-file", str(new), *left_out)
    text = HEAD.format(file.name) + new.read_text(encoding="utf-8")
    lock_of(file).write_text(text, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the locks; gives the exit code."""
    parser = argparse.ArgumentParser(description="Lock the requirements by version and hash.")
    parser.add_argument("--upgrade", action="store_true", help="take the newest versions that fit")
    try:
        lock(upgrade=parser.parse_args(arguments).upgrade)
    except RuntimeError as error:
        print(f"lock: {error}", file=sys.stderr)
        return 1
    print(f"written: {LOCKS.relative_to(ROOT)}/")
    return 0


if __name__ == "__main__":
    sys.exit(main())
