"""Copies of the project in which the tests run against mutants, and the tests of each module."""

import ast
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import count
from pathlib import Path
from tempfile import TemporaryFile
from threading import Lock
from typing import NamedTuple

from tests.left_processes import kill_processes_with
from tests.workshop.proofs.mutants import Mutant

MOST_FILES = 6
"""Test files of a stage."""
MOST_STAGES = 2
"""Stages with compilation."""
COMPILING = 150
"""Additional processor time of tests that have to compile mutated code [s]."""
SPARE = 20
"""Additional processor time of all tests [s]."""
HOURS = 3600
IGNORED = shutil.ignore_patterns(
    "__pycache__", ".*", "node_modules", "build", "install", "log", "runs"
)
RUNNER = """
import resource, sys
import pytest
limit = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
code = int(pytest.main(sys.argv[2:]))
whose = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
print("\\nprocessor time", sum(sum(resource.getrusage(who)[:2]) for who in whose))
sys.exit(code)
"""
"""Runs pytest with a limit of its processor time, which no other process influences."""
OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--hypothesis-seed=0")
RUNNING: set[str] = set()
"""Variables of the environment that identify the processes of the tests that run now."""
numbers = count()


def stop_all() -> None:
    """Kill the tests that run now, with all processes that they have started."""
    for mark in list(RUNNING):
        kill_processes_with(mark)


class Stage(NamedTuple):
    """Test files that run in one process."""

    files: tuple[str, ...]
    compiled: bool


