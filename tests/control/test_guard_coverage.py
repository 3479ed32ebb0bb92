"""The tests of the guard execute every line and branch of it."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXACT = "not whatever and not mirrored and not remembers"
"""Tests without random search: these alone must reach every branch."""


def test_every_line_and_branch_of_the_guard_is_tested(tmp_path: Path) -> None:
    environment = os.environ | {"COVERAGE_FILE": str(tmp_path / "coverage")}
    measured = ["run", "--branch", "--include=*/ampc_ros/supervision/guard.py"]
    tests = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/control/test_guard.py"]
    report = ["report", "--fail-under=100", "--show-missing"]
    for arguments in ([*measured, *tests, "-k", EXACT], report):
        command = [sys.executable, "-m", "coverage", *arguments]
        ran = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
        )
        assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "guard.py" in ran.stdout
