"""One decorator for every compiled function, and one safe place for the compiled code."""

import hashlib
import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])
IN_PLACE: dict[str, Any] = {"error_model": "numpy", "nogil": True, "_nrt": False}
PACKAGES = ("ampc_msgs_config", "ampc_ros", "sim_vehicle")


def source_hash() -> str:
    """Give a digest of every source file of our packages.

    Note:
        numba's on-disk cache does not notice a change in a function imported from another file,
        so the folder of the cache carries this digest in its name.
    """
    digest = hashlib.sha256()
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        for folder in (spec.submodule_search_locations or ()) if spec else ():
            for file in sorted(Path(folder).glob("*.py")):
                digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Give the folder of the compiled code: in the user's cache, never in the package folder."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "ampc_ros" / source_hash()


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
