"""How the controller's process ends: by signals in each state, and by a fault of its own."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from lifecycle_msgs.msg import Transition

from ampc_msgs_config.nodes import base_node
from ampc_ros.nodes.controller_node import ControllerNode
from tests.driver_of_nodes import Driver
from tests.ros_nodes import ros_context, spin_until
from tests.waiting import TIMEOUT

pytestmark = pytest.mark.usefixtures("own_domain")

COMMAND = [sys.executable, "-m", "ampc_ros.nodes.controller_node", "--ros-args"]
PARAMETERS = ["-p", "controller:=pure_pursuit", "-p", "static_path:=true"]


@contextmanager
def controller(*parameters: str) -> Iterator[subprocess.Popen[str]]:
    """Start a controller in a process of its own."""
    process = subprocess.Popen(
        [*COMMAND, *PARAMETERS, *parameters],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_a_steering_controller_leaves_the_last_angle_and_a_requested_stop(
    number: signal.Signals,
) -> None:
    with ros_context() as executor, controller() as process:
        driver = Driver(executor)
        driver.drive_for(6)
        process.send_signal(number)
        driver.drive_until(lambda: driver.stops[-1:] == [True])
        spin_until(executor, lambda: driver.commands[-1].velocity[0] == 0.0)
        assert driver.commands[-1].position[0] == driver.commands[-2].position[0] != 0.0
        said, _ = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 0
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("state", "number"), [("unconfigured", signal.SIGTERM), ("inactive", signal.SIGINT)]
)
def test_a_signal_to_a_controller_that_does_not_steer_ends_it_without_a_word(
    state: str, number: signal.Signals
) -> None:
    with ros_context() as executor, controller("-p", "autostart:=false") as process:
        driver = Driver(executor)
        assert driver.state() == "unconfigured"
        if state == "inactive":
            assert driver.change(Transition.TRANSITION_CONFIGURE)
        process.send_signal(number)
        said, _ = process.communicate(timeout=TIMEOUT)
        assert (driver.commands, driver.stops) == ([], [])
    assert process.returncode == 0
    assert "Traceback" not in said


def test_a_fault_in_the_programme_leaves_the_last_angle_and_a_requested_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        angle = driver.drive_for(6)[-1]
        executor.remove_node(node)
        monkeypatch.setattr(node.supervisor, "tick", lambda _: 1 / 0)
        driver.drive()
        with pytest.raises(ZeroDivisionError):
            base_node._spin(node, [])
        spin_until(executor, lambda: driver.stops[-1:] == [True])
        spin_until(executor, lambda: driver.commands[-1].velocity[0] == 0.0)
        assert driver.commands[-1].position[0] == angle
