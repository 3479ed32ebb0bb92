"""The loop of a node: subscriptions, timers, guard conditions and, now and then, services."""

import math
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.duration import Duration
from rclpy.event_handler import (
    EventHandler,
    QoSSubscriptionEventType,
    SubscriptionEventCallbacks,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import BaseNode
from ampc_msgs_config.nodes.message_loop import MessageLoop, PolledGroup, execute, ready_entities
from tests.ros_nodes import ros_context
from tests.waiting import wait_for

pytestmark = pytest.mark.usefixtures("own_domain")


@pytest.fixture
def node() -> Iterator[BaseNode]:
    """A node without inputs."""
    with ros_context():
        node = BaseNode("tested")
        yield node
        node.destroy_node()


def test_ready_entities_are_those_whose_callback_is_due(node: BaseNode) -> None:
    guard = node.create_guard_condition(lambda: None)
    assert ready_entities(SingleThreadedExecutor(), node, 0.0) == []
    guard.trigger()
    assert ready_entities(SingleThreadedExecutor(), node, 10.0) == [guard]
    timer = node.create_timer(0.001, lambda: None)
    assert ready_entities(SingleThreadedExecutor(), node, 10.0) == [timer]
    timer.cancel()
    subscription = node.create_subscription(Float64, "number", lambda _: None, ros.RELIABLE)
    publisher = node.create_publisher(Float64, "number", ros.RELIABLE)
    wait_for(lambda: publisher.get_subscription_count() > 0)
    publisher.publish(Float64(data=1.0))
    assert ready_entities(SingleThreadedExecutor(), node, 10.0) == [subscription]


def test_execute_leaves_out_what_an_earlier_callback_has_destroyed_or_cancelled(
    node: BaseNode,
) -> None:
    called: list[str] = []
    executor = SingleThreadedExecutor()
    cancelled = node.create_timer(0.001, lambda: called.append("cancelled"))
    destroyed = node.create_timer(0.001, lambda: called.append("destroyed"))
    subscription = node.create_subscription(Float64, "number", called.append, ros.RELIABLE)
    other = node.create_timer(0.001, lambda: called.append("other"))
    wait_for(lambda: len(ready_entities(SingleThreadedExecutor(), node, 1.0)) == 3)
    cancelled.cancel()
    node.destroy_timer(destroyed)
    node.destroy_subscription(subscription)
    for each in (cancelled, destroyed, subscription, other):
        execute(executor, node, each)
    assert called == ["other"]


def test_only_an_urgent_event_ends_a_wait(node: BaseNode) -> None:
    seen: list[str] = []
    events = SubscriptionEventCallbacks(
        deadline=lambda _: seen.append("deadline"), liveliness=lambda _: seen.append("liveliness")
    )
    profile = QoSProfile(depth=1, deadline=Duration(seconds=0.05))
    node.create_subscription(Float64, "number", print, profile, event_callbacks=events)
    publisher = node.create_publisher(Float64, "number", profile)
    wait_for(lambda: publisher.get_subscription_count() > 0)
    publisher.publish(Float64(data=1.0))  # the deadline counts from the first message on
    kind = QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED

    found: list[Any] = []

    def is_found() -> bool:
        ready = ready_entities(SingleThreadedExecutor(), node, 1.0, (kind,))
        found.extend(each for each in ready if isinstance(each, EventHandler))
        return bool(found)

    wait_for(is_found, period=0.0)
    assert {each.event_type for each in found} == {kind}
    assert execute(SingleThreadedExecutor(), node, found[0])
    assert seen == ["deadline"]
    assert not any(
        isinstance(each, EventHandler)
        for each in ready_entities(SingleThreadedExecutor(), node, 0.1)
    )


def test_a_polled_subscription_ends_no_wait_and_is_read_with_all_that_waits(
    node: BaseNode,
) -> None:
    received: list[float] = []

    def receive(message: Float64) -> None:
        received.append(message.data)

    node.create_subscription(
        Float64,
        "number",
        receive,
        ros.RELIABLE,
        callback_group=PolledGroup(),
    )
    publisher = node.create_publisher(Float64, "number", ros.RELIABLE)
    wait_for(lambda: publisher.get_subscription_count() > 0)
    loop, numbers = MessageLoop(node, node.failed), [1.0, 2.0, 3.0]
    for number in numbers:
        publisher.publish(Float64(data=number))
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    assert ready_entities(SingleThreadedExecutor(), node, 0.1) == []

    def has_all() -> bool:
        loop.run_next(timeout=0.01)
        return received == numbers

    wait_for(has_all, period=0.0)


def test_a_burst_of_requests_is_answered_without_a_wait_between_them(node: BaseNode) -> None:
    other, answered = Node("other"), list[int]()
    executor = SingleThreadedExecutor()
    executor.add_node(other)

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        answered.append(loops[0])
        return response

    node.create_service(Trigger, "count", answer)
    client = other.create_client(Trigger, "count")
    loop, loops = MessageLoop(node, node.failed), [0]
    loop.due = math.inf  # the executor looks for nothing
    wait_for(client.service_is_ready)
    futures = [client.call_async(Trigger.Request()) for _ in range(10)]

    def is_answered() -> bool:
        loops[0] += 1
        loop.run_next(timeout=0.05)
        executor.spin_once(timeout_sec=0.0)
        return len(answered) == len(futures)

    wait_for(is_answered, period=0.0)
    other.destroy_node()


def test_services_that_wait_for_a_message_are_answered(node: BaseNode) -> None:
    heard, other = Future(), Node("other")
    executor = SingleThreadedExecutor()
    executor.add_node(other)

    async def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = (await heard).data == 1.0
        return response

    node.create_service(Trigger, "wait", answer)
    client = other.create_client(Trigger, "wait")
    publisher = other.create_publisher(Float64, "number", ros.RELIABLE)
    node.create_subscription(Float64, "number", heard.set_result, ros.RELIABLE)
    loop = MessageLoop(node, node.failed)
    wait_for(lambda: client.service_is_ready() and publisher.get_subscription_count() > 0)
    response = client.call_async(Trigger.Request())

    def is_answered() -> bool:
        loop.run_next(timeout=0.01)
        executor.spin_once(timeout_sec=0.01)
        return bool(response.done())

    for _ in range(20):
        is_answered()
    assert not response.done()
    publisher.publish(Float64(data=1.0))
    wait_for(is_answered, period=0.0)
    assert response.result().success
    other.destroy_node()
