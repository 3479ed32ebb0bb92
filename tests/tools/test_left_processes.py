"""Processes that outlive their test are found, wherever they run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.left_processes import kill_processes_with, parent_of, processes_with

SLEEP = [sys.executable, "-c", "import time; time.sleep(600.0)"]
STARTER = f"import subprocess; print(subprocess.Popen({SLEEP}, start_new_session=True).pid)"


def test_a_process_without_parent_in_a_session_of_its_own_is_found_and_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    variable = f"AMPC_TEST_OF_LEFT_PROCESSES_{os.getpid()}"
    monkeypatch.setenv(variable, "1")
    output = tmp_path / "number"
    with output.open("w") as stream:
        subprocess.run([sys.executable, "-c", STARTER], stdout=stream, check=True)
    number = int(output.read_text())
    assert processes_with(variable) == {number: " ".join(SLEEP)}
    assert parent_of(number) != os.getpid()
    kill_processes_with(variable)
    assert not processes_with(variable)
