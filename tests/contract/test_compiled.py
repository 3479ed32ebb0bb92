"""Folder of the machine code, removal of old versions, log lines, private interfaces of numba."""

import gc
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError

from ampc_msgs_config.compilation import (
    RARE_COLLECTION,
    Estimate,
    compile_times,
    log_compilation,
    on_compilation,
)
from ampc_msgs_config.compiled import (
    COMPILED_PACKAGES,
    STORED_VERSIONS,
    USED_WITHIN,
    cache_folder,
    compile_without_allocation,
    compiled,
    open_version,
    private_temporary_folder,
    source_hash,
)
from tests.workshop.proofs.compile_times import COMPILATIONS

ROOT = Path(__file__).resolve().parents[2]
BAD_HOMES = ["/proc/nobody", "/dev/null"]
"""Paths in which no folder can be created, not even by root."""

SMALL = (
    "from ampc_ros.preview.model import understeer_gradient\n"
    "understeer_gradient((1500.0, 2500.0, 1.2, 1.6, 5e4, 5e4))"
)
"""Compiles one function."""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Replace the temporary folder of the machine, and return it."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def test_compiled_code_lies_in_the_users_cache_by_version_of_the_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "ampc_ros" / source_hash()
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "new"))
    assert cache_folder() == tmp_path / "new" / ".cache" / "ampc_ros" / source_hash()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("name", ["__init__.py", "inner/__init__.py", "inner/deeper/module.py"])
def test_the_source_hash_changes_with_a_file_in_any_subfolder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    package = tmp_path / "a_package_of_this_test"
    file = package / name
    file.parent.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("ampc_msgs_config.compiled.COMPILED_PACKAGES", (package.name,))
    file.write_text("ONE = 1\n")
    before = source_hash()
    assert source_hash() == before
    file.write_text("ONE = 2\n")
    assert source_hash() != before
    file.write_text("ONE = 1\n")
    file.rename(file.with_name("renamed.py"))
    assert source_hash() != before


