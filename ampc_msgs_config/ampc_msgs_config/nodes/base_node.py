"""What our nodes share: parameters with ranges, a report of their health, and a clean end."""

import gc
import signal
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.time_source import USE_SIM_TIME_NAME

from ampc_msgs_config import ros
from ampc_msgs_config.compiled import log_compilation
from ampc_msgs_config.types import OK, WARN, VehicleState

NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
"""The executor looks at each event of each publisher at every turn: costs more than a tick."""
AT_REST = VehicleState(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
FLUSH_TIMEOUT = 4.0
"""Wall time for the last words of a node; the middleware looks for gaps every 3 s [s]."""
SHUTDOWN_TIMEOUT = 0.5
"""The same where nobody said that a recorder listens [s]."""


class BaseNode(Node):
    """A node that reports its health, and that can wait until a recorder listens."""

    def __init__(self, name: str, *, owns_time: bool = False) -> None:
        """Join the graph.

        Args:
            name: Of the node.
            owns_time: In lock-step this node makes the time, which all others follow.
        """
        super().__init__(name)
        ros.vehicle_state(ros.odometry_message(AT_REST))  # compiles
        self.lock_step: bool = declare(
            self, "lock_step", False, "simulated time advances only when every state is answered"
        )
        if self.lock_step and not owns_time:
            self.set_parameters([Parameter(USE_SIM_TIME_NAME, value=True)])
        self.wait_for_recorder: bool = declare(
            self, "wait_for_recorder", False, "drive only when a recorder listens to this node"
        )
        self.is_recorded = False
        self.trouble = ""
        self.rejected = 0
        self.diagnostics = self.create_publisher(
            DiagnosticArray, ros.DIAGNOSTICS, ros.RELIABLE, event_callbacks=NO_EVENTS
        )

    @property
    def now_ns(self) -> int:
        """Time of the node's clock [ns]; 0 while simulated time has not begun."""
        return int(self.get_clock().now().nanoseconds)

    def unrecorded(self) -> list[str]:
        """Give the topics of this node for which it still waits for a recorder."""
        if not self.wait_for_recorder:
            return []
        topics = {each.topic_name for each in self.publishers} - {ros.PARAMETER_EVENTS}
        missing = [topic for topic in sorted(topics) if not self._hears(topic)]
        self.wait_for_recorder, self.is_recorded = bool(missing), not missing
        return missing

    def _hears(self, topic: str) -> bool:
        listeners = self.get_subscriptions_info_by_topic(topic)
        return any(listener.node_name == "recorder" for listener in listeners)

    def publish_final(self) -> None:
        """Publish what others need when this node ends."""

    def flush(self) -> None:
        """Wait until all have the last words; the recorder, where it was waited for, longer."""
        until = time.monotonic() + (FLUSH_TIMEOUT if self.is_recorded else SHUTDOWN_TIMEOUT)
        for publisher in self.publishers:
            rest = max(until - time.monotonic(), 0.0)
            publisher.wait_for_all_acked(Duration(seconds=rest))

    def reject(self, error: ValueError) -> None:
        """Count and report an input that is not used."""
        self.rejected += 1
        self.trouble = str(error)
        self.get_logger().error(str(error), throttle_duration_sec=1.0)

    def report(
        self, stamp_ns: int, lasting: str, values: Mapping[str, float], level: int = WARN
    ) -> None:
        """Publish the health since the last report: OK, or the trouble in words, lasting first.

        Args:
            stamp_ns: Time of the report [ns].
            lasting: Trouble that goes on, in one sentence; empty: none.
            values: Numbers to tell.
            level: Of the lasting trouble; what came and went since the last report is a WARN.
        """
        if self.wait_for_recorder:
            lasting, level = "waiting for a recorder that listens to this node", WARN
        passing, self.trouble = self.trouble, ""
        trouble = "; ".join(filter(None, (lasting, passing)))
        level = max(level if lasting else OK, WARN if passing else OK)
        values = {**values, "rejected_inputs": self.rejected}
        status = DiagnosticStatus(
            level=bytes([level]),
            name=self.get_fully_qualified_name(),
            message=trouble or "OK",
            values=[KeyValue(key=key, value=f"{value:.6g}") for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = ros.time_message(stamp_ns)
        self.diagnostics.publish(message)


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    allowed: Any = None,
    *,
    at_run_time: bool = False,
) -> Any:
    """Declare a parameter with its description and range, and give its value.

    Args:
        node: Owner.
        name: Of the parameter.
        default: Value, which sets the type.
        description: For `ros2 param describe`.
        allowed: (low, high) of a number, or a list of words.
        at_run_time: It may be changed while the node runs.

    Raises:
        ValueError: The word is not one of them.
        ParameterException: The value has another type, or leaves the range.
    """
    descriptor = ParameterDescriptor(description=description, read_only=not at_run_time)
    if isinstance(allowed, list):
        descriptor.additional_constraints = "one of: " + ", ".join(allowed)
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
    """Run one node until it ends itself, or is told to; gives the exit code of the process.

    A set-up that is wrong ends in one line on stderr and exit code 2. Signals are handled here:
    rclpy would end the middleware before the last words are delivered. A set-up, which may compile
    for long, is interrupted; a node that runs ends after the callback it is in, as an exception at
    any place of it would not always arrive as one.
    """
    signals: list[int] = []
    begun: list[BaseNode] = []

    def on_signal(number: int, _: Any) -> None:
        signals.append(number)
        if not begun and len(signals) == 1:
            raise KeyboardInterrupt  # which compiling may swallow

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    try:
        _init()
        begun.append(_made(make_node))
        return _spin(begun[0], signals)
    except KeyboardInterrupt:
        return 0
    except (ValueError, ParameterException) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr, flush=True)
        return 2
    finally:
        rclpy.try_shutdown()


def _init() -> None:
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise ValueError(error) from error


def _made(make_node: Callable[[], BaseNode]) -> BaseNode:
    """Make a node, and say so where it has to compile: the class `PlannerNode` is the planner."""
    name = getattr(make_node, "__name__", "node").removesuffix("Node").lower()
    with log_compilation(name, get_logger(name).info):
        return make_node()


def _spin(node: BaseNode, signals: list[int]) -> int:
    """Run a node until a signal comes; gives the exit code that it ends itself with, or 0."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    gc.collect()
    gc.freeze()  # what lives now lives on: a full collection would only delay a tick
    try:
        while not signals:
            executor.spin_once(timeout_sec=0.1)
        return 0
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        node.publish_final()
        node.flush()
        node.destroy_node()
