"""Coverage of the guard by its tests."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXACT = "not whatever and not mirrored and not remembers"
"""The tests without random search must cover every line and branch."""
TESTS = "tests/control/test_guard.py"


def test_every_line_and_branch_of_the_guard_is_tested(tmp_path: Path) -> None:
    environment = os.environ | {"COVERAGE_FILE": str(tmp_path / "coverage")}
    measured = ["run", "--branch", "--include=*/supervision/guard.py"]
    tests = [
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "tests/control/test_guard.py",
        "-k",
        EXACT,
    ]
    report = ["report", "--fail-under=100", "--show-missing"]
    for arguments in (measured + tests, report):
        command = [sys.executable, "-m", "coverage", *arguments]
        ran = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
        )
        assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "guard.py" in ran.stdout
