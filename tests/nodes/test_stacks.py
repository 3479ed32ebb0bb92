"""Stacks: their files, their launch files, and drives over ROS with their own messages."""

import importlib.util
import re
import signal
import subprocess
import sys
from pathlib import Path
from unittest.mock import MagicMock

import pytest

from ampc_msgs_config import topics
from ampc_msgs_config.config import shipped
from ampc_msgs_config.stack_file import as_text, load_stack
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.drive_messages import OUTPUTS
from ampc_ros.nodes.gate_node import GateNode
from ampc_ros.nodes.planner_node import PlannerNode
from ampc_ros.nodes.stack_launch import REAL, RENAMED
from launch_scripts import connect
from tests.foreign_messages import PACKAGES
from tests.message_packages import importable
from tests.ros_nodes import ros_context
from tests.waiting import TIMEOUT, wait_for

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = ROOT / "ampc_ros" / "launch"
STACKS = tuple(shipped("stacks"))


@pytest.mark.parametrize("name", STACKS)
def test_the_nodes_have_every_parameter_of_a_stack_and_take_its_value(name: str) -> None:
    stack = load_stack(name)
    texts = {key: repr(value) if value == "" else value for key, value in stack.parameters.items()}
    parameters = {
        key: str(value).lower() if isinstance(value, bool) else value
        for key, value in texts.items()
    }
    known = set[str]()
    with importable(PACKAGES), ros_context(**parameters):
        for make_node in (ControllerNode, PlannerNode, GateNode):
            node = make_node()
            declared = node.get_parameters_by_prefix("").keys()
            known |= declared
            for key in declared & stack.parameters.keys():
                assert node.get_parameter(key).value == stack.parameters[key]
            node.destroy_node()
    assert stack.parameters.keys() <= known


@pytest.mark.parametrize("name", STACKS)
def test_a_stack_renames_topics_that_exist_and_names_its_command(name: str) -> None:
    stack = load_stack(name)
    ours = {value for key, value in vars(topics).items() if key.isupper() and type(value) is str}
    assert stack.remappings.keys() <= ours
    assert {topics.ODOM, topics.DRIVE_COMMAND} <= stack.remappings.keys()
    assert all(topic.startswith("/") for topic in stack.remappings.values())
    assert stack.parameters["output"] in OUTPUTS
    page = (ROOT / "ampc_ros/doc/stacks.md").read_text(encoding="utf-8")
    assert f"## {name}\n" in page
    assert all(topic in page for topic in stack.remappings.values())


@pytest.mark.parametrize("name", STACKS)
def test_every_stack_has_a_launch_file_with_its_arguments_as_defaults(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = {
        part: MagicMock()
        for part in ("", ".actions", ".launch_description_sources", "_ros", "_ros.actions")
    }
    for part, module in made.items():
        monkeypatch.setitem(sys.modules, f"launch{part}", module)
    spec = importlib.util.spec_from_file_location("with_stack", LAUNCH / f"with_{name}.launch.py")
    assert spec
    assert spec.loader
    file = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(file)
    file.generate_launch_description()
    stack = load_stack(name)
    declared = {
        call.args[0]: call.kwargs.get("default_value")
        for call in made[".actions"].DeclareLaunchArgument.call_args_list
    }
    expected = {RENAMED.get(key, key): each for key, each in as_text(stack.parameters).items()}
    assert declared == REAL | expected | dict.fromkeys(stack.required)
    text = (LAUNCH / "ampc.launch.py").read_text(encoding="utf-8")
    assert declared.keys() <= set(re.findall(r'^    "(\w+)": \(', text, flags=re.MULTILINE))
    renamed = [call.kwargs for call in made["_ros.actions"].SetRemap.call_args_list]
    assert {each["src"]: each["dst"] for each in renamed} == stack.remappings
    (source,) = made[".launch_description_sources"].PythonLaunchDescriptionSource.call_args.args
    assert Path(source) == LAUNCH / "ampc.launch.py"


def test_no_launch_file_is_left_without_a_stack() -> None:
    files = {file.name for file in LAUNCH.glob("with_*")}
    assert files == {f"with_{name}.launch.py" for name in STACKS}


def ended(*arguments: str) -> tuple[int, str]:
    """Run connect.py to its end; return exit code and output."""
    done = subprocess.run(
        [sys.executable, connect.__file__, *arguments],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.usefixtures("own_domain")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nav3"], "'nav3' is neither a file nor one of the shipped stacks: autoware"),
        (["nav2", "-p", "speed"], "'speed' must be written NAME=VALUE"),
        (["nav2", "-p", "speed=[1, 2]"], "--parameter speed = '[1, 2]' must be one value"),
        (["nav2", "-r", "=/plan"], "'=/plan' must be written NAME=VALUE"),
        (["nav2", "--vehicle", "lorry"], "'lorry' is neither a file nor one of the shipped"),
        (["f1tenth"], "f1tenth needs -p path=VALUE"),
        (["nav2", "--namespace", "bad name!"], "--namespace: 'bad name!' must consist of"),
        (["nav2", "-p", "output=twisted"], "output = 'twisted' must be one of twist"),
    ],
)
def test_a_wrong_option_ends_connect_with_one_line(
    arguments: list[str], said: str, tmp_path: Path
) -> None:
    code, text = ended(*arguments, "--log", str(tmp_path))
    assert code == 2
    errors = [line for line in text.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert said in errors[0]
    assert "Traceback" not in text


@pytest.mark.usefixtures("own_domain")
def test_a_missing_message_package_ends_connect_with_its_name(tmp_path: Path) -> None:
    code, text = ended("carla", "--log", str(tmp_path))
    assert code == 2
    assert "output = carla needs the package carla_msgs, which is not installed: sudo apt" in text


@pytest.mark.usefixtures("own_domain")
def test_an_interrupt_ends_connect_and_its_nodes_and_is_no_error(tmp_path: Path) -> None:
    words = [sys.executable, connect.__file__, "nav2", "--log", str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        wait_for(lambda: (tmp_path / "gate.log").is_file())
        wait_for(lambda: ": ready" in (tmp_path / "gate.log").read_text(encoding="utf-8"))
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT) == 0


@pytest.mark.parametrize(
    ("given", "used"), [("-1.0", None), ("-0.9", -0.9), ("-2.2", -2.2), ("0.0", 0.0)]
)
def test_odometry_ahead_of_the_centre_of_gravity_is_a_distance_and_only_minus_one_the_rear_axle(
    given: str, used: float | None
) -> None:
    with ros_context(base_link_to_cg=given, controller="pure_pursuit"):
        node = ControllerNode()
        assert node.choices({}).base_link_to_cg == used
        node.destroy_node()
