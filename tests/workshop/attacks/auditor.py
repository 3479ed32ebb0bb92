"""A node that plays car and sensors, and audits every command by limits of its own.

The limits are computed from `guards/road.yaml` with NumPy, without the guard of the product.
"""

import math
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import rclpy
import yaml
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from ampc_msgs_config.config import shipped
from ampc_msgs_config.types import NANOSECONDS, VehicleState

RADIUS, SPEED = 30.0, 8.0
"""Of the circle that is driven [m], [m/s]."""
RATE = 50.0
"""Rate of the sensors [Hz]."""
ACCELERATION = 4.0
"""Of the car towards the speed of the gate [m/s^2]."""
SILENCE = 0.5
"""Longest time without a command, unless a stop is requested [s]."""
TOLERANCE = 0.004
"""Time between the computation of a command and its publication on an idle machine [s]."""
WINDOW = 1.0
"""The guard may use any speed that was published within this time [s]."""
QUEUE = 500
MEMORY = 2
"""Commands that the audit remembers."""
ACCURACY = 1e-6
Faulty = Callable[[Odometry], Iterable[Odometry]]


class Heard(NamedTuple):
    """A command."""

    time: float
    """Source time: when it was published [s]."""
    angle: float
    """Road-wheel angle [rad]."""
    stamp_ns: int = 0
    """Stamp, which a repeated command keeps [ns]."""


class Limits:
    """The limits of `road`, computed from its file."""

    def __init__(self) -> None:
        """Read the files."""
        self.road: dict[str, Any] = yaml.safe_load(shipped("guards")["road"].read_text("utf-8"))
        chassis: dict[str, float] = yaml.safe_load(shipped("vehicles")["paper"].read_text("utf-8"))[
            "chassis"
        ]
        l_f, l_r = chassis["cg_to_front_axle"], chassis["cg_to_rear_axle"]
        C_f, C_r = chassis["front_cornering_stiffness"], chassis["rear_cornering_stiffness"]
        self.wheelbase: float = l_f + l_r
        self.understeer = chassis["mass"] / self.wheelbase * (l_r / C_f - l_f / C_r) / 2.0

    def length(self, speed: float) -> float:
        """Return the wheelbase of a kinematic car that turns alike on a steady circle [m]."""
        return max(self.wheelbase + self.understeer * speed * speed, self.wheelbase / 2.0)

    def at(self, name: str, speed: float) -> float:
        """Return a limit at a speed [m/s]."""
        return float(np.interp(abs(speed), self.road["speed"], self.road[name]))

    def rate(self, speed: float) -> float:
        """Return the largest rate of the wheel at a speed [m/s], in rad/s."""
        v = max(abs(speed), 0.1)
        return min(self.at("max_rate", v), self.at("lateral_jerk", v) * self.length(v) / (v * v))


