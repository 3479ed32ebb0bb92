"""Decorators for compiled functions, and the folder of their machine code.

The rules for compiled code, and their reasons, stand in ampc_ros/doc/compiled_code.md.
"""

import hashlib
import importlib.util
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from ampc_msgs_config.checked_cache import store_on_disk

F = TypeVar("F", bound=Callable[..., Any])
COMPILED_PACKAGES = ("ampc_msgs_config", "ampc_ros", "sim_vehicle")
STORED_VERSIONS = 3
"""Number of versions whose machine code is stored, including the current one."""
USED_WITHIN = 24 * 3600.0
"""Machine code that a process has used within this time is never removed [s]."""


def source_hash() -> str:
    """Return a digest of every source file of our packages, subfolders included.

    Note:
        numba's on-disk cache does not notice a change in a function imported from another file,
        so the folder of the cache carries this digest in its name.
    """
    digest = hashlib.sha256()
    for package in COMPILED_PACKAGES:
        spec = importlib.util.find_spec(package)
        for folder in (spec.submodule_search_locations or ()) if spec else ():
            for file in sorted(Path(folder).rglob("*.py")):
                name = file.relative_to(folder).as_posix()
                digest.update(name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Create the folder of the machine code, and return it.

    It lies in the user's cache, never in the package folder. If that is not writable, a temporary
    folder is used and a warning is written to stderr.
    """
    version = source_hash()
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        return open_version(Path(base) / "ampc_ros", version)
    except (OSError, RuntimeError) as error:
        folder = open_version(private_temporary_folder(), version)
        print(f"warning: compiled code is stored in {folder}: {error}", file=sys.stderr, flush=True)
        return folder


def open_version(base: Path, version: str) -> Path:
    """Create the folder of a version, mark it as in use, and remove old versions.

    Raises:
        OSError: The folder is not writable.
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
    """Remove all versions but the ones used last and those used within a day."""
    used = []
    for folder in base.iterdir():
        with suppress(OSError):  # another process may remove it at the same time
            used.append((folder.stat().st_mtime, folder))
    for last_use, folder in sorted(used, reverse=True)[STORED_VERSIONS:]:
        if time.time() - last_use > USED_WITHIN:
            shutil.rmtree(folder, ignore_errors=True)


def private_temporary_folder() -> Path:
    """Return a temporary folder that all processes of this user share, and no other user.

    Machine code is loaded from it, so a folder that another user could write is not used.
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
    """Compile a numeric function at its first call, and store the machine code on disk."""
    result = numba.njit(error_model="numpy", nogil=True)(function)
    store_on_disk(result)
    return cast(F, result)


def compile_without_allocation(function: F, **options: Any) -> F:
    """Compile a function without numba's memory management, so that it cannot create an array.

    Note:
        `_nrt` is a private option of numba: this is the only place that uses it.
    """
    njit: Any = numba.njit  # its type does not know the private option
    return cast(F, njit(error_model="numpy", nogil=True, _nrt=False, **options)(function))


def in_place(function: F) -> F:
    """Compile a numeric function that works in the arrays it is given and allocates nothing.

    A function that creates an array is rejected at its first call. Arrays may be passed inside
    tuples to other functions of this kind, but not returned to Python.
    """
    result = compile_without_allocation(function)
    store_on_disk(result)
    return result


def inlined(function: F) -> F:
    """Compile as `in_place`, but insert the source into the body of each caller.

    Intended for functions with a dozen array arguments or an array as result, for loops that are to
    become SIMD code, and for the links of a call chain, which are then optimised only once.
    """
    return compile_without_allocation(function, inline="always")
