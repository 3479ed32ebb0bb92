"""Node `simulator`: the car that really drives. `ros2 run sim_vehicle simulator`.

Real-time mode runs free on the node's clock. In lock-step the node owns the time: it publishes
`/clock` and a state, and moves on only when steering and target speed have answered that state.
"""

import sys
import time
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.config import find, load
from ampc_msgs_config.types import NANOSECONDS
from sim_vehicle.closed_loop import STEP_NS, Simulation
from sim_vehicle.parameters import MeasurementNoise, load_vehicle

PERIOD_NS = 100_000_000
"""Control period in lock-step [ns]."""
REAL_TIME_PERIOD_NS = 20_000_000
"""Time from one state to the next in real-time mode [ns]."""
RESEND = 0.2
"""Wall time after which an unanswered state is published again [s]."""
TIMED_OUT = 3
"""Exit code where a peer is lost."""


class SimulatorNode(Node):
    """Publishes the state of the car, and moves it under the commands that come back."""

    def __init__(self) -> None:
        """Load the car and the drive; the first state goes out once both peers are there."""
        super().__init__("simulator")
        scenario = ros.declare_scenario(self)
        vehicle = load_vehicle(find("vehicles", self.get_parameter("vehicle").value))
        self.lock_step = ros.declare(self, "lock_step", False, "advance only when answered")
        self.time_out = ros.declare(
            self, "time_out", 10.0, "wait for an answer in lock-step [s]", (0.1, 3600.0)
        )
        Simulation(vehicle, scenario).advance(0.0, 0.0, STEP_NS)  # compiles
        self.simulation = Simulation(vehicle, scenario, **self._options())
        self.state: list[tuple[Publisher, Any]] = []
        self.period_ns = PERIOD_NS if self.lock_step else REAL_TIME_PERIOD_NS
        self.start_ns = NANOSECONDS
        self.answers: dict[str, ros.Stamped] = {}
        self.waiting_since = time.monotonic()
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.wind = self.create_publisher(Vector3Stamped, ros.WIND, ros.RELIABLE)
        self.steering = self.create_publisher(JointState, ros.STEERING_STATE, ros.RELIABLE)
        self.clock = self.create_publisher(ClockMessage, ros.CLOCK, ros.RELIABLE)
        self.diagnostics = self.create_publisher(DiagnosticArray, ros.DIAGNOSTICS, ros.RELIABLE)
        self.peers = (
            self.create_subscription(
                JointState, ros.STEERING_COMMAND, self.on_steering, ros.COMMAND
            ),
            self.create_subscription(TwistStamped, ros.TARGET_SPEED, self.on_speed, ros.COMMAND),
        )
        self.wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.timer = self.create_timer(0.02, self.wait_for_peers, clock=self.wall)
        self.create_timer(1.0, self.on_diagnostics, clock=self.wall)
        self.get_logger().info(f"{scenario.name}: waiting for steering_command and target_speed")

    def _options(self) -> dict[str, Any]:
        """Friction and measurement noise, as keyword arguments of the `Car`."""
        friction = ros.declare(self, "friction", -1.0, "mu of the road; -1: the tyre's", (-1, 3))
        name = ros.declare(self, "noise", "", "shipped noise or YAML file; empty: none")
        seed = ros.declare(self, "seed", 0, "of the noise")
        noise = load(MeasurementNoise, find("noise", name)) if name else None
        return {
            "friction": None if friction < 0 else friction,
            "noise": noise,
            "rng": np.random.default_rng(seed),
        }

    @property
    def stamp_ns(self) -> int:
        """Time of the present state [ns]."""
        return self.start_ns + self.simulation.elapsed_ns

    def wait_for_peers(self) -> None:
        """Start once both answers have a publisher that is matched."""
        missing = [peer.topic_name for peer in self.peers if not peer.get_publisher_count()]
        if missing and self.lock_step:
            self._check_time_out(f"nobody publishes {' and '.join(missing)}")
        if missing:
            return
        self.timer.cancel()
        self.destroy_timer(self.timer)
        self.waiting_since = time.monotonic()
        if self.lock_step:
            self.create_timer(RESEND, self.on_unanswered, clock=self.wall)
        else:
            self.start_ns = self.get_clock().now().nanoseconds
            self.create_timer(self.period_ns / NANOSECONDS, self.on_real_time)
        self.publish_state()

    def on_real_time(self) -> None:
        """Move on under the newest answers; the car waits at its start for the first ones."""
        if len(self.answers) < len(self.peers):
            self.start_ns = self.get_clock().now().nanoseconds
            self.publish_state()
            return
        self.move()

    def on_steering(self, message: JointState) -> None:
        """Take a steering angle."""
        try:
            self.answer("steering", ros.steering_angle(message))
        except ValueError as error:
            self.get_logger().error(str(error), throttle_duration_sec=1.0)

    def on_speed(self, message: TwistStamped) -> None:
        """Take a target speed."""
        self.answer("speed", ros.target_speed(message))

    def answer(self, name: str, answer: ros.Stamped) -> None:
        """Keep an answer; in lock-step only one to the present state, and move on with both."""
        if not self.lock_step:
            self.answers[name] = answer
        elif answer.stamp_ns == self.stamp_ns:
            self.answers[name] = answer
            if len(self.answers) == len(self.peers):
                self.move()
                self.answers.clear()
                self.waiting_since = time.monotonic()

    def move(self) -> None:
        """Drive one period and publish the state there, or end the drive."""
        steering, speed = self.answers["steering"].value, self.answers["speed"].value
        self.simulation.advance(steering, speed, self.period_ns)
        if self.simulation.finished:
            self.get_logger().info(f"drive over after {self.simulation.scenario.duration:g} s")
            raise SystemExit(0)
        self.publish_state()

    def publish_state(self) -> None:
        """Measure, and publish time, wind, steering angle and state."""
        stamp_ns, car = self.stamp_ns, self.simulation.car
        self.state = [
            (self.wind, ros.wind_message(stamp_ns, self.simulation.wind())),
            (self.steering, ros.joint_message(stamp_ns, car.steering, 0.0)),
            (self.odom, ros.odometry_message(car.measure(stamp_ns))),
        ]
        if self.lock_step:
            self.state.insert(0, (self.clock, ClockMessage(clock=ros.time_message(stamp_ns))))
        self.send()

    def send(self) -> None:
        """Publish what was measured last."""
        for publisher, message in self.state:
            publisher.publish(message)

    def on_unanswered(self) -> None:
        """Publish an unanswered state again; give up after the time-out."""
        if time.monotonic() - self.waiting_since < RESEND:
            return
        names = {"steering": ros.STEERING_COMMAND, "speed": ros.TARGET_SPEED}
        missing = [topic for name, topic in names.items() if name not in self.answers]
        self._check_time_out(
            f"no {' and no '.join(missing)} answered the state at "
            f"{self.simulation.elapsed_ns / NANOSECONDS:.1f} s"
        )
        self.send()

    def _check_time_out(self, what: str) -> None:
        if time.monotonic() - self.waiting_since > self.time_out:
            self.get_logger().fatal(f"lock-step: {what} within {self.time_out:g} s")
            raise SystemExit(TIMED_OUT)

    def on_diagnostics(self) -> None:
        """Report health once a second."""
        values = {
            "elapsed": self.simulation.elapsed_ns / NANOSECONDS,
            "duration": self.simulation.scenario.duration,
            "speed": float(self.simulation.car.state[3]),
        }
        trouble = "" if self.answers or self.lock_step else "waiting for the first command"
        self.diagnostics.publish(ros.diagnostics_message(self, trouble, values))


def main() -> int:
    """Run the node."""
    return ros.spin(SimulatorNode)


if __name__ == "__main__":
    sys.exit(main())
