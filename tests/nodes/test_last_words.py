"""How the controller's process ends by signals in each state."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from lifecycle_msgs.msg import Transition

from ampc_msgs_config.signals import ENDING, handle_ending_signals
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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
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


NODES = {
    "ampc_ros.nodes.controller_node": signal.SIGINT,
    "ampc_ros.nodes.planner_node": signal.SIGHUP,
    "sim_vehicle.nodes.simulator_node": signal.SIGQUIT,
    "ampc_msgs_config.nodes.marker_node": signal.SIGHUP,
}
"""Modules of nodes, and a signal that is sent to each while it starts."""


@pytest.mark.parametrize("after", [0.0, 0.2, 0.7])
def test_a_signal_while_a_node_is_imported_or_built_ends_it_without_a_traceback(
    after: float,
) -> None:
    """Wait until the package of the nodes is imported, and send the signal some time after."""
    running = {}
    for module in NODES:
        script = f"import sys; sys.orig_argv[1:] = ['-m', {module!r}]; sys.argv = ['node']\n"
        script += f"import {module.rpartition('.')[0]}; print('imports', flush=True)\n"
        script += f"from {module} import main; sys.exit(main())"
        running[module] = subprocess.Popen(
            [sys.executable, "-c", script],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
    for module, process in running.items():
        assert process.stdout
        assert process.stdout.readline() == "imports\n"
        time.sleep(after)
        process.send_signal(NODES[module])
        said, _ = process.communicate(timeout=TIMEOUT)
        assert "Traceback" not in said
        assert process.returncode == 0


def test_nohup_keeps_its_effect() -> None:
    before = {number: signal.getsignal(number) for number in ENDING}
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        handle_ending_signals(print)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        assert signal.getsignal(signal.SIGQUIT) is print
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@pytest.mark.parametrize(
    ("error", "last", "lines"),
    [
        ("MemoryError('none\\nleft')", "error: MemoryError: none left", 1),
        ("ImportError('failed to map')", "error: ImportError: failed to map", 1),
        ("KeyError('a fault')", "KeyError: 'a fault'", 3),
    ],
)
def test_a_lack_of_memory_while_a_node_is_imported_is_one_line(
    error: str, last: str, lines: int
) -> None:
    script = f"import sys; sys.orig_argv[1:] = ['-m', {next(iter(NODES))!r}]\n"
    script += f"import ampc_msgs_config.nodes; raise {error}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == last
    assert len(done.stderr.splitlines()) == lines