class Project:
    """Sources, their imports, and the tests of each module."""

    def __init__(self, root: Path, packages: Sequence[str], uncompiled: Iterable[str] = ()) -> None:
        """Read nothing yet.

        Args:
            root: Folder of the packages; package `p` lies in `p/p`.
            packages: Names of the packages that are mutated.
            uncompiled: Stems of the test files that are quick without compilation.
        """
        self.root, self.packages, self.uncompiled = root, tuple(packages), frozenset(uncompiled)

    def product_files(self) -> list[str]:
        """Return the mutated modules, by path below the root."""
        files = [file for each in self.packages for file in (self.root / each / each).rglob("*.py")]
        return sorted(file.relative_to(self.root).as_posix() for file in files)

    def digest(self, file: str) -> str:
        """Return a digest of a file."""
        return hashlib.sha256((self.root / file).read_bytes()).hexdigest()[:12]

    @cached_property
    def modules(self) -> dict[str, str]:
        """Path of each Python file below the root, by the name of the module."""
        names = {}
        for folder in (*self.packages, "launch_scripts", "tests"):
            for file in sorted((self.root / folder).rglob("*.py")):
                path = file.relative_to(self.root)
                inner = path.relative_to(folder) if folder in self.packages else path
                parts = [part for part in inner.with_suffix("").parts if part != "__init__"]
                names[".".join(parts)] = path.as_posix()
        return names

    @cached_property
    def imports(self) -> dict[str, set[str]]:
        """Files that each file imports itself."""
        return {file: set(self._imported(file)) for file in self.modules.values()}

    def _imported(self, file: str) -> Iterator[str]:
        """Return the files that a file imports."""
        for node in ast.walk(ast.parse((self.root / file).read_bytes())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names = [f"{node.module}.{alias.name}" for alias in node.names]
                names = [each if each in self.modules else node.module for each in names]
            yield from (self.modules[name] for name in names if name in self.modules)

    def closure(self, file: str, within: str = "") -> set[str]:
        """Return a file and all that it imports, directly or through files in a folder."""
        reached, waiting = {file}, [file]
        while waiting:
            each = waiting.pop()
            if each.startswith(within):
                waiting += self.imports[each] - reached
                reached |= self.imports[each]
        return reached

    @cached_property
    def imports_of_tests(self) -> dict[str, set[str]]:
        """Files that each test file imports itself or through other files of the tests."""
        tests = [
            file
            for file in self.imports
            if Path(file).name.startswith("test_") and not file.startswith("tests/workshop/")
        ]
        return {test: self.closure(test, "tests/") for test in tests}

    def importers(self, file: str) -> set[str]:
        """Return a file and all that import it, directly or not."""
        return {each for each in self.imports if file in self.closure(each)}

    def distances(self, file: str) -> dict[str, int]:
        """Return the test files that reach a module, with the number of imports on the way."""
        reached, ring, distance = {file}, {file}, 0
        result: dict[str, int] = {}
        while ring:
            distance += 1
            for test, used in self.imports_of_tests.items():
                if used & ring:
                    result.setdefault(test, distance)
            ring = {each for each, used in self.imports.items() if used & ring} - reached
            ring = {each for each in ring if not each.startswith("tests/")}
            reached |= ring
        return result

    def stages(self, file: str) -> list[Stage]:
        """Return the tests of a module: uncompiled, then by the number of imports on the way."""
        distances = self.distances(file)

        def order(test: str) -> tuple[bool, int, int, str]:
            name = Path(test).stem != f"test_{Path(file).stem}"
            return name, distances[test], len(self.imports_of_tests[test]), test

        tests = sorted(distances, key=order)
        quick = [test for test in tests if Path(test).stem in self.uncompiled][:MOST_FILES]
        others = [test for test in tests if test not in quick]
        stages = [Stage(tuple(quick), compiled=False)]
        for first in range(0, MOST_STAGES * MOST_FILES, MOST_FILES):
            stages.append(Stage(tuple(others[first : first + MOST_FILES]), compiled=True))
        return [stage for stage in stages if stage.files]


class Tree:
    """A copy of the project's sources, and a cache of its compiled code."""

    def __init__(self, project: Project, folder: Path) -> None:
        """Copy the sources, with their times."""
        self.project, self.folder, self.cache = project, folder, folder.with_suffix(".cache")
        shutil.rmtree(folder, ignore_errors=True)
        names = sorted(each.name for each in project.root.iterdir())
        for name in set(names) - IGNORED(str(project.root), names):
            if (project.root / name).is_dir():
                shutil.copytree(project.root / name, folder / name, ignore=IGNORED)
            else:
                folder.mkdir(parents=True, exist_ok=True)
                shutil.copy2(project.root / name, folder)

    def run(self, stage: Stage, limit: float) -> tuple[int, str]:
        """Run tests; return the exit code and the output. No process that they start is left.

        Raises:
            subprocess.TimeoutExpired: The tests wait far longer than they compute.
        """
        paths = [self.folder, *(self.folder / each for each in self.project.packages)]
        mark = f"AMPC_MUTANT_{os.getpid()}_{next(numbers)}"
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(map(str, paths)),
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(self.cache),
            "NUMBA_DISABLE_JIT": str(int(not stage.compiled)),
            mark: "1",
        }
        command = [sys.executable, "-c", RUNNER, str(round(limit)), *OPTIONS, *stage.files]
        with TemporaryFile("w+", encoding="utf-8", errors="replace") as output:
            RUNNING.add(mark)
            process = subprocess.Popen(
                command,
                cwd=self.folder,
                env=environment,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                code = process.wait(timeout=10 * limit + 300)
            finally:
                kill_processes_with(mark)
                process.wait()
                RUNNING.discard(mark)
            output.seek(0)
            return code, output.read()


class Baseline:
    """The tests without a mutation: their processor time, and their compiled code."""

    def __init__(self, project: Project, folder: Path) -> None:
        """Copy the sources."""
        self.tree = Tree(project, folder)
        self.times: dict[Stage, float] = {}
        self.lock = Lock()
        self.locks: dict[Stage, Lock] = {}

    def time(self, stage: Stage) -> float:
        """Return the processor time of a stage [s].

        Raises:
            RuntimeError: A test fails without a mutation.
        """
        return sum(self._time(Stage((file,), stage.compiled)) for file in stage.files)

    def _time(self, stage: Stage) -> float:
        """Run a test file the first time it is needed; return its processor time [s]."""
        with self.lock:
            lock = self.locks.setdefault(stage, Lock())
        with lock:
            if stage not in self.times:
                code, output = self.tree.run(stage, HOURS)
                if code:
                    raise RuntimeError(
                        f"{stage.files[0]} fails without a mutation:\n{output[-3000:]}"
                    )
                measured = re.search(r"^processor time (.+)$", output, re.MULTILINE)
                assert measured
                self.times[stage] = float(measured[1])
            return self.times[stage]


class Worker:
    """Runs the tests against one mutant after the other, in a copy of the project."""

    def __init__(self, project: Project, folder: Path, number: int, baseline: Baseline) -> None:
        """Copy the sources."""
        self.project, self.baseline = project, baseline
        self.tree = Tree(project, folder / f"tree_{number}")

    def outcome(self, file: str, mutant: Mutant) -> str:
        """Return `detected`, `timeout` or `survived`.

        Raises:
            RuntimeError: A test fails without a mutation.
        """
        place = self.tree.folder / file
        source, times = place.read_bytes(), place.stat()
        try:
            place.write_bytes(mutant.apply(source))
            for stage in self.project.stages(file):
                limit = 3 * self.baseline.time(stage) + SPARE
                if stage.compiled:
                    limit += COMPILING
                    self.take_over_cache(file)
                try:
                    code, _ = self.tree.run(stage, limit)
                except subprocess.TimeoutExpired:
                    return "timeout"
                if code:
                    return "timeout" if code in (-signal.SIGXCPU, -signal.SIGKILL) else "detected"
            return "survived"
        finally:
            place.write_bytes(source)
            os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns))

    def take_over_cache(self, file: str) -> None:
        """Link the compiled code of the baseline, without that of a file and all that import it.

        numba does not notice a change in a function that is imported from another file.
        """
        shutil.rmtree(self.tree.cache, ignore_errors=True)
        stale = {(Path(each).parent, Path(each).stem) for each in self.project.importers(file)}
        for folder in {Path(each).parent for each in self.project.imports}:
            old = self.baseline.tree.cache / cache_name(self.baseline.tree.folder / folder)
            new = self.tree.cache / cache_name(self.tree.folder / folder)
            for code in old.glob("*.nb?"):
                if (folder, code.name.partition(".")[0]) not in stale:
                    new.mkdir(parents=True, exist_ok=True)
                    os.link(code, new / code.name)


def cache_name(folder: Path) -> str:
    """Return the name of the folder in numba's cache for the functions of a source folder."""
    path = os.path.abspath(folder)
    return f"{folder.name}_{hashlib.sha1(path.encode(), usedforsecurity=False).hexdigest()}"