@pytest.mark.parametrize("home", BAD_HOMES)
@pytest.mark.parametrize("variable", ["HOME", "XDG_CACHE_HOME"])
def test_a_temporary_folder_replaces_an_unwritable_cache_with_one_warning(
    home: str,
    variable: str,
    temporary: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv(variable, home)
    folder = cache_folder()
    assert folder.parent.parent == temporary
    assert cache_folder() == folder
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith(f"warning: compiled code is stored in {folder}: ")
    assert home in lines[0]


def test_a_process_without_a_home_compiles_into_the_temporary_folder(tmp_path: Path) -> None:
    environment = os.environ | {"XDG_CACHE_HOME": "/proc/nobody", "TMPDIR": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    environment.pop("NUMBA_DISABLE_JIT", None)
    ran = subprocess.run(
        [sys.executable, "-c", SMALL], env=environment, capture_output=True, text=True, check=True
    )
    assert ran.stderr.count("\n") == 1
    assert list(tmp_path.rglob("*.nbi"))


COUNT = """
import sys
from ampc_msgs_config.compilation import on_compilation
from ampc_ros.preview.model import understeer_gradient
calls = []
with on_compilation(lambda: calls.append(1)):
    understeer_gradient((1500.0, 2500.0, 1.2, 1.6, 5e4, 5e4))
print(len(calls), sys.modules["ampc_ros"].__file__)
"""
"""Prints how many functions are compiled, and from where the package is imported."""


def test_an_installed_copy_of_the_packages_uses_the_code_of_the_source_tree(tmp_path: Path) -> None:
    site = tmp_path / "install"
    for package in COMPILED_PACKAGES:
        copy = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package / package, site / package, ignore=copy)
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    for name in ("NUMBA_CACHE_DIR", "NUMBA_DISABLE_JIT"):
        environment.pop(name, None)
    installed = f"{site}{os.pathsep}{environment.get('PYTHONPATH', '')}"
    lines = [
        subprocess.run(
            [sys.executable, "-c", COUNT], env=each, capture_output=True, text=True, check=True
        ).stdout
        for each in (environment, environment | {"PYTHONPATH": installed})
    ]
    (first, source), (second, copied) = (line.split() for line in lines)
    assert int(first) > 0
    assert int(second) == 0
    assert Path(source).is_relative_to(ROOT)
    assert Path(copied).is_relative_to(site)


def test_a_temporary_folder_that_others_can_write_is_not_used(temporary: Path) -> None:
    private = private_temporary_folder()
    assert private.stat().st_mode & 0o077 == 0
    private.chmod(0o777)
    other = private_temporary_folder()
    assert other != private
    assert other.stat().st_mode & 0o077 == 0


def test_a_link_in_place_of_the_temporary_folder_is_not_followed(temporary: Path) -> None:
    (temporary / "elsewhere").mkdir()
    (temporary / f"ampc_ros-{os.getuid()}").symlink_to(temporary / "elsewhere")
    assert private_temporary_folder().name != f"ampc_ros-{os.getuid()}"


def version_folder(base: Path, name: str, age: float) -> Path:
    """Create the folder of a version that was used some time ago [s]."""
    folder = base / name
    folder.mkdir()
    (folder / "code.nbc").write_bytes(b"code")
    os.utime(folder, (time.time() - age,) * 2)
    return folder


def test_a_new_version_removes_old_ones_but_the_newest_and_those_in_use(tmp_path: Path) -> None:
    old = [version_folder(tmp_path, f"old{i}", USED_WITHIN * (2 + i)) for i in range(4)]
    in_use = [
        version_folder(tmp_path, f"used{i}", USED_WITHIN * 0.9) for i in range(STORED_VERSIONS)
    ]
    new = open_version(tmp_path, "new")
    assert set(tmp_path.iterdir()) == {new, *in_use}
    assert not any(folder.exists() for folder in old)


def test_the_newest_old_versions_stay(tmp_path: Path) -> None:
    old = [version_folder(tmp_path, f"old{i}", USED_WITHIN * (2 + i)) for i in range(4)]
    new = open_version(tmp_path, "new")
    assert set(tmp_path.iterdir()) == {new, *old[: STORED_VERSIONS - 1]}


def test_using_a_version_again_removes_nothing_and_marks_it_as_in_use(tmp_path: Path) -> None:
    old = [version_folder(tmp_path, f"old{i}", USED_WITHIN * (2 + i)) for i in range(5)]
    open_version(tmp_path, "old4")
    assert set(tmp_path.iterdir()) == set(old)
    assert time.time() - old[4].stat().st_mtime < 60.0
    open_version(tmp_path, "new")
    assert old[4].exists()


needs_compilation = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT),  # type: ignore[attr-defined]
    reason="compilation is switched off",
)


def zeros(n: int) -> float:
    """Create an array."""
    return float(np.zeros(n).sum())


@needs_compilation
def test_private_option_nrt_of_numba_rejects_a_function_that_allocates() -> None:
    with pytest.raises(NumbaError):
        compile_without_allocation(zeros)(3)
    assert compile_without_allocation(lambda x: 2.0 * x)(1.5) == 3.0
    assert compiled(zeros)(3) == 0.0


@needs_compilation
def test_private_module_event_of_numba_reports_each_compilation() -> None:
    calls: list[int] = []

    def twice(x: float) -> float:
        return 2.0 * x

    double = compile_without_allocation(twice)  # never loaded from the disk
    with on_compilation(lambda: calls.append(1)):
        double(1.0)
        first = len(calls)
        double(2.0)
    double(1)
    assert len(calls) == first > 0


@needs_compilation
@pytest.mark.parametrize("body", [lambda x: 2.0 * x, lambda x: "text" * x])
def test_garbage_is_collected_rarely_while_a_function_is_compiled(body: Callable[..., Any]) -> None:
    usual, seen = gc.get_threshold(), [gc.get_threshold()]
    with on_compilation(lambda: seen.append(gc.get_threshold())), suppress(NumbaError):
        compile_without_allocation(body)(1.0)  # the second one cannot be compiled
    assert seen[1:]
    assert set(seen[1:]) == {RARE_COLLECTION}
    assert gc.get_threshold() == usual != RARE_COLLECTION


