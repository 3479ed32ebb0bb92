"""Publishers of the controller: command, tick record, configuration, request to stop."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from builtin_interfaces.msg import Duration
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, String, UInt8MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import NO_EVENTS
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import NANOSECONDS, TickRecord
from ampc_ros.configuration import to_yaml
from ampc_ros.supervision import memory
from ampc_ros.supervision.stopping_plan import PLAN_PERIOD, StoppingPlan
from ampc_ros.supervision.supervisor import Supervisor

MEMORY_PERIOD = 2.0
"""Time between two memories, after which a recorder that joins a drive knows everything [s]."""

PREDICTION_PERIOD = 0.05
"""Shortest time between two predicted paths, which are large [s]."""


class Outputs:
    """The publishers of a controller."""

    def __init__(self, node: Node, period: float, *, lock_step: bool) -> None:
        """Create all publishers.

        Args:
            node: Owner.
            period: Period of the commands [s].
            lock_step: The drive is faster than real time, and is to be recorded completely.
        """
        self.node = node
        qos = ros.RELIABLE if lock_step else ros.controller_command(period)
        self.commands = node.create_publisher(JointState, ros.STEERING_COMMAND, qos)
        publish = partial(node.create_publisher, event_callbacks=NO_EVENTS)
        names = ros.DEBUG_QUANTITIES
        self.debug = [publish(Float64, f"~/debug/{name}", ros.RELIABLE) for name in names]
        self.ticks = publish(JointState, ros.TICK, ros.RELIABLE)
        self.predictions = publish(PathMessage, ros.PREDICTED_PATH, ros.RELIABLE)
        self.memories = publish(UInt8MultiArray, ros.MEMORY, ros.LATCHED)
        self.configurations = publish(String, f"~/{ros.CONFIGURATION}", ros.LATCHED)
        self.stops = publish(Bool, ros.STOP_REQUEST, ros.LATCHED)
        self.plans = publish(JointTrajectory, ros.STEERING_PLAN, ros.COMMAND)
        self.planned_ns = self.predicted_ns = 0
        self.newest: JointState | None = None
        self.published_stop: bool | None = None

    def destroy(self) -> None:
        """Destroy all publishers."""
        others = self.commands, self.ticks, self.predictions, self.configurations, self.stops
        for each in (*self.debug, *others, self.memories, self.plans):
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
        elapsed = abs(command.stamp_ns - self.predicted_ns) / NANOSECONDS
        is_due = elapsed > 0.99 * PREDICTION_PERIOD and self.predictions.get_subscription_count()
        if is_due and plan.prediction is not None:
            self.predicted_ns = command.stamp_ns
            message = ros.path_message(plan.prediction, command.stamp_ns, frame_id)
            self.predictions.publish(message)

    def publish_plan(self, supervisor: Supervisor, now_ns: int) -> None:
        """Publish how to steer until the car stands, where that is heard; not at every fast tick.

        Args:
            supervisor: Supervisor that has ticked.
            now_ns: Time of the tick [ns].
        """
        elapsed = abs(now_ns - self.planned_ns) / NANOSECONDS
        if elapsed < 0.99 * PLAN_PERIOD or not self.plans.get_subscription_count():
            return
        plan = supervisor.stopping_plan(now_ns)
        if plan is not None and self.newest is not None:
            self.planned_ns = now_ns
            self.plans.publish(plan_message(plan, self.newest, supervisor.config.steering))

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


def plan_message(
    plan: StoppingPlan, command: JointState, steering: SteeringParameters
) -> JointTrajectory:
    """Pack a plan; its joints are PLAN_JOINTS, and its stamp and frame are those of the command.

    Args:
        plan: Plan.
        command: Command of the same tick.
        steering: Ratio and offset of the steering.
    """
    rate = (
        steering.ratio
        * np.diff(plan.angle, append=plan.angle[-1])
        / np.diff(plan.time, append=plan.time[-1] + PLAN_PERIOD)
    )
    message = JointTrajectory(joint_names=list(ros.PLAN_JOINTS))
    message.header = command.header
    commands = [steering.position(angle) for angle in plan.angle.tolist()]
    positions = np.column_stack((commands, plan.distance, plan.x, plan.y))
    for position, velocity, acceleration, time in zip(
        positions.tolist(),
        np.column_stack((rate, plan.speed)).tolist(),
        plan.acceleration.tolist(),
        (NANOSECONDS * plan.time).astype(int).tolist(),
        strict=True,
    ):
        message.points.append(
            JointTrajectoryPoint(
                positions=position,
                velocities=[*velocity, 0.0, 0.0],
                accelerations=[0.0, acceleration, 0.0, 0.0],
                effort=[0.0] * len(position),  # rosbags misreads an empty list inside a list
                time_from_start=Duration(sec=time // NANOSECONDS, nanosec=time % NANOSECONDS),
            )
        )
    return message
