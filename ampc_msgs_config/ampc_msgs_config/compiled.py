"""One decorator for every compiled function, and one safe place for the compiled code."""

import hashlib
import importlib.util
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

F = TypeVar("F", bound=Callable[..., Any])
IN_PLACE: dict[str, Any] = {"error_model": "numpy", "nogil": True, "_nrt": False}
PACKAGES = ("ampc_msgs_config", "ampc_ros", "sim_vehicle")
KEPT = 3
"""Versions whose compiled code is kept, this one included."""
IN_USE = 24 * 3600.0
"""Compiled code that a process has asked for within this time is never removed [s]."""


def source_hash() -> str:
    """Return a digest of every source file of our packages, subfolders included.

    Note:
        numba's on-disk cache does not notice a change in a function imported from another file,
        so the folder of the cache carries this digest in its name.
    """
    digest = hashlib.sha256()
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        for folder in (spec.submodule_search_locations or ()) if spec else ():
            for file in sorted(Path(folder).rglob("*.py")):
                name = file.relative_to(folder).as_posix()
                digest.update(name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Make the folder of the compiled code, and give it.

    It lies in the user's cache, never in the package folder; where that cannot be written, in a
    temporary folder, which one line on stderr says.
    """
    version = source_hash()
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        return use(Path(base) / "ampc_ros", version)
    except (OSError, RuntimeError) as error:
        folder = use(private_temporary_folder(), version)
        print(f"warning: compiled code is kept in {folder}: {error}", file=sys.stderr, flush=True)
        return folder


def use(base: Path, version: str) -> Path:
    """Make the folder of one version, note that it is in use, and remove old ones.

    Raises:
        OSError: Nothing can be written there.
    """
    folder = base / version
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        os.utime(folder)
    if is_new:
        remove_old_versions(base)
    return folder


def remove_old_versions(base: Path) -> None:
    """Keep the versions used last, and whatever was used within a day."""
    used: list[tuple[float, Path]] = []
    for folder in base.iterdir():
        with suppress(OSError):  # another process removes them too
            used.append((folder.stat().st_mtime, folder))
    for last_use, folder in sorted(used, reverse=True)[KEPT:]:
        if time.time() - last_use > IN_USE:
            shutil.rmtree(folder, ignore_errors=True)


def private_temporary_folder() -> Path:
    """Give a temporary folder that is the same for all processes of a user, and no one else's.

    Machine code is loaded from it: one that another user could write is not taken.
    """
    folder = Path(tempfile.gettempdir()) / f"ampc_ros-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    owned = folder.lstat()
    if stat.S_ISDIR(owned.st_mode) and owned.st_uid == os.getuid() and not owned.st_mode & 0o022:
        return folder
    return Path(tempfile.mkdtemp(prefix="ampc_ros-"))


if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = str(cache_folder())  # type: ignore[attr-defined]


def compiled(function: F) -> F:
    """Compile a numeric function at its first call, and keep the machine code on disk."""
    return cast(F, numba.njit(cache=True, error_model="numpy", nogil=True)(function))


def in_place(function: F) -> F:
    """Compile a numeric function that works in the arrays it is given, and allocates nothing.

    Compiled without numba's memory management, so a function that makes an array is refused at
    its first call. It may give arrays inside of tuples to functions of its kind, never to Python.
    """
    return cast(F, numba.njit(cache=True, **IN_PLACE)(function))


def inlined(function: F) -> F:
    """As `in_place`, written into the body of each caller before that is compiled.

    For functions that take a dozen arrays or give one, for loops that are to become SIMD code,
    which must not call, and for the links of a chain, so that each is not optimised anew.
    """
    return cast(F, numba.njit(inline="always", **IN_PLACE)(function))


class Announcer(event.Listener):
    """Says that something has to be compiled as soon as it is known."""

    def __init__(self, what: str, say: Callable[[str], object]) -> None:
        """Say nothing yet."""
        self.what, self.say = what, say
        self.begin: float | None = None

    def on_start(self, _: Any) -> None:
        """Say it once."""
        if self.begin is None:
            self.begin = time.monotonic()
            self.say(f"compiling the {self.what} (once after an update, about 20 s) ...")

    def on_end(self, _: Any) -> None:
        """Wait for the rest."""


@contextmanager
def announced(what: str, say: Callable[[str], object]) -> Iterator[None]:
    """Say that something is being compiled, and how long it took; nothing where nothing has to be.

    Args:
        what: Is compiled, for the user.
        say: Takes the lines.
    """
    announcer = Announcer(what, say)
    with event.install_listener("numba:compile", announcer):
        yield
    if announcer.begin is not None:
        say(f"compiled the {what} in {time.monotonic() - announcer.begin:.0f} s")
