"""A node that manages a controller by its services, and publishes a drive along a circle."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.nodes.controller_node import ControllerNode
from tests.ros_nodes import add, spin_until
from tests.waiting import SCALE

CIRCLE = np.array([(30.0 * np.sin(a), 30.0 - 30.0 * np.cos(a)) for a in np.arange(0.0, 5.6, 0.05)])
STATE_PERIOD = 0.01
"""Wall time from one state to the next [s]: one after the other would leave no time to others."""
LOST_ANSWER = 15.0 * SCALE
"""Wall time after which a service is called again [s]."""
OURS = {f"/{ros.STEERING_COMMAND}", f"/{ros.STOP_REQUEST}", f"/{ros.TICK}"}


class Driver(Node):
    """Manages a controller by its services, publishes a drive, and stores the output."""

    node: ControllerNode

    def __init__(self, executor: SingleThreadedExecutor, *nodes: ControllerNode) -> None:
        """Create publishers, subscriptions and clients.

        Args:
            executor: Executor of all nodes of the test.
            nodes: The controller where it runs in this process.
        """
        super().__init__("driver")
        self.executor_of_all = executor
        for self.node in nodes:
            add(executor, self.node)
        self.commands: list[JointState] = []
        self.stops: list[bool] = []
        self.config: list[str] = []
        self.first_ns = self.now_ns
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        self.create_subscription(
            JointState, ros.STEERING_COMMAND, self.commands.append, ros.COMMAND
        )
        self.create_subscription(Bool, ros.STOP_REQUEST, self.on_stop, ros.LATCHED)
        self.create_subscription(
            String, "controller/configuration", self.on_configuration, ros.LATCHED
        )
        self.paths.publish(ros.path_message(CIRCLE, self.first_ns))
        self.changing = self.create_client(ChangeState, "controller/change_state")
        self.asking = self.create_client(GetState, "controller/get_state")
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.states = self.create_timer(STATE_PERIOD, self.drive, clock=steady)
        self.states.cancel()
        add(executor, self)

    @property
    def now_ns(self) -> int:
        """Time of the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def on_stop(self, message: Bool) -> None:
        """Store a request to stop."""
        self.stops.append(message.data)

    def on_configuration(self, message: String) -> None:
        """Store a configuration."""
        self.config.append(message.data)

    def answer(self, client: Any, request: Any, *, driving: bool = False) -> Any:
        """Call a service and return its response; the car drives on meanwhile where that is asked.

        A node that has not discovered the client yet drops its response. After some time the
        service is called again, by a new client.
        """
        spin_until(self.executor_of_all, client.service_is_ready)
        futures = [client.call_async(request)]
        until = time.monotonic() + LOST_ANSWER

        def is_answered() -> bool:
            nonlocal until
            if time.monotonic() > until:
                anew = self.create_client(client.srv_type, client.srv_name)
                futures.append(anew.call_async(request))
                until += LOST_ANSWER
            return any(future.done() for future in futures)

        with self.driving() if driving else nullcontext():
            spin_until(self.executor_of_all, is_answered)
        return next(future.result() for future in futures if future.done())

    def change(self, transition: int) -> bool:
        """Request a transition; return whether it succeeded."""
        self.state()  # once that is answered, the node has discovered the other client, too
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.answer(self.changing, request).success)

    def state(self) -> str:
        """Return the state of the controller."""
        return str(self.answer(self.asking, GetState.Request()).current_state.label)

    def drive(self) -> VehicleState:
        """Publish the state on the circle at this time of the test, at 9 m/s."""
        s = 9.0 * (self.now_ns - self.first_ns) / NANOSECONDS % 160.0
        x, y, yaw = 30.0 * np.sin(s / 30.0), 30.0 - 30.0 * np.cos(s / 30.0), s / 30.0
        state = VehicleState(self.now_ns, float(x), float(y), float(yaw), 9.0, 0.0, 0.3)
        self.odom.publish(ros.odometry_message(state))
        return state

    @contextmanager
    def driving(self) -> Iterator[None]:
        """Publish states meanwhile, the first one at once."""
        self.drive()
        self.states.reset()
        try:
            yield
        finally:
            self.states.cancel()

    def drive_until(self, condition: Callable[[], bool]) -> None:
        """Publish states until a condition holds."""
        with self.driving():
            spin_until(self.executor_of_all, condition)

    def drive_for(self, commands: int) -> list[float]:
        """Publish states until that many more commands have arrived; return their angles [rad]."""
        known = len(self.commands)
        self.drive_until(lambda: len(self.commands) >= known + commands)
        return [message.position[0] for message in self.commands[known:]]

    def topics(self) -> set[str]:
        """Return those of `OURS` on which the controller publishes."""
        return {each.topic_name for each in self.node.publishers} & OURS


def largest_step(angles: list[float]) -> float:
    """Return the largest change from one command to the next [rad]."""
    return float(np.abs(np.diff(angles)).max())


def set_parameter(node: ControllerNode, name: str, value: Any) -> None:
    """Set a parameter as a service call does, and check that this succeeds."""
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert result.successful, result.reason
