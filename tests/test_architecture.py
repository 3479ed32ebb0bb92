"""The style guide's first section: who may import whom."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FORBIDDEN = {
    "ampc_msgs_config": {"ampc_ros", "sim_vehicle", "launch_scripts"},
    "ampc_ros": {"sim_vehicle", "launch_scripts"},
    "sim_vehicle": {"ampc_ros", "launch_scripts"},
}
MODULES = [file for package in FORBIDDEN for file in (ROOT / package / package).rglob("*.py")]
WITH_ROS = {"ros.py", "recording.py", "bag.py", "message_types.py"}


def imported(file: Path) -> set[str]:
    """Top-level names of the packages that a module imports, wherever in the module."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add(node.module or "")
    return {name.split(".")[0] for name in names}


@pytest.mark.parametrize("file", MODULES, ids=lambda file: f"{file.parent.name}.{file.stem}")
def test_module_imports_only_what_lies_below_it(file: Path) -> None:
    package = file.relative_to(ROOT).parts[0]
    assert not imported(file) & FORBIDDEN[package]


@pytest.mark.parametrize("file", MODULES, ids=lambda file: f"{file.parent.name}.{file.stem}")
def test_ros_appears_only_in_nodes_and_in_the_modules_that_translate(file: Path) -> None:
    if file.name in WITH_ROS or file.name.endswith("_node.py"):
        return
    assert not {name for name in imported(file) if name == "rclpy" or is_ros_package(name)}


def is_ros_package(name: str) -> bool:
    """Message packages, and what reads ROS's installation."""
    messages = name.endswith(("_msgs", "_interfaces", "_srvs"))
    return messages or name.startswith(("rosidl_", "ament_", "launch_ros"))
