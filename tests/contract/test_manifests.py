"""Each package.xml lists exactly the packages that the sources import, lazy imports included."""

import ast
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.contract.test_architecture import BELOW, ROOT, imported, packages, sources

KEYS = {
    "yaml": "python3-yaml",
    "rosbags": "python3-rosbags-pip",
    "tf2_ros": "tf2_ros_py",
    **{
        name: f"python3-{name}"
        for name in ("jinja2", "matplotlib", "numba", "numpy", "rich", "scipy")
    },
}
"""Keys of rosdep for Ubuntu 24.04 (rosdep/python.yaml of ros/rosdistro), or packages, by module."""
NO_KEY = {"lz4", "markupsafe", "mcap", "msgspec", "plotly", "tsdownsample", "zstandard"}
"""Modules without a key of rosdep, which lock/requirements.txt installs."""
NOT_OF_THE_PRODUCT = {"cma", "distributed", "rerun", "setuptools"}
"""Of a study, of a cluster, of `report.py --rerun` and of setup.py."""
OF_OTHER_STACKS = re.compile(r"(ackermann|autoware|carla)\w*_msgs")
"""Message packages that are imported only where a parameter selects them."""
LOADED_BY_NAME = re.compile(r"(\w+)/(?:msg|srv)/\w+")
"""Message types as text, whose package is imported when the message is used."""


def modules(package: str) -> set[str]:
    """Return the top-level modules that the sources and launch files of a package import."""
    files = [*sources(package), *sorted((ROOT / package).glob("launch/*.py"))]
    names = set().union(*(packages(imported(file)) | loaded_by_name(file) for file in files))
    names -= {*sys.stdlib_module_names, package, "run"} | NOT_OF_THE_PRODUCT
    return {name for name in names if not OF_OTHER_STACKS.fullmatch(name)}


def loaded_by_name(file: Path) -> set[str]:
    """Return the modules that a file names in texts, to import them when they are needed."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            names |= {match[1] for match in [LOADED_BY_NAME.fullmatch(node.value)] if match}
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            texts = [each.value for each in node.args if isinstance(each, ast.Constant)]
            names |= packages({text for text in texts if isinstance(text, str)})
    return names


def manifest(package: str, kind: str) -> set[str]:
    """Return the dependencies of a kind that a manifest lists."""
    root = ElementTree.parse(ROOT / package / "package.xml").getroot()
    return {str(each.text) for each in root.findall(kind)}


@pytest.mark.parametrize("package", sorted(BELOW))
def test_the_manifest_lists_what_the_sources_import_and_nothing_else(package: str) -> None:
    needed = {KEYS.get(name, name) for name in modules(package) - NO_KEY}
    assert manifest(package, "exec_depend") == needed


@pytest.mark.parametrize("package", sorted(BELOW))
def test_a_comment_of_the_manifest_names_what_rosdep_cannot_install(package: str) -> None:
    text = (ROOT / package / "package.xml").read_text(encoding="utf-8")
    comments = " ".join(re.findall(r"<!--(.*?)-->", text, re.DOTALL))
    assert {name for name in NO_KEY if re.search(rf"\b{name}\b", comments)} == modules(
        package
    ) & NO_KEY


def test_one_command_installs_every_python_package() -> None:
    lock = (ROOT / "lock" / "requirements.txt").read_text(encoding="utf-8").lower()
    locked = set(re.findall(r"^([\w.-]+)(?:\[\w+\])?==", lock, re.MULTILINE))
    distributions = {"yaml": "pyyaml"}
    used = set().union(*(modules(package) for package in BELOW)) & (KEYS.keys() | NO_KEY)
    assert {distributions.get(name, name) for name in used - {"numpy", "tf2_ros"}} <= locked


def test_the_tests_packages_are_listed_for_colcon_test() -> None:
    for package in BELOW:
        assert {"python3-pytest"} <= manifest(package, "test_depend")
