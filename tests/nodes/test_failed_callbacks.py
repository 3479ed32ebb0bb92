"""Callbacks that raise: every node logs the cause once, counts it and continues."""

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from ampc_msgs_config.nodes import base_node
from ampc_msgs_config.nodes.base_node import BaseNode
from ampc_msgs_config.nodes.failed_callbacks import LONGEST_TEXT, describe_error, shortened
from ampc_msgs_config.nodes.marker_node import MarkerNode
from ampc_msgs_config.nodes.message_loop import MessageLoop
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from launch_scripts.nodes.injector_node import InjectorNode
from sim_vehicle.nodes.simulator_node import SimulatorNode
from tests.driver_of_nodes import Driver
from tests.ros_nodes import ros_context, spin_until
from tests.waiting import wait_for

pytestmark = pytest.mark.usefixtures("own_domain")

NODES: list[Callable[[], Any]] = [
    ControllerNode,
    PlannerNode,
    SimulatorNode,
    MarkerNode,
    InjectorNode,
]


class Other(Node):
    """A node in an executor of its own, so that only the callbacks under test run elsewhere."""

    def __init__(self) -> None:
        """Create the node."""
        super().__init__("other")
        self.executor_of_other = SingleThreadedExecutor()
        self.executor_of_other.add_node(self)
        self.loop: MessageLoop | None = None

    def until(self, node: BaseNode, condition: Callable[[], bool]) -> None:
        """Run both nodes, the tested one as its process does, until a condition holds."""
        loop = self.loop = self.loop or MessageLoop(node, node.failed)

        def holds() -> bool:
            loop.run_next(timeout=0.01)
            self.executor_of_other.spin_once(timeout_sec=0.01)
            return condition()

        wait_for(holds, period=0.0)


@pytest.mark.parametrize("make_node", NODES)
def test_a_parameter_of_an_unknown_type_ends_no_node(
    make_node: Callable[[], Any], capfd: pytest.CaptureFixture[str]
) -> None:
    with ros_context(controller="pure_pursuit", static_path="true"):
        node, other = make_node(), Other()
        name = node.get_name()
        wrong = Parameter(name="lock_step", value=ParameterValue(type=99))
        for kind, service in (
            (SetParameters, "set_parameters"),
            (SetParametersAtomically, "set_parameters_atomically"),
        ):
            client = other.create_client(kind, f"{name}/{service}")
            other.until(node, client.service_is_ready)
            failures = node.failed.count
            client.call_async(kind.Request(parameters=[wrong]))
            other.until(node, lambda before=failures: node.failed.count > before)  # type: ignore[misc]
        client = other.create_client(GetParameters, f"{name}/get_parameters")
        other.until(node, client.service_is_ready)
        answer = client.call_async(GetParameters.Request(names=["lock_step"]))
        other.until(node, answer.done)
        assert [value.bool_value for value in answer.result().values] == [False]
        node.destroy_node()
        other.destroy_node()
    said = capfd.readouterr().err
    assert said.count("99 is not a valid Parameter.Type") == 1


