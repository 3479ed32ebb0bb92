"""Loop of a node that runs its subscriptions and timers without an executor.

For each callback, the executor of rclpy builds a wait set of all services, events, timers and
subscriptions, twice. At 100 messages a second this costs more than the callbacks. This loop waits
for subscriptions, timers and guard conditions only. Services, events and tasks are left to the
executor, which looks for them every SERVICE_PERIOD.
"""

import time
from contextlib import suppress

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from ampc_msgs_config.nodes.failed_callbacks import FailedCallbacks
from ampc_msgs_config.types import NANOSECONDS

SERVICE_PERIOD = 0.1
"""Wall time between two looks for requests of services and for events [s]."""
SERVICES = 100
"""Largest number of callbacks of services and events that run in one look."""
Entity = Timer | Subscription | GuardCondition


class MessageLoop:
    """Runs the callbacks of a node; a callback that raises is counted and logged."""

    def __init__(self, node: Node, failed: FailedCallbacks) -> None:
        """Start to run a node, which no other executor may have.

        Args:
            node: The node.
            failed: Receives the failures.
        """
        self.node, self.failed = node, failed
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(node)
        self.due = time.monotonic()

    def run_next(self, timeout: float) -> None:
        """Run all callbacks that are ready, or wait for one.

        Args:
            timeout: Longest wait [s].

        Raises:
            ExternalShutdownException: The context has been shut down.
            Exception: The callback raised it, see `FailedCallbacks`.
        """
        if time.monotonic() >= self.due:
            self.due = time.monotonic() + SERVICE_PERIOD
            for _ in range(SERVICES):
                if not self.failed.run_next(self.executor, timeout=0.0):
                    break
        timeout = min(timeout, max(self.due - time.monotonic(), 0.0))
        for each in ready_entities(self.node, timeout):
            try:
                execute(self.executor, each)
            except Exception as error:
                self.failed.handle(each, error)


def ready_entities(node: Node, timeout: float) -> list[Entity]:
    """Wait until a timer, subscription or guard condition of a node is ready; return all that are.

    Args:
        node: The node.
        timeout: Longest wait [s].

    Raises:
        ExternalShutdownException: The context has been shut down.

    Note:
        The wait set and the handles are private interfaces of rclpy.
    """
    timers, subscriptions, guards = list(node.timers), list(node.subscriptions), list(node.guards)
    if not (timers or subscriptions or guards):  # an empty wait set is an error
        time.sleep(timeout)
        return []
    context: Context = node.context
    wait_set = rclpy_implementation.WaitSet(
        len(subscriptions), len(guards), len(timers), 0, 0, 0, context.handle
    )
    wait_set.clear_entities()
    for each in timers:
        wait_set.add_timer(each.handle)
    for each in subscriptions:
        wait_set.add_subscription(each.handle)
    for each in guards:
        wait_set.add_guard_condition(each.handle)
    wait_set.wait(round(timeout * NANOSECONDS))
    if not context.ok():
        raise ExternalShutdownException
    kinds = {"timer": timers, "subscription": subscriptions, "guard_condition": guards}
    ready: list[Entity] = []
    for kind, entities in kinds.items():
        pointers = wait_set.get_ready_entities(kind)
        ready += [each for each in entities if each.handle.pointer in pointers]
    return ready


def execute(executor: SingleThreadedExecutor, entity: Entity) -> None:
    """Run the callback of a ready entity, unless another callback has destroyed or cancelled it.

    Raises:
        Exception: The callback raised it.

    Note:
        The functions of the executor that take a message are private interfaces of rclpy.
    """
    if isinstance(entity, GuardCondition):
        callback = executor._take_guard_condition(entity)
    elif isinstance(entity, Subscription):
        callback = executor._take_subscription(entity)
    else:
        callback = executor._take_timer(entity) if is_due(entity) else None
    if callback:
        with suppress(StopIteration):  # the end of the coroutine
            callback().send(None)


def is_due(timer: Timer) -> bool:
    """Return whether a timer exists and is due."""
    try:
        return bool(timer.is_ready())
    except InvalidHandle:
        return False
