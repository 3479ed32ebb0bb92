"""Loop of a node that runs its subscriptions and timers without an executor.

For each callback, the executor of rclpy builds a wait set of all services, events, timers and
subscriptions, twice. At 100 messages a second this costs more than the callbacks. This loop waits
for subscriptions, timers, guard conditions, services and the urgent events of the node. Other
events, and services that await something, are left to the executor, which looks for them every
TASK_PERIOD; so are subscriptions in a `PolledGroup`, whose messages end no wait.
"""

import time
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.event_handler import EventHandler
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from ampc_msgs_config.nodes.failed_callbacks import FailedCallbacks, release
from ampc_msgs_config.types import NANOSECONDS

TASK_PERIOD = 0.1
"""Wall time between two looks for events, and for what services await [s]."""
MOST_CALLBACKS = 100
"""Largest number of callbacks of one kind that run in one look."""
Entity = Timer | Subscription | GuardCondition | Service | EventHandler


class PolledGroup(MutuallyExclusiveCallbackGroup):
    """Callback group of subscriptions that a `MessageLoop` reads every TASK_PERIOD."""


class MessageLoop:
    """Runs the callbacks of a node; a callback that raises is counted and logged."""

    def __init__(self, node: Node, failed: FailedCallbacks, urgent: Collection[int] = ()) -> None:
        """Start to run a node, which no other executor may have.

        Args:
            node: The node.
            failed: Receives the failures.
            urgent: Types of QoS events that end a wait.
        """
        self.node, self.failed, self.urgent = node, failed, urgent
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
            self.due = time.monotonic() + TASK_PERIOD
            for subscription in filter(is_polled, list(self.node.subscriptions)):
                repeat(partial(self.execute, subscription))
            repeat(partial(self.failed.run_next, self.executor, timeout=0.0))
        timeout = min(timeout, max(self.due - time.monotonic(), 0.0))
        for each in ready_entities(self.executor, self.node, timeout, self.urgent):
            self.execute(each)

    def execute(self, entity: Entity) -> bool:
        """Run the callback of an entity; return whether there was a message, or it was due."""
        try:
            return execute(self.executor, self.node, entity)
        except Exception as error:
            self.failed.handle(entity, error)
            return True


def is_polled(subscription: Subscription) -> bool:
    """Return whether the messages of a subscription end no wait."""
    return isinstance(subscription.callback_group, PolledGroup)


def repeat(action: Callable[[], bool]) -> None:
    """Repeat an action until it returns False, at most MOST_CALLBACKS times."""
    for _ in range(MOST_CALLBACKS):
        if not action():
            return


def ready_entities(
    executor: SingleThreadedExecutor, node: Node, timeout: float, urgent: Collection[int] = ()
) -> list[Entity]:
    """Wait until a timer, subscription, guard, service or event of a node is ready; return all.

    Args:
        executor: Executor of the node, which knows the services that still await something.
        node: The node.
        timeout: Longest wait [s].
        urgent: Types of QoS events that end the wait.

    Raises:
        ExternalShutdownException: The context has been shut down.

    Note:
        The wait set and the handles are private interfaces of rclpy.
    """
    timers, guards = list(node.timers), list(node.guards)
    subscriptions = [each for each in node.subscriptions if not is_polled(each)]
    services = list(filter(executor.can_execute, node.services))
    events: list[Any] = [
        each for each in node.waitables if getattr(each, "event_type", None) in urgent
    ]
    if not (timers or subscriptions or guards or services or events):
        time.sleep(timeout)  # an empty wait set is an error
        return []
    context: Context = node.context
    wait_set = rclpy_implementation.WaitSet(
        len(subscriptions),
        len(guards),
        len(timers),
        0,
        len(services),
        len(events),
        context.handle,
    )
    wait_set.clear_entities()
    for timer in timers:
        wait_set.add_timer(timer.handle)
    for subscription in subscriptions:
        wait_set.add_subscription(subscription.handle)
    for guard in guards:
        wait_set.add_guard_condition(guard.handle)
    for service in services:
        wait_set.add_service(service.handle)
    for event in events:
        event.add_to_wait_set(wait_set)
    wait_set.wait(round(timeout * NANOSECONDS))
    if not context.ok():
        raise ExternalShutdownException
    kinds: dict[str, Sequence[Any]]
    kinds = {"timer": timers, "subscription": subscriptions, "guard_condition": guards}
    kinds["service"] = services
    ready: list[Entity] = []
    for kind, entities in kinds.items():
        pointers = wait_set.get_ready_entities(kind)
        ready += [each for each in entities if each.handle.pointer in pointers]
    return ready + [event for event in events if event.is_ready(wait_set)]


def execute(executor: SingleThreadedExecutor, node: Node, entity: Entity) -> bool:
    """Run the callback of an entity that has a message or is due; return whether it has, or is.

    Another callback may have destroyed or cancelled it.

    Raises:
        Exception: The callback raised it.

    Note:
        The functions of the executor that take a message are private interfaces of rclpy.
    """
    if isinstance(entity, Service):
        task = executor._make_handler(entity, node, executor._take_service)
        task()
        if error := task.exception():
            release(entity)
            raise error
        return True
    if isinstance(entity, GuardCondition):
        callback = executor._take_guard_condition(entity)
    elif isinstance(entity, Subscription):
        callback = executor._take_subscription(entity)
    elif isinstance(entity, EventHandler):
        callback = executor._take_waitable(entity)
    else:
        callback = executor._take_timer(entity) if is_due(entity) else None
    if callback:
        with suppress(StopIteration):  # the end of the coroutine
            callback().send(None)
    return callback is not None


def take_message(subscription: Subscription) -> tuple[Any, dict[str, int]] | None:
    """Return the next message of a subscription with its info, or None.

    Note:
        `handle.take_message` is a private interface of rclpy.
    """
    taken: tuple[Any, dict[str, int]] | None
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return taken


def is_due(timer: Timer) -> bool:
    """Return whether a timer exists and is due."""
    try:
        return bool(timer.is_ready())
    except InvalidHandle:
        return False