@needs_compilation
def test_compilation_is_logged_once_at_its_start_and_once_at_its_end() -> None:
    lines: list[str] = []

    @compiled
    def inner(x: float) -> float:
        return x + 1.0

    @compiled
    def outer(x: float) -> float:
        return inner(x) * 2.0

    with log_compilation("controller", lines.append):
        assert lines == []
        outer(1.0)
        assert len(lines) == 1
        assert re.match("compiling the controller .*", lines[0])
        outer(1)
    assert len(lines) == 2
    assert re.match(r"compiled the controller in \d+ s", lines[1])
    with log_compilation("controller", lines.append):
        outer(1.0)
    assert len(lines) == 2


@needs_compilation
def test_the_end_of_a_compilation_names_the_function_and_its_own_time() -> None:
    ended: list[tuple[str, float]] = []

    @compile_without_allocation  # never loaded from the disk
    def inner_function(x: float) -> float:
        return x + 1.0

    @compile_without_allocation  # never loaded from the disk
    def outer_function(x: float) -> float:
        return inner_function(x) * 2.0

    begin = time.thread_time()
    with on_compilation(lambda: None, lambda name, own: ended.append((name, own))):
        outer_function(1.0)
    duration = time.thread_time() - begin
    assert [name.rpartition(".")[2] for name, _ in ended] == ["inner_function", "outer_function"]
    assert all(name.startswith(f"{__name__}.") for name, _ in ended)
    assert 0.0 < sum(own for _, own in ended) <= duration


def test_the_remaining_time_follows_from_the_speed_of_this_machine() -> None:
    estimate = Estimate({"quick": 1.0, "slow": 3.0, "last": 4.0})
    assert estimate.text(1.0) == ""
    estimate.take("unknown")
    assert estimate.text(1.0) == ""
    estimate.take("quick")
    assert estimate.text(5.0) == "12%, about 35 s left"
    estimate.take("quick")
    estimate.take("slow")
    assert estimate.text(20.0) == "50%, about 20 s left"
    estimate.take("last")
    assert estimate.text(40.0) == "100%, about 0 s left"


@needs_compilation
@pytest.mark.parametrize(
    ("times", "first", "second"),
    [
        ({"a": 30.0, "b": 30.0}, ", about 60 s) ...", r"compiling the car: 50%, about \d+ s left"),
        ({}, "(once after an update) ...", r"compiling the car: \d+ s"),
    ],
)
def test_progress_is_logged_without_a_terminal(
    times: dict[str, float], first: str, second: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    @compile_without_allocation  # never loaded from the disk
    def double(x: float) -> float:
        return 2.0 * x

    name = f"{__name__}.{double.__qualname__}"
    known = {{"a": name}.get(key, key): value for key, value in times.items()}
    monkeypatch.setattr("ampc_msgs_config.compilation.compile_times", lambda _: known)
    monkeypatch.setattr("ampc_msgs_config.compilation.INTERVAL_OF_LINES", 0.0)
    lines: list[str] = []
    with log_compilation("car", lines.append):
        double(1.0)
    assert len(lines) == 3
    assert lines[0].endswith(first)
    assert re.fullmatch(second, lines[1])
    assert lines[2].startswith("compiled the car in ")


@needs_compilation
def test_progress_counts_what_another_process_has_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    stored: set[str] = set()
    monkeypatch.setattr("ampc_msgs_config.compilation.compile_times", lambda _: {"a": 1.0, "b": 3})
    monkeypatch.setattr("ampc_msgs_config.compilation.INTERVAL_OF_LINES", 0.0)
    monkeypatch.setattr("ampc_msgs_config.compilation.is_stored", stored.__contains__)
    lines: list[str] = []

    def log(line: str) -> None:
        lines.append(line)
        stored.add("b")

    with log_compilation("car", log):
        compile_without_allocation(lambda x: 2.0 * x)(1.0)
    assert lines[1].startswith("compiling the car: 75%")


def test_times_of_every_compilation_are_shipped() -> None:
    for what in COMPILATIONS:
        times = compile_times(what)
        assert times
        assert all(seconds > 0.0 for seconds in times.values())
    assert compile_times("something else") == {}
    sources = [*ROOT.glob("*/*/**/*.py"), *ROOT.glob("launch_scripts/**/*.py")]
    words = set(re.findall(r"def (\w+)", "\n".join(each.read_text("utf-8") for each in sources)))
    names = {name.rpartition(".")[2] for what in COMPILATIONS for name in compile_times(what)}
    assert len(names - words) < 0.1 * len(names), "python -m tests.workshop.proofs.compile_times"
