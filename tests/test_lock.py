"""The locks: they hold what the requirement files ask for, by hash, and name no host."""

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from launch_scripts import audit, bootstrap
from launch_scripts.audit import findings, judge
from launch_scripts.lock import LOCKS, WITH_ROS, lock_of, requirement_files, without_hashes

PIN = re.compile(r"([\w.-]+)(?:\[[\w,]+\])?==([\w.]+)")


def pins(text: str) -> set[tuple[str, str]]:
    """Give the packages of a requirement file, by normalised name and version."""
    found = (PIN.match(line) for line in text.splitlines())
    return {(re.sub(r"[-_.]+", "-", pin[1]).lower(), pin[2]) for pin in found if pin}


@pytest.mark.parametrize("file", requirement_files(), ids=lambda file: file.name)
def test_every_requirement_is_locked_and_make_lock_was_not_forgotten(file: Path) -> None:
    wanted, locked = pins(file.read_text()), pins(lock_of(file).read_text())
    assert wanted
    assert wanted <= locked


def test_there_is_no_lock_without_requirements() -> None:
    assert sorted(LOCKS.iterdir()) == [lock_of(file) for file in requirement_files()]


@pytest.mark.parametrize("lock", sorted(LOCKS.glob("*.txt")), ids=lambda file: file.name)
def test_every_package_has_a_hash_and_no_line_names_a_host(lock: Path) -> None:
    text = lock.read_text()
    assert not re.search(r"//|--(extra-)?index-url|--find-links|@", text)
    blocks = re.split(r"\n(?=\S)", text)[1:]
    assert blocks
    for block in blocks:
        assert PIN.match(block)
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", block)


def test_only_the_ros_wheels_bring_a_numpy() -> None:
    with_numpy = [
        lock.name for lock in LOCKS.glob("*.txt") if f"\n{WITH_ROS}==" in lock.read_text()
    ]
    assert with_numpy == ["requirements-ros.txt"]


def test_no_package_is_locked_in_two_versions_for_the_same_python() -> None:
    versions: dict[str, set[str]] = {}
    always = set()
    for lock in LOCKS.glob("*.txt"):
        for line in without_hashes(lock.read_text()).splitlines():
            if pin := PIN.match(line):
                versions.setdefault(pin[1], set()).add(pin[2])
                always |= set() if ";" in line else {pin[1]}
    assert not {name for name in always if len(versions[name]) > 1}


@pytest.mark.parametrize("with_ros", [True, False])
def test_bootstrap_installs_locks_only(with_ros: bool) -> None:
    files = bootstrap.requirement_files(with_ros=with_ros, dev=True, bench=True)
    assert all(file.parent == LOCKS and file.is_file() for file in files)
    assert (LOCKS / "requirements-ros.txt" in files) != with_ros


FINE: dict[str, Any] = {"name": "rich", "version": "1.0", "vulns": []}
WEAK: dict[str, Any] = {
    "name": "toolz",
    "version": "2.0",
    "vulns": [{"id": "X-1", "fix_versions": ["2.1"]}],
}
UNKNOWN: dict[str, Any] = {"name": "ros-rcl", "skip_reason": "not found"}


def test_audit_names_what_is_vulnerable_and_what_mends_it() -> None:
    words, code = judge(findings([FINE, WEAK, UNKNOWN, FINE]))
    assert code == audit.VULNERABLE
    assert words.splitlines() == [
        "toolz 2.0: X-1, mended in 2.1",
        "audit: 2 packages, 1 vulnerabilities; not in the database: 1",
    ]
    assert judge(findings([FINE]))[1] == 0


@pytest.mark.parametrize(
    ("stdout", "stderr", "words"),
    [
        (json.dumps({"dependencies": [UNKNOWN]}), "", "nothing is audited"),
        ("", "Traceback\nConnectionError: no route", "cannot be asked: ConnectionError: no route"),
        ("", "", "cannot be asked: without a word"),
    ],
)
def test_audit_says_in_one_line_where_nothing_could_be_asked(
    stdout: str,
    stderr: str,
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    done = subprocess.CompletedProcess([], 1, stdout, stderr)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    assert audit.main() == audit.NOT_ASKED
    said = capsys.readouterr().out
    assert words in said
    assert said.count("\n") == 1
