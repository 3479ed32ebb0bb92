"""Base of the nodes: parameters with ranges, diagnostics, and an orderly shutdown."""

import gc
import sys
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
)
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.time_source import USE_SIM_TIME_NAME

from ampc_msgs_config import ros, topics
from ampc_msgs_config.nodes import qos
from ampc_msgs_config.nodes.failed_callbacks import FailedCallbacks, describe_error, shortened
from ampc_msgs_config.nodes.message_loop import MessageLoop
from ampc_msgs_config.signals import cancel_interruption, handle_ending_signals, interrupt
from ampc_msgs_config.types import OK, WARN

NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
"""The executor would poll each event callback in every round, which costs more than a tick."""
FLUSH_TIMEOUT = 4.0
"""Wall time for the final messages of a node; the middleware resends lost ones every 3 s [s]."""
SHUTDOWN_TIMEOUT = 0.5
"""The same without a recorder [s]."""


class BaseNode(Node):
    """A node that publishes diagnostics, and that can wait for a recorder."""

    has_compiled_code = True
    """False: the process of this node never imports numba."""
    urgent_events: Collection[int] = ()
    """Types of QoS events to which the node reacts at once; each costs time with each message."""

    def __init__(self, name: str, *, owns_time: bool = False) -> None:
        """Create the node.

        Args:
            name: Name of the node.
            owns_time: In lock-step this node publishes the clock that all others follow.
        """
        super().__init__(name)
        self.lock_step: bool = declare(
            self, "lock_step", False, "simulated time advances only when every state is answered"
        )
        if self.lock_step and not owns_time:
            self.set_parameters([Parameter(USE_SIM_TIME_NAME, value=True)])
        fix_use_sim_time(self)
        self.wait_for_recorder: bool = declare(
            self,
            "wait_for_recorder",
            False,
            "drive only after a recorder has subscribed to this node",
        )
        self.is_recorded = False
        self.trouble = ""
        self.rejected = 0
        self.failed = FailedCallbacks(self.get_logger(), ends_stream=self.lock_step)
        self.diagnostics = self.create_publisher(
            DiagnosticArray, topics.DIAGNOSTICS, qos.RELIABLE, event_callbacks=NO_EVENTS
        )

    @property
    def now_ns(self) -> int:
        """Time of the node's clock [ns]; 0 before simulated time has started."""
        return int(self.get_clock().now().nanoseconds)

    def unrecorded(self) -> list[str]:
        """Return the topics of this node that the awaited recorder has not subscribed to."""
        if not self.wait_for_recorder:
            return []
        derived = map(self.resolve_topic_name, topics.QUANTITIES)  # by the recorder
        published = {each.topic_name for each in self.publishers}
        published -= {topics.PARAMETER_EVENTS, *derived}
        missing = []
        for topic in sorted(published):
            subscribers = self.get_subscriptions_info_by_topic(topic)
            names = {(each.node_name, each.node_namespace) for each in subscribers}
            if ("recorder", self.get_namespace()) not in names:
                missing.append(topic)
        self.wait_for_recorder, self.is_recorded = bool(missing), not missing
        return missing

    def publish_final(self) -> None:
        """Publish the final messages of this node."""

    def flush(self) -> None:
        """Wait until all subscribers have the final messages; longer with a recorder."""
        until = time.monotonic() + (FLUSH_TIMEOUT if self.is_recorded else SHUTDOWN_TIMEOUT)
        for publisher in self.publishers:
            rest = max(until - time.monotonic(), 0.0)
            publisher.wait_for_all_acked(Duration(seconds=rest))

    def reject(self, error: ValueError) -> None:
        """Count and log an input that is not used."""
        self.rejected += 1
        self.trouble = shortened(str(error))
        self.get_logger().error(self.trouble, throttle_duration_sec=1.0)

    def report(
        self, stamp_ns: int, lasting: str, values: Mapping[str, float], level: int = WARN
    ) -> None:
        """Publish diagnostics: OK, or the current problem and those since the last report.

        Args:
            stamp_ns: Time of the report [ns].
            lasting: Problem that persists, in one sentence; empty: none.
            values: Numbers by name.
            level: Level of the lasting problem; a problem that has passed is a WARN.
        """
        if self.wait_for_recorder:
            lasting, level = "waiting for a recorder that subscribes to this node", WARN
        passing = "; ".join(filter(None, (self.trouble, self.failed.take_newest())))
        self.trouble = ""
        trouble = shortened("; ".join(filter(None, (lasting, passing))))
        level = max(level if lasting else OK, WARN if passing else OK)
        values = {**values, "rejected_inputs": self.rejected}
        if self.failed.count:
            values["failed_callbacks"] = self.failed.count
        status = DiagnosticStatus(
            level=bytes([level]),
            name=self.get_fully_qualified_name(),
            message=trouble or "OK",
            values=[KeyValue(key=key, value=f"{value:.6g}") for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = ros.time_message(stamp_ns)
        self.diagnostics.publish(message)


def log_compilation_of(
    make_node: Callable[[], BaseNode], name: str
) -> AbstractContextManager[None]:
    """Log what the constructor of a node compiles, if it compiles at all."""
    if not getattr(make_node, "has_compiled_code", True):
        return nullcontext()
    from ampc_msgs_config.compilation import log_compilation  # imports numba

    return log_compilation(name, get_logger(name).info)


def fix_use_sim_time(node: Node) -> None:
    """Reject changes of `use_sim_time`: a running drive would lose its clock."""
    descriptor = ParameterDescriptor(
        type=ParameterType.PARAMETER_BOOL,
        description="follow /clock; fixed at the start, as timers and stamps depend on it",
        read_only=True,
    )
    node.set_descriptor(USE_SIM_TIME_NAME, descriptor)


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    allowed: Any = None,
    *,
    at_run_time: bool = False,
) -> Any:
    """Declare a parameter with its description and range, and return its value.

    Args:
        node: Node that gets the parameter.
        name: Name of the parameter.
        default: Default value; it defines the type.
        description: Text for `ros2 param describe`.
        allowed: (low, high) of a number, a list of words, or a description of the texts.
        at_run_time: Whether the parameter may be changed while the node runs.

    Raises:
        ValueError: The word is not in the list.
        ParameterException: The value has another type, or is out of range.
    """
    descriptor = ParameterDescriptor(description=description, read_only=not at_run_time)
    if isinstance(allowed, list):
        descriptor.additional_constraints = "one of: " + ", ".join(allowed)
    elif isinstance(allowed, str):
        descriptor.additional_constraints = allowed
    elif isinstance(default, float):
        low, high = map(float, allowed)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif allowed:
        low, high = allowed
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
    value = node.declare_parameter(name, default, descriptor).value
    if isinstance(allowed, list) and value not in allowed:
        raise ValueError(f"parameter {name} = {value!r} must be one of {', '.join(allowed)}")
    return value


def spin(make_node: Callable[[], BaseNode]) -> int:
    """Run one node until it ends itself or a signal arrives; return the exit code of the process.

    A wrong configuration gives one line on stderr and exit code 2; so does a ValueError in
    lock-step, and any other exception there exit code 1. In real time no exception ends the node.

    Note:
        Own signal handlers are used, because those of rclpy shut the middleware down before the
        final messages are delivered. A signal interrupts the constructor, which may compile for
        long. A running node ends after its current callback, because an exception raised inside
        compiled code or the middleware is not always passed on.
    """
    signals: list[int] = []
    created: list[BaseNode] = []

    def on_signal(number: int, frame: Any) -> None:
        signals.append(number)
        if not created and len(signals) == 1:
            interrupt(frame)

    name = getattr(make_node, "__name__", "node").removesuffix("Node").lower()
    try:
        handle_ending_signals(on_signal)
        try:
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:
            raise ValueError(error) from error
        with log_compilation_of(make_node, name):
            created.append(make_node())
            cancel_interruption()
        return _spin(created[0], signals)
    except KeyboardInterrupt:
        return 0
    except (ValueError, OSError, ParameterException) as error:
        print(f"error: {shortened(str(error))}", file=sys.stderr, flush=True)
        return 2
    finally:
        rclpy.try_shutdown()


def _spin(node: BaseNode, signals: list[int]) -> int:
    """Run a node until a signal arrives; return the exit code with which it ends itself, or 0.

    Raises:
        ValueError: A callback raised it in lock-step.
    """
    loop = MessageLoop(node, node.failed, node.urgent_events)
    gc.collect()
    gc.freeze()  # a full collection of these objects would delay a tick for nothing
    try:
        while not signals:
            loop.run_next(timeout=0.1)
        return 0
    except ExternalShutdownException:
        return 0
    except SystemExit as end:
        return int(end.code or 0)
    except ValueError:
        raise
    except Exception as error:
        print(f"error: {describe_error(error)}", file=sys.stderr, flush=True)
        return 1
    finally:
        node.publish_final()
        node.flush()
        node.destroy_node()
