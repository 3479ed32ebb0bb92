"""Publishers of the controller: command, tick record, configuration, request to stop."""

from collections.abc import Sequence
from functools import partial

from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, String, UInt8MultiArray

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import NO_EVENTS
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import TickRecord
from ampc_ros.configuration import to_yaml
from ampc_ros.supervision import memory
from ampc_ros.supervision.supervisor import Supervisor

MEMORY_PERIOD = 2.0
"""Time between two memories, after which a recorder that joins a drive knows everything [s]."""


class Outputs:
    """The publishers of a controller."""

    def __init__(self, node: Node, *, lock_step: bool) -> None:
        """Create all publishers.

        Args:
            node: Owner.
            lock_step: The drive is faster than real time, and is to be recorded completely.
        """
        self.node = node
        qos = ros.RELIABLE if lock_step else ros.COMMAND
        self.commands = node.create_publisher(JointState, ros.STEERING_COMMAND, qos)
        publish = partial(node.create_publisher, event_callbacks=NO_EVENTS)
        names = ros.DEBUG_QUANTITIES
        self.debug = [publish(Float64, f"~/debug/{name}", ros.RELIABLE) for name in names]
        self.ticks = publish(JointState, ros.TICK, ros.RELIABLE)
        self.predictions = publish(PathMessage, ros.PREDICTED_PATH, ros.RELIABLE)
        self.memories = publish(UInt8MultiArray, ros.MEMORY, ros.LATCHED)
        self.configurations = publish(String, f"~/{ros.CONFIGURATION}", ros.LATCHED)
        self.stops = publish(Bool, ros.STOP_REQUEST, ros.LATCHED)
        self.newest: JointState | None = None
        self.published_stop: bool | None = None

    def destroy(self) -> None:
        """Destroy all publishers."""
        others = self.commands, self.ticks, self.predictions, self.configurations, self.stops
        for each in (*self.debug, *others, self.memories):
            self.node.destroy_publisher(each)

    def publish_configuration(self, supervisor: Supervisor, text: str = "") -> None:
        """Publish the configuration of the controller.

        Args:
            supervisor: Supervisor with the configuration.
            text: Result of `to_yaml`; empty: it is written here.
        """
        text = text or to_yaml(supervisor.config, supervisor.number)
        self.configurations.publish(String(data=text))

    def publish_tick(
        self,
        record: TickRecord,
        timing: Sequence[float],
        account: Sequence[float],
        steering: SteeringParameters,
        frame_id: str = ros.MAP,
    ) -> None:
        """Publish a command and its tick record.

        Args:
            record: Record of this tick.
            timing: Solve time and lateness of the timer [s].
            account: Numbers of ACCOUNT.
            steering: Ratio and offset of the command's topic.
            frame_id: Fixed frame of path and odometry.
        """
        command, plan = record.command, record.command.plan
        self.newest = ros.steering_message(command, steering)
        self.commands.publish(self.newest)
        values = (*plan.diagnosis, *timing)
        quantities = (*values, *record.quantities, *account)
        self.ticks.publish(ros.tick_message(command.stamp_ns, quantities))
        for publisher, value in zip(self.debug, values, strict=True):
            if publisher.get_subscription_count():
                publisher.publish(Float64(data=float(value)))
        if plan.prediction is not None and self.predictions.get_subscription_count():
            message = ros.path_message(plan.prediction, command.stamp_ns, frame_id)
            self.predictions.publish(message)

    def publish_memory(self, supervisor: Supervisor, commands: int) -> None:
        """Publish what the controller remembers after its first command, then every 2 s."""
        ticks = max(round(MEMORY_PERIOD / supervisor.period), 1)
        if commands % ticks == 1 % ticks and (data := memory.store(supervisor)):
            self.memories.publish(ros.memory_message(data, commands))

    def repeat(self) -> None:
        """Publish the newest command once more."""
        if self.newest is not None:
            self.commands.publish(self.newest)

    def hold(self) -> None:
        """Publish the newest angle once more, with rate zero."""
        if self.newest is not None:
            self.newest.velocity = [0.0]
            self.commands.publish(self.newest)

    def request_stop(self, requested: bool) -> None:
        """Request a stop, or take the request back; only a change is published."""
        if requested != self.published_stop:
            self.stops.publish(Bool(data=requested))
            self.published_stop = requested
