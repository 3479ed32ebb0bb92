"""Nodes inside a test: one context, one executor, and waits with a timeout."""

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from tests.waiting import TIMEOUT


@contextmanager
def ros_context(*arguments: str, **parameters: object) -> Iterator[SingleThreadedExecutor]:
    """Join ROS; yield the executor of the nodes, which are destroyed at the end.

    Nodes refer to themselves. Until they are collected, nodes of earlier tests stay visible.

    Args:
        arguments: Further ROS arguments, such as `-r` and `__ns:=/car`.
        parameters: Parameters of all nodes.
    """
    texts = [text for key, value in parameters.items() for text in ("-p", f"{key}:={value}")]
    gc.collect()
    rclpy.init(args=["--ros-args", *texts, *arguments])
    executor = SingleThreadedExecutor()
    try:
        yield executor
    finally:
        for node in executor.get_nodes():
            node.destroy_node()
        rclpy.shutdown()


def add(executor: SingleThreadedExecutor, *nodes: Node) -> None:
    """Add nodes to an executor."""
    for node in nodes:
        executor.add_node(node)


def spin_until(executor: SingleThreadedExecutor, condition: Callable[[], bool]) -> None:
    """Run the nodes until a condition holds, or one of them ends its process."""
    limit = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < limit, f"the condition does not hold after {TIMEOUT:g} s"
        executor.spin_once(timeout_sec=0.05)


def connect(executor: SingleThreadedExecutor, one: Node, other: Node) -> None:
    """Run two nodes until each publisher of one is matched with the subscription of the other."""

    def is_connected() -> bool:
        for source, sink in ((one, other), (other, one)):
            topics = {each.topic_name for each in sink.subscriptions}
            publishers = [each for each in source.publishers if each.topic_name in topics]
            if not all(each.get_subscription_count() for each in publishers):
                return False
        return True

    spin_until(executor, is_connected)


def spin_to_the_end(executor: SingleThreadedExecutor) -> int:
    """Run the nodes until one ends its process; return the exit code."""
    with pytest.raises(SystemExit) as end:
        spin_until(executor, lambda: False)
    return int(end.value.code or 0)
