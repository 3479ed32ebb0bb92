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
OF_LAUNCH = {"lock_step", "static_path", "start_time_out", "use_sim_time"}
"""Where the launch file has defaults of its own: a whole drive is its purpose."""
OF_THE_LAUNCH_FILE = {"namespace", "simulate", "gate", "planner", "params_file"}
"""Arguments that are no parameters."""
RENAMED = {("gate", "output"): "drive_output"}
"""Arguments of other names than the parameter, by node and parameter."""


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Load the launch file; what it would start is noted, for `launch` is no dependency."""
    for name in ("actions", "event_handlers", "events", "substitutions"):
        monkeypatch.setitem(sys.modules, f"launch.{name}", MagicMock())
    for name in ("launch", "launch_ros", "launch_ros.actions", "launch_ros.parameter_descriptions"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    spec = importlib.util.spec_from_file_location("ampc_launch", FILE)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "ParameterValue", lambda value, value_type: (value, value_type))
    return module


def started(launch_file: Any, **arguments: str) -> dict[str, Any]:
    """Return the arguments of each node that the launch file starts, by executable."""
    texts = {name: default for name, (default, _) in launch_file.ARGUMENTS.items()} | arguments

    def configuration(name: str) -> Any:
        return MagicMock(perform=lambda _: texts[name])

    launch_file.LaunchConfiguration = configuration
    launch_file.Node.reset_mock()
    launch_file.start(None)
    return {call.kwargs["executable"]: call.kwargs for call in launch_file.Node.call_args_list}


def parameters(node: Any) -> dict[str, Any]:
    """Return the parameters of a node, as value and type."""
    values = node["parameters"][0]
    assert isinstance(values, dict)
    return values


def test_the_launch_file_starts_every_node_with_parameters_that_it_has(launch_file: Any) -> None:
    given = started(launch_file, output="folder")
    assert given.keys() == {*NODES, "recorder"}
    look = {"vehicle", "base_link_to_cg", "frame_prefix"}
    assert parameters(given["recorder"]).keys() == {"output", "use_sim_time", *look}
    with ros_context() as executor:
        for name, make_node in NODES.items():
            node = make_node()
            add(executor, node)
            assert parameters(given[name]).keys() <= node.get_parameters_by_prefix("").keys()


def test_every_argument_of_the_launch_file_is_used_and_has_the_default_of_the_node(
    launch_file: Any,
) -> None:
    given = started(launch_file, output="folder")
    used = {
        RENAMED.get((name, each), each) for name, node in given.items() for each in parameters(node)
    } - {"wait_for_recorder"}
    assert used | OF_THE_LAUNCH_FILE == launch_file.ARGUMENTS.keys()
    with ros_context() as executor:
        for name, make_node in NODES.items():
            node = make_node()
            add(executor, node)
            for parameter in parameters(given[name]).keys() - {"wait_for_recorder"} - OF_LAUNCH:
                argument = RENAMED.get((name, parameter), parameter)
                default, _ = launch_file.ARGUMENTS[argument]
                value = launch_file.parsed(argument, default)
                assert node.get_parameter(parameter).value == value


def test_the_launch_file_knows_every_controller(launch_file: Any) -> None:
    _, description = launch_file.ARGUMENTS["controller"]
    assert description == f"{', '.join(CONTROLLERS)}, or FILE.py:CLASS"


def test_the_end_of_every_node_but_the_markers_ends_the_others(launch_file: Any) -> None:
    given = started(launch_file, output="folder")
    assert list(given)[-1] == "markers"
    assert launch_file.OnProcessExit.call_count == len(given) - 1


def test_topics_stay_on_this_machine_unless_the_shell_says_otherwise(launch_file: Any) -> None:
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    launch_file.generate_launch_description()
    launch_file.EnvironmentVariable.assert_called_once_with(name, default_value="LOCALHOST")
    value = launch_file.EnvironmentVariable.return_value
    launch_file.SetEnvironmentVariable.assert_called_once_with(name, value)


def test_with_the_gate_the_simulated_car_receives_the_commands_of_the_gate(
    launch_file: Any,
) -> None:
    given = started(launch_file, lock_step="false")
    commands = ["steering_command", "target_speed"]
    assert given["simulator"]["remappings"] == [(name, f"gate/{name}") for name in commands]
    assert not any(each["remappings"] for name, each in given.items() if name != "simulator")
    without = started(launch_file, gate="false", lock_step="false")
    assert "gate" not in without
    assert not without["simulator"]["remappings"]


def test_in_lock_step_every_node_uses_the_clock_of_its_car(launch_file: Any) -> None:
    given = started(launch_file, output="folder")
    assert all(("/clock", "clock") in each["remappings"] for each in given.values())
    real = started(launch_file, output="folder", lock_step="false")
    assert not any(("/clock", "clock") in each["remappings"] for each in real.values())


@pytest.mark.parametrize(
    ("arguments", "left_out"),
    [
        ({}, {"recorder"}),
        ({"planner": "false"}, {"planner", "recorder"}),
        ({"simulate": "False", "output": "folder"}, {"simulator"}),
        ({"gate": "0", "planner": "1"}, {"gate", "recorder"}),
    ],
)
def test_an_argument_leaves_a_node_out(
    arguments: dict[str, str], left_out: set[str], launch_file: Any
) -> None:
    assert {*NODES, "recorder"} - started(launch_file, **arguments).keys() == left_out


def test_simulated_time_holds_for_all_nodes_but_the_owner_of_the_clock(launch_file: Any) -> None:
    for lock_step, use_sim_time in (("true", "false"), ("true", "true"), ("false", "true")):
        given = started(
            launch_file, lock_step=lock_step, use_sim_time=use_sim_time, output="folder"
        )
        actual = {name: parameters(each)["use_sim_time"][0] for name, each in given.items()}
        assert actual.pop("recorder") is True
        assert actual.pop("simulator") is (lock_step == "false")
        assert set(actual.values()) == {use_sim_time == "true"}


def test_a_file_of_parameters_comes_after_the_arguments_of_every_node(
    launch_file: Any, tmp_path: Path
) -> None:
    file = tmp_path / "car.yaml"
    file.touch()
    given = started(launch_file, params_file=str(file), output="folder")
    assert all(each["parameters"][1:] == [str(file)] for each in given.values())
    assert all(len(each["parameters"]) == 1 for each in started(launch_file).values())


def test_the_recorder_has_time_to_close_its_bag(launch_file: Any) -> None:
    given = started(launch_file, output="folder")
    assert float(given["recorder"]["sigterm_timeout"]) > 2 * 5.0  # twice the default of launch


@pytest.mark.parametrize(
    ("argument", "text", "expected"),
    [
        ("speed", "fast", "a number"),
        ("friction", "", "a number"),
        ("laps", "1.5", "a whole number"),
        ("seed", "one", "a whole number"),
        ("lock_step", "maybe", "true or false"),
        ("planner", "none", "true or false"),
        ("params_file", "/nowhere/car.yaml", "a file"),
    ],
)
def test_a_wrong_argument_is_named_with_its_value(
    argument: str, text: str, expected: str, launch_file: Any
) -> None:
    line = f"^launch argument {argument}:={text} must be {expected}$"
    with pytest.raises(ValueError, match=line):
        started(launch_file, **{argument: text})


def test_a_parameter_keeps_its_type(launch_file: Any) -> None:
    given = parameters(started(launch_file, vehicle="07", speed="9")["simulator"])
    assert (given["vehicle"], given["speed"]) == (("07", str), (9.0, float))
    assert (given["lock_step"], given["laps"]) == ((True, bool), (1, int))