def test_one_cause_is_logged_once_and_every_failure_is_counted(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with ros_context():
        node, other = BaseNode("failing"), Other()
        reports: list[Any] = []
        other.create_subscription(
            DiagnosticArray, ros.DIAGNOSTICS, partial(store_reports, reports), ros.RELIABLE
        )
        causes = iter([ValueError("first"), KeyError("second"), ValueError("third")] * 2)
        node.create_timer(0.01, lambda: fail(next(causes, RuntimeError("later"))))
        other.until(node, lambda: node.failed.count >= 6)
        other.until(node, lambda: bool(node.diagnostics.get_subscription_count()))
        node.report(0, "", {})
        other.until(node, lambda: bool(reports))
        node.destroy_node()
        other.destroy_node()
    values = {each.key: each.value for each in reports[0].values}
    assert int(values["failed_callbacks"]) >= 6
    assert "a callback failed: " in reports[0].message
    said = capfd.readouterr().err
    assert (said.count("ValueError: first"), said.count("third")) == (1, 0)
    assert said.count("KeyError: 'second' (test_failed_callbacks.py:") == 1


def store_reports(reports: list[Any], message: DiagnosticArray) -> None:
    """Store the reports of a message."""
    reports.extend(message.status)


def store_data(values: list[Any], message: Any) -> None:
    """Store the value of a message."""
    values.append(message.data)


def fail(error: Exception) -> None:
    """Raise an error."""
    raise error


def test_a_message_that_cannot_be_decoded_does_not_silence_its_topic() -> None:
    with ros_context():
        node, other = BaseNode("failing"), Other()
        texts: list[str] = []
        node.create_subscription(String, "text", partial(store_data, texts), ros.RELIABLE)
        publisher = other.create_publisher(String, "text", ros.RELIABLE)
        other.until(node, lambda: bool(publisher.get_subscription_count()))
        assert other.loop
        executor: Any = other.loop.executor
        take = executor._take_subscription
        executor._take_subscription = lambda _: fail(RuntimeError("cannot be decoded"))
        publisher.publish(String(data="broken"))
        while not node.failed.count:
            other.loop.run_next(timeout=0.01)
        executor._take_subscription = take
        publisher.publish(String(data="sound"))
        while "sound" not in texts:
            other.loop.run_next(timeout=0.01)
        node.destroy_node()
        other.destroy_node()


def test_a_service_that_fails_while_it_waits_ends_no_node() -> None:
    with ros_context():
        node, other = BaseNode("failing"), Other()
        gate = Future()

        async def answer(_: Any, response: Any) -> Any:
            await gate
            raise OSError("gone")

        node.create_service(Trigger, "wait", answer, callback_group=ReentrantCallbackGroup())
        client = other.create_client(Trigger, "wait")
        other.until(node, client.service_is_ready)
        client.call_async(Trigger.Request())
        numbers: list[float] = []
        node.create_subscription(Float64, "number", partial(store_data, numbers), ros.RELIABLE)
        publisher = other.create_publisher(Float64, "number", ros.RELIABLE)
        other.until(node, lambda: bool(publisher.get_subscription_count()))
        publisher.publish(Float64(data=1.0))
        other.until(node, lambda: len(numbers) == 1)
        gate.set_result(None)
        other.until(node, lambda: node.failed.count == 1)
        publisher.publish(Float64(data=2.0))
        other.until(node, lambda: len(numbers) == 2)
        node.destroy_node()
        other.destroy_node()


def test_in_lock_step_a_failing_callback_ends_the_node_with_one_line_and_a_failing_service_not(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with ros_context(lock_step="true"):
        node, other = BaseNode("failing", owns_time=True), Other()
        node.create_service(Trigger, "fails", lambda *_: fail(RuntimeError("service")))
        client = other.create_client(Trigger, "fails")
        other.until(node, client.service_is_ready)
        client.call_async(Trigger.Request())
        other.until(node, lambda: node.failed.count == 1)
        capfd.readouterr()
        node.create_timer(0.01, lambda: fail(RuntimeError("in two\nlines")))
        assert base_node._spin(node, []) == 1
        other.destroy_node()
    said = capfd.readouterr()
    assert said.err.startswith("error: RuntimeError: in two lines (test_failed_callbacks.py:")
    assert said.err.count("\n") == 1


def test_system_exit_of_a_callback_still_ends_the_node_with_its_code() -> None:
    with ros_context():
        node = BaseNode("ending")

        def end() -> None:
            raise SystemExit(7)

        node.create_timer(0.01, end)
        assert base_node._spin(node, []) == 7


@pytest.mark.parametrize("text", ["x" * 10_000, "x " * 10_000, "\n" * 10_000, "ordinary text"])
def test_a_logged_text_is_one_short_line(text: str) -> None:
    line = shortened(text)
    assert len(line) <= LONGEST_TEXT
    assert "\n" not in line
    assert line[:3] == text.strip()[:3]
    assert "\n" not in describe_error(ValueError(text))


def test_a_frame_of_ten_kilobytes_is_shortened_in_log_and_diagnostics(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        reports: list[Any] = []
        driver.create_subscription(
            DiagnosticArray, ros.DIAGNOSTICS, partial(store_reports, reports), ros.RELIABLE
        )
        driver.drive_for(1)
        odom: Odometry = ros.odometry_message(driver.drive())
        odom.header.frame_id = "m" * 10_000
        known = len(reports)
        driver.odom.publish(odom)
        spin_until(executor, lambda: any("mmm" in each.message for each in reports[known:]))
    assert max(len(each.message) for each in reports) <= LONGEST_TEXT
    assert max(map(len, capfd.readouterr().err.splitlines())) <= LONGEST_TEXT + 200