class Auditor(Node):
    """Drives along a circle as the gate commands, and audits the commands."""

    def __init__(self, context: Any, period: float, *, simulated: bool) -> None:
        """Create publishers and subscriptions.

        Args:
            context: Context of the node.
            period: Period of the controller [s].
            simulated: Whether to publish `/clock`.
        """
        super().__init__("auditor", context=context)
        self.limits, self.period = Limits(), period
        self.simulated_ns: int | None = NANOSECONDS if simulated else None
        self.clock_rate = 1.0
        """Rate of the simulated clock; 0: it stands and is silent."""
        self.x = self.y = self.yaw = self.v = self.wheel = 0.0
        self.command = Heard(0.0, 0.0)
        self.target = 0.0
        self.faulty: Faulty | None = None
        self.speeds: list[tuple[float, float]] = [(0.0, 0.0)]
        self.audits_commands = True
        """False while several controllers command: only the gate is audited then."""
        self.awaits_start, self.start_step = False, 0.0
        """Whether a controller starts, and how far from the wheel its first command is [rad]."""
        self.last: dict[str, list[Heard]] = {}
        self.state = ""
        self.stops: set[bool] = set()
        self.forget()
        self.due = self.stepped = time.monotonic()
        self.executor_of_all = SingleThreadedExecutor(context=context)
        self.executor_of_all.add_node(self)
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.steering = self.create_publisher(JointState, ros.STEERING_STATE, ros.RELIABLE)
        self.speed = self.create_publisher(TwistStamped, ros.TARGET_SPEED, ros.COMMAND)
        self.path = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        if simulated:
            self.clock_out = self.create_publisher(Clock, ros.CLOCK, ros.RELIABLE)
        every = QoSProfile(depth=QUEUE, reliability=ReliabilityPolicy.RELIABLE)  # type: ignore[no-untyped-call]
        listen: Any = self.create_subscription
        listen(JointState, ros.STEERING_COMMAND, self.on_command, every)
        listen(JointState, ros.GATE_STEERING, self.on_gate, every)
        listen(TwistStamped, ros.GATE_SPEED, self.on_gate_speed, every)
        listen(TwistStamped, ros.DRIVE_COMMAND, self.on_drive, every)
        listen(String, ros.GATE_STATE, self.on_state, ros.LATCHED)
        listen(Bool, ros.STOP_REQUEST, self.on_stop, ros.LATCHED)
        names = ("controller/reset_stop", "gate/reset")
        self.resets = [self.create_client(Trigger, name) for name in names]

    # What is heard -----------------------------------------------------------------------------

    def forget(self) -> None:
        """Begin a new audit."""
        self.violations: list[str] = []
        self.doubts: list[str] = []
        self.gap, self.lag, self.stops = 0.0, 0.0, set()
        self.counts = {ros.STEERING_COMMAND: 0, ros.GATE_STEERING: 0}
        self.begun = self.heard_at = time.time()

    def on_command(self, message: JointState, info: Any) -> None:
        """Audit a command of a controller, and the time since the one before."""
        at = info["source_timestamp"] / NANOSECONDS
        if self.awaits_start:
            self.awaits_start, self.start_step = False, abs(message.position[0] - self.wheel)
            self.last.pop(ros.STEERING_COMMAND, None)  # it starts from the wheel
        self.gap = max(self.gap, at - max(self.heard_at, self.begun))
        self.heard_at = at
        if self.audits_commands:
            self.audit(ros.STEERING_COMMAND, message, at)

    def on_gate(self, message: JointState, info: Any) -> None:
        """Audit a command of the gate, which the car obeys."""
        at = info["source_timestamp"] / NANOSECONDS
        self.audit(ros.GATE_STEERING, message, at)
        self.command = Heard(at, message.position[0])

    def on_gate_speed(self, message: TwistStamped) -> None:
        """Obey a speed of the gate, and audit it."""
        if not 0.0 <= message.twist.linear.x <= 100.0:
            self.violations.append(f"{ros.GATE_SPEED}: speed {message.twist.linear.x}")
        else:
            self.target = message.twist.linear.x

    def on_drive(self, message: TwistStamped) -> None:
        """Audit speed and yaw rate of the gate: finite, and inside the angle's limit."""
        v, turn = message.twist.linear.x, message.twist.angular.z
        most = max(self.limits.road["max_angle"])
        bound = abs(v) * math.tan(most) / self.limits.wheelbase + ACCURACY
        if not (math.isfinite(v) and abs(turn) <= bound):
            self.violations.append(f"{ros.DRIVE_COMMAND}: speed {v}, yaw rate {turn}")

    def on_state(self, message: String) -> None:
        """Store the state of the gate."""
        self.state = message.data

    def on_stop(self, message: Bool) -> None:
        """Store a stop request."""
        self.stops.add(message.data)

    def audit(self, topic: str, message: JointState, at: float) -> None:
        """Check that a command is finite, inside its limit, and one step from the one before."""
        self.counts[topic] += 1
        angle, rate = message.position[0], message.velocity[0]
        if not (math.isfinite(angle) and math.isfinite(rate)):
            self.violations.append(f"{topic}: angle {angle}, rate {rate}")
            return
        if abs(angle) > max(self.limits.road["max_angle"]) + ACCURACY:
            self.violations.append(f"{topic}: angle {angle:.4f} is beyond the largest one")
        before, new = (
            self.last.get(topic, []),
            Heard(at, angle, ros.nanoseconds(message.header.stamp)),
        )
        is_repeated = before and before[0].angle == angle and before[0].stamp_ns == new.stamp_ns
        if before and before[0].angle == angle and (is_repeated or topic == ros.GATE_STEERING):
            return  # the gate's guard counts the time since the last change
        self.last[topic] = [new, *before][:MEMORY]
        if before:
            self.audit_step(topic, new, before)

    def audit_step(self, topic: str, new: Heard, before: list[Heard]) -> None:
        """Check that a command is within reach of the one before.

        Where the one before was published late, it gets that time in addition.
        """
        last, late = before[0], TOLERANCE
        if topic == ros.STEERING_COMMAND and len(before) > 1:
            late += min(max(last.time - before[1].time - self.period, 0.0), self.period)
        speeds = [v for then, v in self.speeds if time.monotonic() - then < WINDOW] or [self.v]
        allowed = max(map(self.limits.rate, speeds))
        step, elapsed = abs(new.angle - last.angle), max(new.time - last.time, 0.0)
        if self.simulated_ns is not None:  # the guard measures with this clock, which may jump
            elapsed = 2.0 * self.period

        def reach(time: float) -> float:
            return allowed * min(time, 2.0 * self.period) + ACCURACY

        if step <= reach(elapsed + late):
            return
        text = f"{topic}: step of {step:.4f} rad after {elapsed:.4f} s, allowed {allowed:.3f} rad/s"
        excused = step <= reach(elapsed + late + self.lag)
        (self.doubts if excused else self.violations).append(text)

    @property
    def is_stopping(self) -> bool:
        """Return whether a stop was requested since the audit began."""
        return True in self.stops or self.state in ("stopping", "stopped")

    def silence(self) -> float:
        """Return the longest time without a command since the audit began [s]."""
        return max(self.gap, time.time() - max(self.heard_at, self.begun))

    def age(self) -> float:
        """Return the time since the last command [s]."""
        return time.time() - self.heard_at

    # What is published -------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        """Return the time of the stamps [ns]."""
        return time.time_ns() if self.simulated_ns is None else self.simulated_ns

    def home(self) -> None:
        """Place the car on the circle, in motion, with the wheel as it is."""
        self.x, self.y, self.yaw, self.v = 0.0, 0.0, 0.0, SPEED

    def path_message(self) -> PathMessage:
        """Return the circle."""
        angles = np.linspace(0.0, 2.0 * math.pi, 360)
        points = np.column_stack((RADIUS * np.sin(angles), RADIUS * (1.0 - np.cos(angles))))
        return ros.path_message(points, self.now_ns)

    def publish_path(self) -> None:
        """Publish the circle."""
        self.path.publish(self.path_message())

    def step_car(self, dt: float) -> None:
        """Move the car by a time [s], along the steady circle of its wheel."""
        most = ACCELERATION * dt
        self.v += min(max(self.target - self.v, -most), most)
        self.wheel += (self.command.angle - self.wheel) * min(dt / 0.05, 1.0)
        self.yaw += self.turn() * dt
        self.x += self.v * math.cos(self.yaw) * dt
        self.y += self.v * math.sin(self.yaw) * dt

    def turn(self) -> float:
        """Return the yaw rate [rad/s]."""
        return self.v * math.tan(self.wheel) / self.limits.length(self.v)

    def publish(self) -> None:
        """Move the car and publish its sensors."""
        now = time.monotonic()
        self.lag = max(self.lag, now - self.due)
        self.due = max(self.due + 1.0 / RATE, now)
        passed, self.stepped = now - self.stepped, now
        if self.simulated_ns is not None:
            self.simulated_ns += int(self.clock_rate * passed * NANOSECONDS)
            if self.clock_rate:
                self.clock_out.publish(Clock(clock=ros.time_message(self.simulated_ns)))
        self.step_car(min(passed, 0.2))
        state = VehicleState(self.now_ns, self.x, self.y, self.yaw, self.v, 0.0, self.turn())
        message = ros.odometry_message(state)
        for each in [message] if self.faulty is None else self.faulty(message):
            v = each.twist.twist.linear.x
            self.speeds = [*self.speeds[-200:], (now, v if math.isfinite(v) else 0.0)]
            self.odom.publish(each)
        self.steering.publish(ros.joint_message(self.now_ns, self.wheel, 0.0))
        self.speed.publish(ros.speed_message(ros.Stamped(self.now_ns, SPEED)))

    def run(self, seconds: float, condition: Callable[[], bool] | None = None) -> bool:
        """Publish and listen for a time [s], or until a condition holds; return whether it does."""
        until = time.monotonic() + seconds
        while (now := time.monotonic()) < until:
            if condition and condition():
                return True
            if now >= self.due:
                self.publish()
            self.executor_of_all.spin_once(timeout_sec=max(min(self.due - now, until - now), 0.0))
        return condition is not None and condition()

    def reset(self) -> None:
        """Take back all stop requests, without waiting for an answer."""
        for client in self.resets:
            if client.service_is_ready():
                client.call_async(Trigger.Request())


def new_context() -> Any:
    """Return a ROS context of its own."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    return context
