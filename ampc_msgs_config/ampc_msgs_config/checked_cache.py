"""Cache of machine code in which damaged files are found, removed and compiled anew.

numba loads what its files contain: a truncated one ends in an exception, changed bytes may run as
machine code. Here each file ends with a digest of its content. The name of a file with machine code
follows from its key, and one process at a time changes an index, so that processes which compile
the same functions at the same time never exchange their code. The folder follows from the name and
the content of a module, not from its path: the source tree and what colcon installs from it share
their code.

Note:
    `numba.core.caching` is a private interface of numba: this is the only place that uses it.
"""

import fcntl
import hashlib
import importlib.util
import io
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

from numba.core import caching, config

DIGEST = 32
"""Length of the digest at the end of a file [bytes]."""
BASE: Any = caching.IndexDataCacheFile
LOCATOR: Any = caching.UserProvidedCacheLocator
IMPLEMENTATION: Any = caching.CompileResultCacheImpl


class CheckedCacheFile(BASE):  # type: ignore[misc]
    """Index (.nbi) and machine code (.nbc) of one function, each with a digest."""

    def load(self, key: Any) -> Any:
        """Return the stored code of a key, or None if there is none that is undamaged."""
        name = self._load_index().get(key)
        if name is None or not is_intact(Path(self._data_path(name))):
            return None
        try:
            return self._load_data(name)
        except Exception:  # unpickling runs code of many kinds
            remove(Path(self._data_path(name)))
            return None

    def save(self, key: Any, data: Any) -> None:
        """Store code.

        Raises:
            OSError: The folder cannot be written.
        """
        digest = hashlib.sha256(repr(key).encode()).hexdigest()
        name = self._data_name(int(digest[:12], 16))
        with self.locked():
            self._save_data(name, data)  # before the index, which never names a missing file
            self._save_index({**self._load_index(), key: name})

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Wait until no other process changes this folder."""
        with (Path(self._cache_path) / "lock").open("ab") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def _load_index(self) -> dict[Any, str]:
        """Return the name of the file of each key; none if the index is missing or damaged."""
        path = Path(self._index_path)
        if not is_intact(path):
            return {}
        try:
            return dict(super()._load_index())
        except Exception:  # unpickling runs code of many kinds
            remove(path)
            return {}

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[IO[bytes]]:
        """Open a file that is replaced when its content and digest are complete."""
        content = io.BytesIO()
        yield content
        data, path = content.getvalue(), Path(filepath)
        if path.is_dir():
            remove(path)
        with super()._open_for_write(filepath) as file:
            file.write(data + hashlib.sha256(data).digest())


class ContentLocator(LOCATOR):  # type: ignore[misc]
    """Folder of a module's code below the folder of all code, by name and content of the module."""

    def __init__(self, function: Any, file: str) -> None:
        """Derive the folder from a function and the file that defines it."""
        super().__init__(function, file)
        self._cache_path = str(folder_of(function.__module__, file))


class ContentImplementation(IMPLEMENTATION):  # type: ignore[misc]
    """The part of a cache that selects its folder."""

    _locator_classes = (ContentLocator, *IMPLEMENTATION._locator_classes)


class CheckedCache(caching.FunctionCache):
    """Cache of one function; where nothing can be stored, the function is only compiled."""

    _impl_class = ContentImplementation

    def __init__(self, function: Any) -> None:
        """Use checked files."""
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._cache_file.__class__ = CheckedCacheFile

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store compiled code, if the folder can be written."""
        with suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def is_intact(path: Path) -> bool:
    """Return whether a file exists and agrees with its digest; remove one that does not."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return False
    except OSError as error:
        remove(path, error.strerror or "")
        return False
    if hashlib.sha256(content[:-DIGEST]).digest() == content[-DIGEST:]:
        return True
    remove(path, "contradicts its digest")
    return False


def remove(path: Path, fault: str = "cannot be loaded") -> None:
    """Remove a damaged file, and write one warning to stderr."""
    print(f"warning: compiled code in {path}: {fault}: compiled again", file=sys.stderr, flush=True)
    with suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def folder_of(module: str, file: str) -> Path:
    """Return the folder of the code of a module that is defined in a file."""
    folder = f"{module}-{digest_of_source(file)[:16]}"
    return Path(config.CACHE_DIR) / folder  # type: ignore[attr-defined]


def is_stored(function: str) -> bool:
    """Return whether there is code of a function, as named in `compile_times.json`."""
    module, _, name = function.rpartition(".")
    spec = None
    with suppress(ImportError, ValueError):
        spec = importlib.util.find_spec(module)
    return bool(
        spec and spec.origin and any(folder_of(module, spec.origin).glob(f"*.{name}-*.nbi"))
    )


@cache
def digest_of_source(file: str) -> str:
    """Return a digest of the content of a source file."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def store_on_disk(function: Any) -> None:
    """Make a compiled function store its code; nothing where compilation is switched off."""
    if hasattr(function, "_cache"):
        function._cache = CheckedCache(function.py_func)
