"""The workspace: colcon packages, manifests, and error messages of bootstrap."""

import configparser
import importlib
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from ampc_msgs_config import __version__
from launch_scripts import bootstrap

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"ampc_msgs_config", "ampc_ros", "launch_scripts", "sim_vehicle"}
PIP_OUTPUTS = {
    "the package index cannot be reached": """
WARNING: Retrying (Retry(total=0)) after connection broken by 'NewConnectionError(': Failed to
establish a new connection: [Errno -3] Temporary failure in name resolution')': /simple/numba/
ERROR: Could not find a version that satisfies the requirement numba==0.68.1 (from versions: none)
ERROR: No matching distribution found for numba==0.68.1
""",
    "there is no wheel of ros-jazzy-rclpy[fastrtps] for Python 3.15.0 on aarch64": """
ERROR: Could not find a version that satisfies the requirement ros-jazzy-rclpy[fastrtps]==7.1.6
ERROR: No matching distribution found for ros-jazzy-rclpy[fastrtps]==7.1.6
""",
    "there is no compiler": """
error: command 'gcc' failed: No such file or directory
ERROR: Failed building wheel for contourpy
""",
    "the hash of a package differs": """
ERROR: THESE PACKAGES DO NOT MATCH THE HASHES FROM THE REQUIREMENTS FILE. If you have updated the
package versions, please update the hashes. Otherwise, examine the package contents carefully
    mdurl==0.1.2 from file:///wheels/mdurl-0.1.2-py3-none-any.whl (from -r a.txt (line 5))
""",
    "the disk is full": """
ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device
""",
    "pip failed: ERROR: unknown message": "ERROR: unknown message\n",
}


@pytest.mark.skipif(not importlib.util.find_spec("colcon_core"), reason="colcon is not installed")
def test_colcon_builds_every_package_as_ament_python() -> None:
    command = [sys.executable, "-m", "colcon", "--log-base", os.devnull, "list"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    kinds = {line.split("\t")[0]: line.split("\t")[2] for line in listed.splitlines()}
    assert kinds == dict.fromkeys(PACKAGES, "(ros.ament_python)")


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_manifest_and_setup_agree_on_version_and_maintainer(package: str) -> None:
    manifest = (ROOT / package / "package.xml").read_text(encoding="utf-8")
    setup = (ROOT / package / "setup.py").read_text(encoding="utf-8")
    for pattern in (r"<version>(.+)</version>", r'email="(.+?)"', r"<license.*>(.+)</license>"):
        found = re.search(pattern, manifest)
        assert found
        assert f'"{found[1]}"' in setup


def test_one_version_stands_in_every_file_that_states_it() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    versions = {"README.md": re.findall(r"version = \{(.+?)\}", readme)}
    for file in sorted(ROOT.glob("*/package.xml")):
        versions[str(file)] = re.findall("<version>(.+)</version>", file.read_text("utf-8"))
    for file in (ROOT / "CHANGELOG.rst", *sorted(ROOT.glob("*/CHANGELOG.rst"))):
        released = re.findall(r"^(\d+\.\d+\.\d+) \(", file.read_text("utf-8"), re.MULTILINE)
        versions[str(file)] = released[:1]
    assert len(versions) == 2 + 2 * len(PACKAGES)
    assert set(map(tuple, versions.values())) == {(__version__,)}


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_each_package_contains_the_licence_that_its_manifest_names(package: str) -> None:
    root = ElementTree.parse(ROOT / package / "package.xml").getroot()
    file = ROOT / package / root.findall("license")[0].attrib["file"]
    assert file.parent == ROOT / package
    assert file.read_bytes() == (ROOT / "LICENSE").read_bytes()


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_colcon_test_finds_tests_for_each_package(package: str) -> None:
    config = configparser.ConfigParser()
    config.read(ROOT / package / "setup.cfg")
    folders = config["tool:pytest"]["testpaths"].split()
    assert folders
    assert all(list((ROOT / package / folder).glob("test_*.py")) for folder in folders)


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_every_executable_names_an_existing_function(package: str) -> None:
    setup = (ROOT / package / "setup.py").read_text(encoding="utf-8")
    executables = re.findall(r'"\w+ = ([\w.]+):(\w+)"', setup)
    assert executables
    for module, function in executables:
        assert callable(getattr(importlib.import_module(module), function))


@pytest.mark.parametrize("expected", PIP_OUTPUTS)
def test_bootstrap_explains_a_failure_of_pip_in_one_sentence(expected: str) -> None:
    sentence = bootstrap.explain_pip(PIP_OUTPUTS[expected], "3.15.0", "aarch64")
    assert expected in sentence
    assert "\n" not in sentence


@pytest.mark.parametrize("machine", [("Linux", "aarch64"), ("Darwin", "arm64"), ("Windows", "x")])
def test_bootstrap_rejects_machines_without_ros_wheels(
    machine: tuple[str, str],
) -> None:
    with pytest.raises(bootstrap.SetupError, match=machine[1]):
        bootstrap.require_wheels(*machine)


def test_bootstrap_refuses_another_ros_distribution() -> None:
    with pytest.raises(bootstrap.SetupError, match="humble"):
        bootstrap.uses_installed_ros("humble")


def test_bootstrap_names_a_missing_venv_module(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(bootstrap.SetupError, match="python3-venv"):
        bootstrap.create_venv(with_ros=False)
