"""Messages of the gate: unpacking of plans, and its publishers."""

from functools import partial

from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String, UInt64
from trajectory_msgs.msg import JointTrajectory

from ampc_msgs_config import ros, topics
from ampc_msgs_config.nodes import qos
from ampc_msgs_config.nodes.base_node import NO_EVENTS
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import NANOSECONDS
from ampc_ros.gate.core import GateOutput
from ampc_ros.gate.plan import MOST_PLAN_POINTS, PlanPoint, SteeringPlan, make_plan
from ampc_ros.gate.settings import STOPS, GateSettings, GateState
from ampc_ros.nodes.drive_messages import OUTPUT, DriveCommand, load_output

DEADLINE, LEASE = 0.2, 0.3
"""Offered for `drive_command`: a car that requests these notices the end of the gate [s]."""
ANSWERED = (topics.STEERING_COMMAND, topics.TARGET_SPEED)
"""Inputs that the gate passes on."""
LEAST_JOINTS = 2
"""A plan may end with the distance: it then states no places."""


def steering_plan(message: JointTrajectory, steering: SteeringParameters) -> SteeringPlan:
    """Unpack a plan.

    Args:
        message: Message of `steering_plan`.
        steering: Ratio and offset of the steering topics.

    Raises:
        ValueError: Names the field, the value and the bound.
    """
    joints, expected = tuple(message.joint_names), topics.PLAN_JOINTS
    if joints not in (expected, expected[:LEAST_JOINTS]):
        names = str(list(joints[:5]))[:80]
        raise ValueError(f"steering_plan: joint_names = {names} must be {list(expected)}")
    if len(message.points) > MOST_PLAN_POINTS:
        text = f"must have at most {MOST_PLAN_POINTS}"
        raise ValueError(f"steering_plan: {len(message.points)} points {text}")
    points = []
    for i, point in enumerate(message.points):
        rows = point.positions, point.velocities, point.accelerations
        if any(len(row) != len(joints) for row in rows):
            text = f"positions, velocities and accelerations must hold {len(joints)} numbers each"
            raise ValueError(f"steering_plan: points[{i}]: {text}")
        time = point.time_from_start.sec + point.time_from_start.nanosec / NANOSECONDS
        angle, distance = steering.angle(rows[0][0]), rows[0][1]
        points.append(PlanPoint(time, angle, distance, rows[1][1], rows[2][1], *rows[0][2:]))
    return make_plan(points, has_places=len(joints) > LEAST_JOINTS)


def angle_rate(message: JointState, steering: SteeringParameters) -> float:
    """Return the rate of the road-wheel angle of a command; 0 where it states none [rad/s]."""
    return message.velocity[0] / steering.ratio if len(message.velocity) == 1 else 0.0


class GateOutputs:
    """The publishers of the gate."""

    def __init__(
        self,
        node: Node,
        steering: SteeringParameters,
        wheelbase: float,
        output: str = OUTPUT,
        deceleration: float = GateSettings().deceleration,
    ) -> None:
        """Create the publishers of state, heartbeat and stop request.

        Args:
            node: Owner.
            steering: Ratio and offset of the steering topics; largest angle of the car.
            wheelbase: Wheelbase of the car [m].
            output: Type of the complete command, one of OUTPUTS.
            deceleration: Largest commanded deceleration [m/s^2].

        Raises:
            ValueError: The package of the type is missing.
        """
        self.node, self.steering, self.wheelbase = node, steering, wheelbase
        self.drive_kind, self.fill = load_output(output)
        self.deceleration = deceleration
        self.publish = partial(node.create_publisher, event_callbacks=NO_EVENTS)
        self.states = self.publish(String, topics.GATE_STATE, qos.LATCHED)
        self.heartbeat = self.publish(UInt64, topics.GATE_HEARTBEAT, qos.COMMAND)
        self.stops = self.publish(Bool, topics.STOP_REQUEST, qos.LATCHED)
        self.state: GateState | None = None
        self.is_connected = False

    def connect(self) -> bool:
        """Create the publishers to the car once both commands have one; return whether they exist.

        A car that waits for a publisher then waits for controller and planner, too.
        """
        names = map(self.node.resolve_topic_name, ANSWERED)
        is_complete = all(map(self.node.count_publishers, names))
        if self.is_connected or not is_complete:
            return self.is_connected
        lock_step = bool(self.node.get_parameter("lock_step").value)
        offered = qos.RELIABLE if lock_step else qos.watched_command(DEADLINE, LEASE)
        command = qos.RELIABLE if lock_step else qos.COMMAND
        self.drive = self.publish(self.drive_kind, topics.DRIVE_COMMAND, offered)
        self.angles = self.publish(JointState, topics.GATE_STEERING, command)
        self.speeds = self.publish(TwistStamped, topics.GATE_SPEED, command)
        self.is_connected = True
        return True

    def publish_state(self, state: GateState) -> None:
        """Publish a changed state, and request a stop or take the request back with it.

        The first message of a publisher must be False: the planner tells publishers apart by it.
        """
        if state is self.state:
            return
        if self.state is None or (state in STOPS) != (self.state in STOPS):
            self.stops.publish(Bool(data=state in STOPS))
        self.states.publish(String(data=state.value))
        self.state = state

    def publish_steering(
        self, output: GateOutput, stamp_ns: int, command: JointState | None
    ) -> None:
        """Publish the angle of an output.

        Args:
            output: Output of the gate.
            stamp_ns: Stamp [ns].
            command: Command whose angle it is: its numbers are passed on bit for bit.
        """
        message = ros.joint_message(stamp_ns, output.angle, output.rate, self.steering)
        if command:
            message.position = command.position
            if output.rate == angle_rate(command, self.steering) and len(command.velocity) == 1:
                message.velocity = command.velocity
        self.angles.publish(message)

    def publish_speed(self, speed: float, stamp_ns: int) -> None:
        """Publish the commanded speed [m/s]."""
        self.speeds.publish(ros.speed_message(ros.Stamped(stamp_ns, speed)))

    def publish_drive(
        self, output: GateOutput, stamp_ns: int, measured_speed: float, now: float
    ) -> None:
        """Publish the complete command, with the yaw rate of the kinematic model.

        Args:
            output: Output of the gate.
            stamp_ns: Stamp [ns].
            measured_speed: Speed of the car [m/s].
            now: Steady time [s].
        """
        message = self.drive_kind()
        command = DriveCommand(
            ros.time_message(stamp_ns),
            output.angle,
            output.rate,
            output.speed,
            output.speed * output.curvature(self.wheelbase),
            measured_speed,
            self.deceleration,
            self.steering.max_angle,
            now,
        )
        self.fill(message, command)
        self.drive.publish(message)
