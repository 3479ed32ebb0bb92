"""The launch file speaks of parameters that the nodes have, with their defaults."""

import importlib.util
import sys
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest

from ampc_msgs_config.nodes.marker_node import MarkerNode
from ampc_ros.configuration import CONTROLLERS
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.gate_node import GateNode
from ampc_ros.nodes.planner_node import PlannerNode
from sim_vehicle.nodes.simulator_node import SimulatorNode
from tests.ros_nodes import add, ros_context

FILE = Path(__file__).resolve().parents[2] / "ampc_ros" / "launch" / "ampc.launch.py"
NODES: dict[str, Any] = {
    "controller": ControllerNode,
    "gate": GateNode,
    "markers": MarkerNode,
    "planner": PlannerNode,
    "simulator": SimulatorNode,
}
OF_LAUNCH = {"lock_step", "static_path", "start_time_out"}
"""Where the launch file has defaults of its own: a whole drive is its purpose."""


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Load the launch file; what it would start is noted, for `launch` is no dependency."""
    for name in ("actions", "conditions", "event_handlers", "events", "substitutions"):
        monkeypatch.setitem(sys.modules, f"launch.{name}", MagicMock())
    for name in ("launch", "launch_ros", "launch_ros.actions", "launch_ros.parameter_descriptions"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    spec = importlib.util.spec_from_file_location("ampc_launch", FILE)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.generate_launch_description()
    return module


def started(launch_file: Any) -> dict[str, set[str]]:
    """Return the names of the parameters of each executable that the launch file starts."""
    calls = [call.kwargs for call in launch_file.Node.call_args_list]
    return {call["executable"]: set(call["parameters"][0]) for call in calls}


def test_the_launch_file_starts_every_node_with_parameters_that_it_has(launch_file: Any) -> None:
    given = started(launch_file)
    assert given.keys() == {*NODES, "recorder"}
    look = {"vehicle", "base_link_to_cg", "frame_prefix"}
    assert given["recorder"] == {"output", "use_sim_time", *look}
    with ros_context() as executor:
        for name, make_node in NODES.items():
            node = make_node()
            add(executor, node)
            assert given[name] <= node.get_parameters_by_prefix("").keys()


def test_every_argument_of_the_launch_file_is_used_and_has_the_default_of_the_node(
    launch_file: Any,
) -> None:
    given = started(launch_file)
    used = set().union(*given.values()) - {"use_sim_time", "wait_for_recorder"}
    others = {"namespace", "simulate", "gate", "drive_output"}
    assert used | others == launch_file.ARGUMENTS.keys()
    with ros_context() as executor:
        for name, make_node in NODES.items():
            node = make_node()
            add(executor, node)
            for parameter in given[name] - {"wait_for_recorder"} - OF_LAUNCH:
                argument = "drive_output" if parameter == "output" else parameter  # of the gate
                default, _ = launch_file.ARGUMENTS[argument]
                kind = launch_file.TYPES.get(parameter, str)
                value = default == "true" if kind is bool else kind(default)
                assert node.get_parameter(parameter).value == value


def test_the_launch_file_knows_every_controller(launch_file: Any) -> None:
    _, description = launch_file.ARGUMENTS["controller"]
    assert description == f"{', '.join(CONTROLLERS)}, or FILE.py:CLASS"


def test_the_end_of_every_node_but_the_markers_ends_the_others(launch_file: Any) -> None:
    order = [call.kwargs["executable"] for call in launch_file.Node.call_args_list]
    assert order[-1] == "markers"
    assert launch_file.OnProcessExit.call_count == len(order) - 1


def test_topics_stay_on_this_machine_unless_the_shell_says_otherwise(launch_file: Any) -> None:
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    launch_file.EnvironmentVariable.assert_called_once_with(name, default_value="LOCALHOST")
    value = launch_file.EnvironmentVariable.return_value
    launch_file.SetEnvironmentVariable.assert_called_once_with(name, value)


def test_with_the_gate_the_simulated_car_receives_the_commands_of_the_gate(
    launch_file: Any,
) -> None:
    gate, choose = launch_file.LaunchConfiguration.return_value, launch_file.IfElseSubstitution
    choices = [call.args for call in choose.call_args_list if call.args[1] != "clock"]
    assert choices == [
        (gate, f"gate/{name}", name) for name in ("steering_command", "target_speed")
    ]
    renamed = {
        call.kwargs["executable"]: [topic for topic, _ in call.kwargs["remappings"]]
        for call in launch_file.Node.call_args_list
    }
    assert renamed.pop("simulator") == ["steering_command", "target_speed", "/clock"]
    assert all(topics == ["/clock"] for topics in renamed.values())


def test_in_lock_step_the_clock_is_in_the_namespace_of_the_nodes(launch_file: Any) -> None:
    switch, choose = launch_file.LaunchConfiguration.return_value, launch_file.IfElseSubstitution
    clocks = [call.args for call in choose.call_args_list if call.args[1] == "clock"]
    assert set(clocks) == {(switch, "clock", "/clock")}
    assert len(clocks) == len(launch_file.Node.call_args_list)
