"""The begin of every program: a missing package gives one line, SIGINT no traceback."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from ampc_msgs_config.signals import AFTER_SIGINT, MISSING_PACKAGE, missing_package
from launch_scripts.bootstrap import QUIET_START
from tests.entry_points import EXECUTABLES

ROOT = Path(__file__).resolve().parents[2]
FOREIGN = ("numpy", "rich", "rclpy", "mcap", "rosbags", "yaml", "numba", "scipy", "msgspec")
"""Of these, every program imports some."""
SITE = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {packages}:
            {action}
sys.meta_path.insert(0, Finder())
"""
"""A module that Python imports before everything else."""
HIDE = "raise ModuleNotFoundError('No module named ' + repr(name), name=name)"
INTERRUPT = "os.kill(os.getpid(), signal.SIGINT)"
COMMANDS = sorted(
    file.stem
    for file in (ROOT / "launch_scripts").glob("*.py")
    if file.stem not in ("__init__", "bootstrap", "setup")
)


ARGUMENTS = {"recover": "bag", "replay": "bag", "report": "bag"}
"""Arguments without which a command ends before it imports anything."""
SOME_EXECUTABLES = ["launch_scripts/compare", "launch_scripts/start"]


def run_without(
    folder: Path, program: Path, *packages: str, action: str = HIDE, option: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run a program in which the import of some packages has another effect."""
    site = SITE.format(packages=packages, action=action)
    (folder / "sitecustomize.py").write_text(site, encoding="utf-8")
    paths = f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    return subprocess.run(
        [sys.executable, str(program), *option.split()],
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
    )


HEAVY = {"numba", "llvmlite", "scipy", "matplotlib", "plotly", "rclpy", "numpy", "rosbags", "mcap"}


@pytest.mark.parametrize("name", [*COMMANDS, "bootstrap"])
@pytest.mark.parametrize(("option", "code"), [("--help", 0), ("--no-such-option", 2)])
def test_help_and_wrong_options_are_answered_without_large_packages(
    name: str, option: str, code: int, tmp_path: Path
) -> None:
    done = run_without(tmp_path, ROOT / "launch_scripts" / f"{name}.py", *HEAVY, option=option)
    assert done.returncode == code, done.stderr
    assert "usage: " in done.stdout + done.stderr
    assert "is missing for" not in done.stderr


def executable(folder: Path, name: str) -> Path:
    """Write an entry point where colcon would install it, and return it."""
    file = folder / "lib" / name
    file.parent.mkdir(parents=True)
    file.write_text(f"from {EXECUTABLES[name]} import main\nraise SystemExit(main())\n")
    return file


def assert_one_line(done: subprocess.CompletedProcess[str], packages: tuple[str, ...]) -> None:
    """Check that the program has named one of the packages, and a remedy, in one line."""
    assert done.returncode == MISSING_PACKAGE, done.stderr
    named = "|".join(packages)
    line = rf"error: the (?:Python|ROS) package '(?:{named})' is missing for \S+: .*make setup.*\n"
    assert re.fullmatch(line, done.stderr)


@pytest.mark.parametrize("name", sorted(EXECUTABLES))
def test_an_executable_without_a_package_ends_in_one_line(name: str, tmp_path: Path) -> None:
    option = ARGUMENTS.get(name.rpartition("/")[2], "")
    done = run_without(tmp_path, executable(tmp_path, name), *FOREIGN, option=option)
    assert_one_line(done, FOREIGN)


NODES = sorted(name for name, module in EXECUTABLES.items() if ".nodes." in module)


@pytest.mark.parametrize("name", NODES)
def test_help_of_a_node_needs_neither_ros_nor_any_other_package(name: str, tmp_path: Path) -> None:
    done = run_without(tmp_path, executable(tmp_path, name), *FOREIGN, option="--help")
    assert (done.returncode, done.stderr) == (0, "")
    package, _, node = name.partition("/")
    assert done.stdout.startswith(f"{node}: ")
    assert f"usage: ros2 run {package} {node} " in done.stdout
    assert re.search(r"^Parameters .*:\n  \w+", done.stdout, re.MULTILINE)


def test_help_of_a_node_works_for_its_module_and_not_for_ros_arguments(tmp_path: Path) -> None:
    module = executable(tmp_path, "ampc_msgs_config/markers")
    ros = run_without(tmp_path, module, *FOREIGN, option="--ros-args -r a:=-h")
    assert_one_line(ros, FOREIGN)
    command = [sys.executable, "-m", "ampc_msgs_config.nodes.marker_node", "-h"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("markers: draw the drive")


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_without_a_package_ends_in_one_line(name: str, tmp_path: Path) -> None:
    file = ROOT / "launch_scripts" / f"{name}.py"
    assert_one_line(run_without(tmp_path, file, *FOREIGN, option=ARGUMENTS.get(name, "")), FOREIGN)


@pytest.mark.parametrize(
    ("name", "package"),
    [
        ("ampc_ros/controller", "numba"),
        ("ampc_ros/gate", "nav_msgs"),
        ("ampc_msgs_config/recorder", "rosbags"),
        ("launch_scripts/report", "plotly"),
        ("sim_vehicle/simulator", "scipy"),
    ],
)
def test_the_line_names_the_one_package_that_is_missing(
    name: str, package: str, tmp_path: Path
) -> None:
    option = ARGUMENTS.get(name.rpartition("/")[2], "")
    done = run_without(tmp_path, executable(tmp_path, name), package, option=option)
    assert_one_line(done, (package,))


@pytest.mark.parametrize("name", ["recover", "start"])
def test_a_command_outside_the_workspace_s_environment_ends_in_one_line(
    name: str, tmp_path: Path
) -> None:
    file = ROOT / "launch_scripts" / f"{name}.py"
    done = run_without(tmp_path, file, "ampc_msgs_config", "launch_scripts")
    assert done.returncode == MISSING_PACKAGE
    assert re.fullmatch(r"error: \S+ does not find .*make setup.*setup\.bash`\n", done.stderr)


@pytest.mark.parametrize("name", ["report", "tune", *SOME_EXECUTABLES])
def test_an_interruption_while_a_command_is_imported_leaves_no_traceback(
    name: str, tmp_path: Path
) -> None:
    file = ROOT / "launch_scripts" / f"{name}.py"
    program = executable(tmp_path, name) if name in EXECUTABLES else file
    done = run_without(tmp_path, program, "numpy", "rich", action=INTERRUPT)
    assert (done.returncode, done.stderr) == (AFTER_SIGINT, "")


def test_an_interruption_inside_a_command_raises_as_ever(tmp_path: Path) -> None:
    program = tmp_path / "command.py"
    program.write_text(
        "import os, signal\n"
        "from ampc_msgs_config.signals import guard_command\n"
        "guard_command()\n"
        "def main():\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    finally:\n"
        "        print('cleaned up', flush=True)\n"
        "main()\n"
    )
    done = run_without(tmp_path, program)
    assert (done.returncode, done.stdout, done.stderr) == (AFTER_SIGINT, "cleaned up\n", "")


@pytest.mark.parametrize(
    ("name", "code", "last"),
    [("ampc_ros/gate", 0, ""), ("sim_vehicle/simulator", 0, ""), ("other/gate", 1, "ended")],
)
def test_an_interruption_before_the_first_import_ends_a_node_silently(
    name: str, code: int, last: str, tmp_path: Path
) -> None:
    (tmp_path / "ampc_quiet_start.py").write_text(QUIET_START, encoding="utf-8")
    (tmp_path / "workspace.pth").write_text("import ampc_quiet_start\n", encoding="utf-8")
    program = tmp_path / "lib" / name
    program.parent.mkdir(parents=True)
    program.write_text(
        f"import site, os, sys\nsite.addsitedir({str(tmp_path)!r})\n"
        "try:\n    os.kill(os.getpid(), 2)\nexcept KeyboardInterrupt:\n    sys.exit('ended')\n"
    )
    done = subprocess.run([sys.executable, str(program)], capture_output=True, text=True)
    assert (done.returncode, done.stderr.strip()) == (code, last)


def test_an_error_of_the_code_keeps_its_traceback(tmp_path: Path) -> None:
    program = tmp_path / "command.py"
    program.write_text(
        "from ampc_msgs_config.signals import guard_command\nguard_command()\n{}['a fault']\n"
    )
    done = run_without(tmp_path, program)
    assert done.returncode == 1
    assert "Traceback" in done.stderr
    assert done.stderr.endswith("KeyError: 'a fault'\n")


@pytest.mark.parametrize(
    ("module", "kind", "remedy"),
    [
        ("rclpy.node", "the ROS package 'rclpy'", "source /opt/ros/jazzy/setup.bash"),
        ("ackermann_msgs.msg", "the ROS package 'ackermann_msgs'", "/opt/ros/jazzy"),
        ("lz4.frame", "the Python package 'lz4'", "pip install -r lock/requirements.txt"),
        ("ampc_ros.mpc", "does not find 'ampc_ros.mpc' of this workspace", "source setup.bash"),
    ],
)
def test_the_remedy_depends_on_the_kind_of_package(module: str, kind: str, remedy: str) -> None:
    sentence = missing_package(module)
    assert kind in sentence
    assert remedy in sentence
    assert "\n" not in sentence
