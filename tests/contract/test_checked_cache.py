"""Cache of machine code: damaged files are removed and compiled anew, also by two processes."""

import hashlib
import importlib.util
import os
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

import ampc_msgs_config.compiled  # noqa: F401 - selects the folder, which the tests then replace
from ampc_msgs_config.checked_cache import digest_of_source, is_stored

pytestmark = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT),  # type: ignore[attr-defined]
    reason="compilation is switched off",
)

SOURCE = """
from ampc_msgs_config.compiled import compiled

@compiled
def half(x):
    return x / 2 + 1
"""
CALL = """
import sys
sys.path.insert(0, sys.argv[1])
from halving import half
assert half(eval(sys.argv[2])) == 3
print(sum(half.stats.cache_hits.values()))
"""


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a module with a compiled function, whose code is stored in a folder of the test."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    file = tmp_path / "halving.py"
    file.write_text(SOURCE)
    return file


def load(file: Path) -> Any:
    """Import the module anew and return its function, as another process would."""
    spec = importlib.util.spec_from_file_location("halving", file)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.half


def is_loaded(function: Any) -> bool:
    """Return whether the code of a function came from the disk."""
    return any(function.stats.cache_hits.values())


def test_a_function_counts_as_stored_until_its_file_changes(
    source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(source.parent)
    assert not is_stored("halving.half")
    load(source)(4.0)
    assert is_stored("halving.half")
    assert not is_stored("halving.hal")
    assert not is_stored("no_such_module.half")
    assert not is_stored("halving.outer.<locals>.half")
    source.write_text(SOURCE + "# changed")
    digest_of_source.cache_clear()
    assert not is_stored("halving.half")


def rewrite(change: Callable[[bytes], bytes]) -> Callable[[Path], object]:
    """Return a function that changes the content of a file."""
    return lambda file: file.write_bytes(change(file.read_bytes()))


def replace_by_folder(file: Path) -> None:
    """Replace a file by a folder that is not empty."""
    file.unlink()
    file.mkdir()
    (file / "inside").touch()


def replace_by_link(file: Path) -> None:
    """Replace a file by a link to nothing."""
    file.unlink()
    file.symlink_to("nowhere")


def flip(content: bytes) -> bytes:
    """Flip one bit in the middle."""
    changed = bytearray(content)
    changed[len(content) // 2] ^= 16
    return bytes(changed)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "empty": rewrite(lambda content: b""),
    "one byte": rewrite(lambda content: content[:1]),
    "half": rewrite(lambda content: content[: len(content) // 2]),
    "without its last byte": rewrite(lambda content: content[:-1]),
    "zeros": rewrite(lambda content: bytes(len(content))),
    "zeros at the end": rewrite(lambda content: content[:-1000] + bytes(1000)),
    "one bit": rewrite(flip),
    "noise": rewrite(lambda content: random.Random(1).randbytes(5000)),
    "right digest": rewrite(lambda content: b"no pickle" + hashlib.sha256(b"no pickle").digest()),
    "folder": replace_by_folder,
    "link to nothing": replace_by_link,
}


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_removed_and_compiled_again(
    source: Path, damage: str, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert load(source)(4.0) == 3.0
    again = load(source)
    assert again(4.0) == 3.0
    assert is_loaded(again)
    assert capsys.readouterr().err == ""
    (file,) = source.parent.rglob(f"*.{suffix}")
    DAMAGES[damage](file)
    repaired = load(source)
    assert repaired(4.0) == 3.0
    assert not is_loaded(repaired)
    assert str(file) in capsys.readouterr().err or damage == "link to nothing"
    last = load(source)
    assert last(4.0) == 3.0
    assert is_loaded(last)
    assert capsys.readouterr().err == ""


def copied(file: Path, folder: str, text: str = SOURCE) -> Path:
    """Write the module into another folder, as an installation does."""
    copy = file.parent / folder / file.name
    copy.parent.mkdir()
    copy.write_text(text)
    return copy


def test_a_copy_of_a_module_in_another_folder_uses_the_same_code(source: Path) -> None:
    assert load(source)(4.0) == 3.0
    installed = load(copied(source, "install"))
    assert installed(4.0) == 3.0
    assert is_loaded(installed)
    assert len(list(source.parent.rglob("*.nbc"))) == 1


def test_modules_of_one_name_with_different_content_never_share_code(source: Path) -> None:
    other = copied(source, "other", SOURCE.replace("+ 1", "+ 2"))
    for _ in range(2):
        assert load(source)(4.0) == 3.0
        assert load(other)(4.0) == 4.0
    assert is_loaded(load(source)) is False  # not called yet
    again = load(other)
    assert again(4.0) == 4.0
    assert is_loaded(again)


def test_a_file_without_permission_is_removed_and_compiled_again(
    source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert load(source)(4.0) == 3.0
    (file,) = source.parent.rglob("*.nbi")
    read_bytes = Path.read_bytes

    def refuse(path: Path) -> bytes:  # root may read everything
        if path == file:
            raise PermissionError(13, "Permission denied")
        return read_bytes(path)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", refuse)
        assert load(source)(4.0) == 3.0
    again = load(source)
    assert again(4.0) == 3.0


def test_a_function_is_compiled_where_nothing_can_be_stored(
    source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    function = load(source)

    def refuse(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", refuse)
    assert function(4.0) == 3.0


def test_processes_on_a_cold_cache_compile_the_same_function_for_different_types(
    tmp_path: Path,
) -> None:
    (tmp_path / "halving.py").write_text(SOURCE)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", CALL, str(tmp_path)]
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    for expected, arguments in ((None, ["4.0", "4", "4.0"]), ("1\n", ["4.0", "4"])):
        running = [
            subprocess.Popen([*command, argument], env=environment, **pipes)
            for argument in arguments
        ]
        for process in running:
            said, complaints = process.communicate(timeout=120)
            assert (process.returncode, complaints) == (0, "")
            assert expected in (None, said)
    assert len(list(tmp_path.rglob("*.nbc"))) == 2
