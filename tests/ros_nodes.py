"""Nodes inside a test: one context, one executor, and waits that end."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

PATIENCE = 60.0
"""Wall time after which a wait has failed [s]."""


@contextmanager
def ros_context(*arguments: str, **parameters: object) -> Iterator[SingleThreadedExecutor]:
    """Join ROS; gives the executor of the nodes, which are destroyed in the end.

    Args:
        arguments: Further ROS arguments, such as `-r` and `__ns:=/car`.
        parameters: Of all nodes.
    """
    given = [text for key, value in parameters.items() for text in ("-p", f"{key}:={value}")]
    rclpy.init(args=["--ros-args", *given, *arguments])
    executor = SingleThreadedExecutor()
    try:
        yield executor
    finally:
        for node in executor.get_nodes():
            node.destroy_node()
        rclpy.shutdown()


def add(executor: SingleThreadedExecutor, *nodes: Node) -> None:
    """Let nodes live in an executor."""
    for node in nodes:
        executor.add_node(node)


def spin_until(executor: SingleThreadedExecutor, condition: Callable[[], bool]) -> None:
    """Run the nodes until a condition holds, or one of them ends its process."""
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        executor.spin_once(timeout_sec=0.05)


def spin_to_the_end(executor: SingleThreadedExecutor) -> int:
    """Run the nodes until one ends its process; gives the exit code."""
    with pytest.raises(SystemExit) as end:
        spin_until(executor, lambda: False)
    return int(end.value.code or 0)
