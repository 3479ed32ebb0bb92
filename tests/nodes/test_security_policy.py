"""The SROS2 policy allows each node what it uses, and nothing else."""

from collections.abc import Iterator
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.marker_node import MarkerNode
from ampc_msgs_config.nodes.recorder_node import Recorder
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.gate_node import GateNode
from ampc_ros.nodes.planner_node import PlannerNode
from sim_vehicle.nodes.simulator_node import SimulatorNode
from tests.ros_domains import new_domain
from tests.ros_nodes import add, ros_context, spin_until

FILE = Path(__file__).resolve().parents[2] / "ampc_ros" / "security" / "policy.xml"
NODES: dict[str, Any] = {
    "controller": ControllerNode,
    "gate": GateNode,
    "planner": PlannerNode,
    "simulator": SimulatorNode,
    "recorder": Recorder,
    "markers": MarkerNode,
}
RULES = {"topics": ("publish", "subscribe"), "services": ("reply", "request")}
NOT_YET = {
    # where tf2_msgs is installed
    "recorder": {"subscribe /tf", "subscribe /tf_static"},
    "markers": {"publish /tf"},
    "simulator": {f"subscribe /{topic}" for topic in (ros.GATE_STEERING, ros.GATE_SPEED)},
}
"""What is allowed, though no node does it here."""


class Profile(NamedTuple):
    """What one node may do, as words such as `publish /odom`; a `*` stands for any word."""

    enclave: str
    namespace: str
    rights: set[str]


def profiles() -> Iterator[tuple[str, Profile]]:
    """Read the policy."""
    for enclave in ElementTree.parse(FILE).getroot().iter("enclave"):
        for profile in enclave.iter("profile"):
            name, namespace = profile.attrib["node"], profile.attrib["ns"]
            rights: set[str] = set()
            for rules in profile:
                for verb, qualifier in rules.attrib.items():
                    assert verb in RULES[rules.tag]
                    assert qualifier == "ALLOW"
                    rights |= {f"{verb} {full(str(each.text), name)}" for each in rules}
            yield name, Profile(enclave.attrib["path"], namespace, rights)


def full(expression: str, node: str) -> str:
    """Return the full name of a topic or service in the root namespace."""
    if expression.startswith("~/"):
        return f"/{node}{expression[1:]}"
    return expression if expression.startswith("/") else f"/{expression}"


def used_by(observer: Node, name: str) -> set[str]:
    """Return the endpoints of a node in the graph, in the same words."""
    lists = {
        "publish": observer.get_publisher_names_and_types_by_node,
        "subscribe": observer.get_subscriber_names_and_types_by_node,
        "reply": observer.get_service_names_and_types_by_node,
        "request": observer.get_client_names_and_types_by_node,
    }
    return {f"{verb} {topic}" for verb, of in lists.items() for topic, _ in of(name, "/")}


def is_seen(observer: Node, nodes: dict[str, Any]) -> bool:
    """Check whether all endpoints are discovered, with those that need another node first."""
    is_complete = bool(nodes["markers"].inputs.topics) and nodes["gate"].outputs.is_connected
    return is_complete and all(
        {f"publish {each.topic_name}" for each in node.publishers}
        | {f"subscribe {each.topic_name}" for each in node.subscriptions}
        | {f"reply {each.service_name}" for each in node.services}
        <= used_by(observer, name)
        for name, node in nodes.items()
    )


@pytest.fixture(scope="module")
def used(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[str]]:
    """Return the endpoints of each node in both modes.

    Each mode has its own domain: nodes of the same names remain visible there for a while. The car
    does not start, because the end of its drive would end the wait.
    """
    found: dict[str, set[str]] = {name: set() for name in NODES}
    for lock_step in (True, False):
        bag = tmp_path_factory.mktemp("bag") / "bag"
        simulated = {"recorder:use_sim_time": True} if lock_step else {}
        parameters = {"lock_step": lock_step, "recorder:output": str(bag), **simulated}
        with new_domain(), ros_context(**parameters) as executor:
            nodes = {name: make_node() for name, make_node in NODES.items()}
            nodes["simulator"].start_timer.cancel()
            observer = Node("observer")
            observer.create_subscription(MarkerArray, ros.MARKERS, print, 1)
            add(executor, observer, *nodes.values())
            spin_until(executor, partial(is_seen, observer, nodes))
            for name in NODES:
                found[name] |= used_by(observer, name)
            nodes["recorder"].close()
    return found


def test_every_node_has_a_profile_in_an_enclave_of_its_own() -> None:
    found = dict(profiles())
    assert found.keys() == NODES.keys()
    for name, profile in found.items():
        assert profile.enclave == f"/ampc/{name}"
        assert profile.namespace == "/"


@pytest.mark.parametrize("name", NODES)
def test_a_node_may_do_what_it_does(name: str, used: dict[str, set[str]]) -> None:
    rights = dict(profiles())[name].rights
    assert not {use for use in used[name] if not any(fnmatchcase(use, each) for each in rights)}


@pytest.mark.parametrize("name", NODES)
def test_a_node_may_not_do_what_it_never_does(name: str, used: dict[str, set[str]]) -> None:
    rights = dict(profiles())[name].rights
    idle = {each for each in rights if not any(fnmatchcase(use, each) for use in used[name])}
    assert idle <= NOT_YET.get(name, set())


def test_only_the_controller_may_publish_steering() -> None:
    right = f"publish /{ros.STEERING_COMMAND}"
    assert [name for name, profile in profiles() if right in profile.rights] == ["controller"]


def test_only_the_gate_may_command_the_car() -> None:
    for topic in (ros.DRIVE_COMMAND, ros.GATE_STEERING, ros.GATE_SPEED):
        right = f"publish /{topic}"
        assert [name for name, profile in profiles() if right in profile.rights] == ["gate"]


def test_nobody_may_call_a_service_of_another_node() -> None:
    for _, profile in profiles():
        assert not [right for right in profile.rights if right.startswith("request")]
