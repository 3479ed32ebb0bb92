"""What the controller publishes: commands, how they came about, what it is made of, a stop."""

from collections.abc import Sequence
from functools import partial

from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, String

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import NO_EVENTS
from ampc_ros.configuration import to_yaml
from ampc_ros.supervision.supervisor import Decision, Supervisor


class Outputs:
    """The publishers of a controller."""

    def __init__(self, node: Node, *, lock_step: bool) -> None:
        """Announce all topics.

        Args:
            node: Owner.
            lock_step: A drive is faster than real time, and is to be recorded whole.
        """
        self.node = node
        qos = ros.RELIABLE if lock_step else ros.COMMAND
        self.commands = node.create_publisher(JointState, ros.STEERING_COMMAND, qos)
        publish = partial(node.create_publisher, event_callbacks=NO_EVENTS)
        names = ros.DEBUG_QUANTITIES
        self.debug = [publish(Float64, f"~/debug/{name}", ros.RELIABLE) for name in names]
        self.ticks = publish(JointState, ros.TICK, ros.RELIABLE)
        self.predictions = publish(PathMessage, ros.PREDICTED_PATH, ros.RELIABLE)
        self.configurations = publish(String, f"~/{ros.CONFIGURATION}", ros.LATCHED)
        self.stops = publish(Bool, ros.STOP_REQUEST, ros.LATCHED)
        self.newest: JointState | None = None
        self.stop_told: bool | None = None

    def destroy(self) -> None:
        """Leave all topics."""
        told = self.commands, self.ticks, self.predictions, self.configurations, self.stops
        for each in (*self.debug, *told):
            self.node.destroy_publisher(each)

    def configuration(self, supervisor: Supervisor) -> None:
        """Say what the controller is made of."""
        self.configurations.publish(String(data=to_yaml(supervisor.config, supervisor.number)))

    def decision(
        self, decision: Decision, timing: Sequence[float], account: Sequence[float]
    ) -> None:
        """Publish a command and what is to be said about it.

        Args:
            decision: Of this tick.
            timing: Solve time and lateness of the timer [s].
            account: Numbers of ACCOUNT.
        """
        command, supervision = decision
        self.newest = ros.steering_message(command)
        self.commands.publish(self.newest)
        values = (*command.diagnosis, *timing)
        everything = (*values, *supervision, *account)
        self.ticks.publish(ros.tick_message(command.stamp_ns, everything))
        for publisher, value in zip(self.debug, values, strict=True):
            if publisher.get_subscription_count():
                publisher.publish(Float64(data=float(value)))
        if command.prediction is not None and self.predictions.get_subscription_count():
            self.predictions.publish(ros.path_message(command.prediction, command.stamp_ns))

    def again(self) -> None:
        """Publish the newest command once more."""
        if self.newest is not None:
            self.commands.publish(self.newest)

    def hold(self) -> None:
        """Publish the newest angle once more, to be held."""
        if self.newest is not None:
            self.newest.velocity = [0.0]
            self.commands.publish(self.newest)

    def stop(self, requested: bool) -> None:
        """Ask for a stop, or take that back; said once."""
        if requested != self.stop_told:
            self.stops.publish(Bool(data=requested))
            self.stop_told = requested
