"""A second publisher of a topic is detected; a node that was killed and started again is none."""

from collections.abc import Iterator
from typing import Any

import pytest
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.sole_sources import FALLS, SoleSources
from ampc_msgs_config.types import ERROR
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from sim_vehicle.nodes.simulator_node import SimulatorNode
from tests.nodes.test_nodes import odometry
from tests.nodes.test_reports import report_of
from tests.ros_nodes import add, ros_context, spin_to_the_end, spin_until

pytestmark = pytest.mark.usefixtures("own_domain")


@pytest.fixture
def executor() -> Iterator[SingleThreadedExecutor]:
    """The executor of a test whose nodes join ROS."""
    with ros_context(controller="pure_pursuit") as nodes:
        yield nodes


class Source(Node):
    """A node that publishes one topic."""

    def __init__(self, name: str, topic: str = ros.ODOM, kind: Any = Odometry) -> None:
        """Create the publisher."""
        super().__init__(name)
        self.output = self.create_publisher(kind, topic, ros.RELIABLE)

    def wait(self, executor: SingleThreadedExecutor, count: int = 1) -> None:
        """Wait until so many subscriptions are matched."""
        add(executor, self)
        spin_until(executor, lambda: self.output.get_subscription_count() >= count)


def watch(executor: SingleThreadedExecutor) -> SoleSources:
    """Return the watch over `odom` of a new node."""
    node = Node("watching")
    add(executor, node)
    return SoleSources(node, {ros.ODOM: Odometry}, [ros.REFERENCE_PATH], lambda: None)


def test_two_publishers_of_one_name_are_detected_by_their_alternating_messages(
    executor: SingleThreadedExecutor,
) -> None:
    sources = watch(executor)
    pair = Source("car"), Source("car")
    for each in pair:
        each.wait(executor)

    def is_detected() -> bool:
        for each in pair:
            each.output.publish(odometry(1))
        return bool(sources.conflict)

    spin_until(executor, is_detected)
    assert sources.conflict == "odom is published by /car and /car, must have one publisher"
    pair[0].destroy_publisher(pair[0].output)
    pair[1].output.publish(odometry(2))
    before: dict[str, int] = {}
    while before != sources.last:  # what both have published before
        before = dict(sources.last)
        for _ in range(20):
            executor.spin_once(timeout_sec=0.02)
    sources.clear()
    for number in range(3 * FALLS):
        pair[1].output.publish(odometry(number))
        known = dict(sources.last)
        spin_until(executor, lambda: sources.last != known)  # noqa: B023
    assert sources.conflict == ""


def test_two_names_are_detected_without_any_message(executor: SingleThreadedExecutor) -> None:
    sources = watch(executor)
    one = Source("one", ros.REFERENCE_PATH, Odometry)
    other = Source("other", ros.REFERENCE_PATH, Odometry)
    add(executor, one, other)
    spin_until(executor, lambda: bool(sources.conflict))
    said = "reference_path is published by /one and /other, must have one publisher"
    assert sources.conflict == said
    one.destroy_publisher(one.output)
    spin_until(executor, lambda: sources.node.count_publishers(ros.REFERENCE_PATH) == 1)
    assert sources.conflict == said
    sources.clear()
    sources.look_at_lists()
    assert sources.conflict == ""


def test_a_restarted_publisher_is_no_second_one_though_the_killed_one_is_still_listed(
    executor: SingleThreadedExecutor,
) -> None:
    sources = watch(executor)
    for _ in range(FALLS):
        source = Source("car")  # the one before stays listed, but is silent
        source.wait(executor)
        for number in range(5):
            known = dict(sources.arrivals)
            source.output.publish(odometry(number))
            spin_until(executor, lambda: sources.arrivals != known)  # noqa: B023
        sources.falls[ros.ODOM].clear()  # restarts are more than the window apart
    assert sources.node.count_publishers(ros.ODOM) == FALLS
    sources.look_at_lists()
    assert sources.conflict == ""


@pytest.mark.parametrize("make_node", [ControllerNode, PlannerNode])
def test_a_second_car_requests_a_stop_and_both_nodes_are_named(
    make_node: Any, executor: SingleThreadedExecutor
) -> None:
    node = make_node()
    add(executor, node)
    stops: list[bool] = []
    listener = Node("listener")

    def on_stop(message: Bool) -> None:
        stops.append(message.data)

    listener.create_subscription(Bool, ros.STOP_REQUEST, on_stop, ros.LATCHED)
    add(executor, listener, Source("first_car"), Source("second_car"))
    spin_until(executor, lambda: bool(node.sources.conflict))
    report = report_of(node)
    assert report.level[0] == ERROR
    assert "odom is published by /first_car and /second_car" in report.message
    if make_node is PlannerNode:
        assert node.stop_requested
    else:
        spin_until(executor, lambda: stops[-1:] == [True])


def test_a_simulator_reports_two_controllers(executor: SingleThreadedExecutor) -> None:
    node = SimulatorNode()
    add(executor, node)
    add(executor, *(Source(f"controller{k}", ros.STEERING_COMMAND, JointState) for k in (1, 2)))
    spin_until(executor, lambda: bool(node.sources.conflict))
    report = report_of(node)
    assert report.level[0] == ERROR
    assert "steering_command is published by /controller1 and /controller2" in report.message


@pytest.mark.parametrize("make_node", [ControllerNode, PlannerNode, SimulatorNode])
def test_in_lock_step_a_second_clock_ends_a_node_in_one_line(
    make_node: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    with ros_context(lock_step="true", controller="pure_pursuit") as executor:
        node = make_node()
        add(executor, node, Source("clock1", ros.CLOCK, ClockMessage))
        add(executor, Source("clock2", ros.CLOCK, ClockMessage))
        assert spin_to_the_end(executor) == 1
    said = [line for line in capfd.readouterr().err.split("\n") if "FATAL" in line]
    assert len(said) == 1
    assert "/clock is published by /clock1 and /" in said[0]
