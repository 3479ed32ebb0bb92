"""Topics stay on this machine by default, for scripts and for sourced shells."""

import os
import subprocess
from pathlib import Path

import pytest

from launch_scripts.run.processes import ros_environment

ROOT = Path(__file__).resolve().parents[2]
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


@pytest.mark.parametrize("distribution", ["", "jazzy"])
@pytest.mark.parametrize("chosen", ["", "SUBNET", "OFF"])
def test_nodes_of_a_script_keep_to_this_machine_unless_the_user_chose_a_range(
    distribution: str, chosen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"ROS_DISTRO": distribution, RANGE: chosen}.items():
        monkeypatch.delenv(name, raising=False)
        if value:
            monkeypatch.setenv(name, value)
    environment = ros_environment()
    assert environment[RANGE] == (chosen or "LOCALHOST")
    wheels = not distribution
    assert (environment.get("RMW_IMPLEMENTATION") == "rmw_fastrtps_cpp") or not wheels


@pytest.mark.skipif(not (ROOT / "install").is_dir(), reason="the workspace is not built")
@pytest.mark.parametrize("chosen", ["", "SUBNET"])
def test_a_sourced_shell_keeps_to_this_machine_unless_the_user_chose_a_range(chosen: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name != RANGE}
    words = f"source '{ROOT}/setup.bash' && echo ${RANGE}"
    output = subprocess.run(
        ["/bin/bash", "-c", words],
        env=environment | ({RANGE: chosen} if chosen else {}),
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert output.strip() == (chosen or "LOCALHOST")
