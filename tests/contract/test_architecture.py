"""The layout of DESIGN section 1: which folder may import which."""

import ast
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BELOW = {
    "ampc_msgs_config": {"ampc_msgs_config"},
    "ampc_ros": {"ampc_ros", "ampc_msgs_config"},
    "sim_vehicle": {"sim_vehicle", "ampc_msgs_config"},
    "launch_scripts": {"launch_scripts", "ampc_ros", "sim_vehicle", "ampc_msgs_config"},
}
"""Packages that a package may import, itself included."""
OURS = {*BELOW, "tests"}
COMMANDS = {
    "start",
    "report",
    "connect",
    "replay",
    "recover",
    "compare",
    "tune",
    "reproduce",
    "bootstrap",
    "new_car",
    "identify",
}
COMMANDS |= {"compile_all", "certify", "watch", "setup", "__init__"}
"""Files at the top of launch_scripts."""
STUDY = {"launch_scripts.study", "launch_scripts.reproduce"}
REPEATED = {"main", "parse_arguments", "read_options", "__all__"}
"""Names that every command or package may define."""
MOST_REPEATED = 30
"""Other names that are defined at the top level of more than one file."""
LARGEST_FOLDER = 20
"""Modules in a folder of product code."""


def sources(package: str) -> list[Path]:
    folder = ROOT / package if package == "launch_scripts" else ROOT / package / package
    return sorted(file for file in folder.rglob("*.py") if file.name != "setup.py")


PRODUCT = [file for package in BELOW for file in sources(package)]


def imported(file: Path) -> set[str]:
    """Full names of the modules that a file imports, wherever in the file."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def packages(names: set[str]) -> set[str]:
    return {name.split(".")[0] for name in names}


def is_ros_package(name: str) -> bool:
    """Whether a package is rclpy, a message package or reads the installation of ROS."""
    messages = name.endswith(("_msgs", "_interfaces", "_srvs"))
    return name == "rclpy" or messages or name.startswith(("rosidl_", "ament_", "launch_ros"))


def may_use_ros(file: Path) -> bool:
    return file.name == "ros.py" or file.parent.name == "nodes"


def test_a_package_imports_only_what_lies_below_it() -> None:
    wrong = {
        file.relative_to(ROOT): above
        for file in PRODUCT
        if (above := packages(imported(file)) & OURS - BELOW[file.relative_to(ROOT).parts[0]])
    }
    assert not wrong


def test_product_code_imports_nothing_of_the_study() -> None:
    study = {file for file in PRODUCT if file.parent.name == "study" or file.stem == "reproduce"}
    wrong = {
        file.relative_to(ROOT): actual
        for file in PRODUCT
        if file not in study
        and (actual := {n for n in imported(file) if ".".join(n.split(".")[:2]) in STUDY})
    }
    assert len(study) > 1
    assert not wrong


def test_ros_appears_only_in_ros_modules_and_nodes() -> None:
    wrong = {
        file.relative_to(ROOT): actual
        for file in PRODUCT
        if not may_use_ros(file)
        and (actual := {n for n in packages(imported(file)) if is_ros_package(n)} - OURS)
    }
    assert not wrong


def test_the_top_of_launch_scripts_has_only_commands() -> None:
    actual = {file.stem for file in (ROOT / "launch_scripts").glob("*.py")}
    assert actual <= COMMANDS


def test_no_folder_of_product_code_is_overfull() -> None:
    folders = {file.parent for file in PRODUCT}
    sizes = {folder.relative_to(ROOT): len(list(folder.glob("*.py"))) for folder in folders}
    assert max(sizes.values()) <= LARGEST_FOLDER, sizes


def test_few_top_level_names_are_defined_twice() -> None:
    files: dict[str, set[str]] = defaultdict(set)
    for file in PRODUCT:
        for statement in ast.parse(file.read_text(encoding="utf-8")).body:
            for name in defined_names(statement) - REPEATED:
                files[name].add(str(file.relative_to(ROOT)))
    repeated = {name: sorted(each) for name, each in files.items() if len(each) > 1}
    assert len(repeated) <= MOST_REPEATED, repeated


def defined_names(statement: ast.stmt) -> set[str]:
    """Return the names that a statement of a module defines."""
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return {statement.name}
    targets = statement.targets if isinstance(statement, ast.Assign) else []
    targets = [statement.target] if isinstance(statement, ast.AnnAssign) else targets
    nodes = (node for target in targets for node in ast.walk(target))
    return {node.id for node in nodes if isinstance(node, ast.Name)}


@pytest.mark.parametrize("package", sorted(BELOW))
def test_every_folder_with_modules_is_a_package(package: str) -> None:
    folders = {file.parent for file in sources(package)}
    assert all((folder / "__init__.py").exists() for folder in folders)
