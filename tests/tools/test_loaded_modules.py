"""Modules that the commands load: few, and no drawing library before the nodes start."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.workshop.bench.bench_report_page import make_bag

LIST = """
import json, sys
def loaded(packages):
    named = ((name, getattr(m, "__file__", None)) for name, m in list(sys.modules.items()))
    return [name for name, file in named if name.partition(".")[0] in packages
            and (len(packages) == 2 or file and not file.endswith("__init__.py"))]
PROJECT = ("ampc_msgs_config", "ampc_ros", "sim_vehicle", "launch_scripts")
"""
REPORT = """
from launch_scripts import report
before = loaded(PROJECT)
assert report.main([sys.argv[1], "--output", sys.argv[2]]) == 0
"""
START = """
from pathlib import Path
from rich.console import Console
from launch_scripts import start
before = loaded(PROJECT)
assert not loaded(("matplotlib", "plotly"))
from launch_scripts.nodes import drive_watch
options = start.read_run_options(["--output", sys.argv[2] + "/run"], None)
run = start.prepare_run(options)
Path(sys.argv[1]).rename(run.bag)
assert start.finish(run, start.RunEnded("completed", 0), Console()) == 0
"""


@pytest.mark.parametrize(
    ("code", "scripts", "modules"),
    [
        pytest.param(
            *(REPORT, 13, 31),
            marks=pytest.mark.xfail(
                raises=AssertionError, strict=True, reason="14 and 34: bags are read as tables"
            ),
        ),
        (START, 30, 60),
    ],
    ids=["report", "start"],
)
def test_a_command_loads_few_modules_of_the_project(
    code: str, scripts: int, modules: int, tmp_path: Path
) -> None:
    bag = make_bag(tmp_path / "bag", minutes=0.1)
    end = "\nprint(json.dumps([before, loaded(PROJECT), loaded(('matplotlib', 'none'))]))"
    command = [sys.executable, "-c", LIST + code + end, str(bag), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    before, after, matplotlib = json.loads(done.stdout.splitlines()[-1])
    if matplotlib or not set(before) <= set(after):
        pytest.fail(f"loaded: {matplotlib}")
    assert len([name for name in after if name.startswith("launch_scripts.")]) <= scripts
    assert len(after) <= modules
