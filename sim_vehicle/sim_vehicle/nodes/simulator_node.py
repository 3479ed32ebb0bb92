"""Node `simulator`: the simulated car. `ros2 run sim_vehicle simulator`.

In real-time mode the car follows the clock of the node. It stands at its start until steering
command and target speed have arrived, and then rolls with the speed of the scenario, so that pose
and twist agree from the first message on. In lock-step the node owns the time: it publishes
`/clock` and a state, and advances only after both commands for that state have arrived.
"""

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import TwistStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ampc_msgs_config import ros
from ampc_msgs_config.config import find, load, shipped_or_file
from ampc_msgs_config.nodes.base_node import BaseNode, declare, spin
from ampc_msgs_config.nodes.scenario_parameters import declare_scenario
from ampc_msgs_config.nodes.sole_sources import SoleSources
from ampc_msgs_config.nodes.waiting import WaitLog, why_silent
from ampc_msgs_config.types import ERROR, NANOSECONDS, WARN
from sim_vehicle.closed_loop import STEP_NS
from sim_vehicle.configuration import SimulatorConfiguration, simulator_text
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file

PERIOD_NS = 100_000_000
"""Control period in lock-step [ns]."""
REAL_TIME_RATE = 50.0
"""Default rate of the states in real-time mode [Hz]."""
LAG_NS = STEP_NS // 2
"""Age of the states in real time, so that a timer that is less than this too early or too late does
not add or leave out a step [ns]."""
LONGEST_CATCH_UP = 0.5
"""Longest time that is caught up at once; the car stands still during a longer pause of this
process or jump of the clock [s]."""
MAX_SILENCE = 0.5
"""Age from which a command is reported as missing, in real-time mode [s]."""
RESEND = 0.2
"""Wall time after which an unanswered state is published again [s]."""
COMMANDS = (ros.STEERING_COMMAND, ros.TARGET_SPEED)
"""Topics without which the car does not move."""
TIMED_OUT = 3
"""Exit code after the timeout of a peer."""


class SimulatorNode(BaseNode):
    """Node that publishes the state of the car and integrates its motion under the commands."""

    def __init__(self) -> None:
        """Load car and scenario; the first state is published once both peers are present."""
        super().__init__("simulator", owns_time=True)
        self.config = self._load_configuration()
        self.simulation = self.config.simulation()
        self.simulation.advance(0.0, 0.0, STEP_NS)  # compiles the simulation
        self.simulation.car.measure(0)  # compiles the measurement
        self.place_at_start()
        limits = (0.1, 3600.0)
        self.time_out = declare(self, "time_out", 10.0, "timeout of a command [s]", limits)
        text = "states per second in real time [Hz]"
        self.rate: float = declare(self, "rate", REAL_TIME_RATE, text, (10.0, 200.0))
        self.start_time_out = declare(
            self, "start_time_out", 60.0, "timeout of the start of other nodes [s]", limits
        )
        self.state: list[tuple[Publisher, Any]] = []
        self.answers: dict[str, ros.Stamped] = {}
        self.waiting_since = time.monotonic()
        self._publish_and_subscribe()
        self.wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.start_timer = self.create_timer(0.02, self.wait_for_peers, clock=self.wall)
        self.create_timer(1.0, self.on_diagnostics, clock=self.wall)
        self.waiting = WaitLog(self, self.waits_for_peers)
        name, duration = self.simulation.scenario.name, self.simulation.scenario.duration
        self.get_logger().info(f"ready: {name}, {duration:g} s; waiting for planner and controller")

    def place_at_start(self) -> None:
        """Place the car at its start; in real time it stands there until the drive begins."""
        self.simulation = self.config.simulation()
        self.start_ns, self.is_driving = NANOSECONDS, self.lock_step
        if not self.lock_step:
            self.simulation.set_speed(0.0)

    def _load_configuration(self) -> SimulatorConfiguration:
        """Declare the parameters of scenario and car, and load the files that they name."""
        scenario = declare_scenario(self)
        vehicle = load_vehicle_file(find("vehicles", self.get_parameter("vehicle").value))
        friction = declare(self, "friction", -1.0, "mu of the road; -1: that of the tyres", (-1, 3))
        allowed = shipped_or_file("noise", "a YAML file; empty: none")
        name = declare(self, "noise", "", "noise of the measurement", allowed)
        seed = declare(self, "seed", 0, "seed of the noise", (0, 2**31 - 1))
        return SimulatorConfiguration(
            vehicle,
            scenario,
            friction=None if friction < 0 else friction,
            noise=load(MeasurementNoise, find("noise", name)) if name else None,
            seed=seed,
            lock_step=self.lock_step,
        )

    def _publish_and_subscribe(self) -> None:
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.wind = self.create_publisher(Vector3Stamped, ros.WIND, ros.RELIABLE)
        self.steering = self.create_publisher(JointState, ros.STEERING_STATE, ros.RELIABLE)
        self.configurations = self.create_publisher(String, f"~/{ros.CONFIGURATION}", ros.LATCHED)
        self.configurations.publish(String(data=simulator_text(self.config)))
        self.angle_of = partial(ros.steering_angle, steering=self.config.vehicle.steering)
        if self.lock_step:
            self.clock = self.create_publisher(ClockMessage, ros.CLOCK, ros.RELIABLE)
        self.peers = [
            self._listen(JointState, ros.STEERING_COMMAND, self.angle_of),
            self._listen(TwistStamped, ros.TARGET_SPEED, ros.target_speed),
        ]
        heard = {ros.STEERING_COMMAND: JointState, ros.TARGET_SPEED: TwistStamped}
        listed = [ros.ODOM, ros.CLOCK] if self.lock_step else [ros.ODOM]
        self.sources = SoleSources(
            self, heard, listed, self.on_diagnostics, lock_step=self.lock_step
        )

    def _listen(self, kind: Any, topic: str, unpack: Callable[[Any], ros.Stamped]) -> Subscription:
        return self.create_subscription(
            kind, topic, partial(self.on_answer, topic, unpack), ros.COMMAND
        )

    @property
    def stamp_ns(self) -> int:
        """Time of the present state [ns]."""
        return self.start_ns + self.simulation.elapsed_ns

    def wait_for_peers(self) -> None:
        """Start once both commands have a publisher, and the recorder, if any, subscribes."""
        missing = [peer.topic_name for peer in self.peers if not peer.get_publisher_count()]
        if missing:
            self.check_time_out(f"no publisher of {' and '.join(missing)}", self.start_time_out)
        elif unrecorded := self.unrecorded():
            self.check_time_out(f"no recorder of {' and '.join(unrecorded)}", self.start_time_out)
        else:
            self.begin()

    def waits_for_peers(self) -> str:
        """Return which commands the start of the drive lacks and why; empty: it has begun."""
        if self.state and (self.lock_step or self.is_driving):
            return ""
        missing = [peer for peer in self.peers if not peer.get_publisher_count()]
        if self.state:
            missing = [self.peers[COMMANDS.index(topic)] for topic in self.unanswered()]
        return "; ".join(why_silent(self, [peer]) for peer in missing) or self.waits_for()

    def begin(self) -> None:
        """Publish the first state, and start the timer of the drive."""
        self.destroy_timer(self.start_timer)
        self.waiting_since = time.monotonic()
        if self.lock_step:
            self.create_timer(RESEND, self.on_unanswered, clock=self.wall)
            self.publish_state()
        else:
            self.create_timer(1.0 / self.rate, self.on_real_time)

    def on_answer(self, topic: str, unpack: Callable[[Any], ros.Stamped], message: Any) -> None:
        """Store a steering command or a target speed; in lock-step advance after the second."""
        try:
            answer = unpack(message)
        except ValueError as error:
            self.reject(error)
            return
        if not self.lock_step:
            self.answers[topic] = answer._replace(stamp_ns=self.now_ns)
        elif answer.stamp_ns == self.stamp_ns:
            self.answers[topic] = answer
            if not self.unanswered():
                self.move(PERIOD_NS)
                self.answers.clear()
                self.waiting_since = time.monotonic()

    def unanswered(self) -> list[str]:
        """Return the topics without a command for the present state."""
        return [topic for topic in COMMANDS if topic not in self.answers]

    def on_unanswered(self) -> None:
        """Lock-step: publish an unanswered state again; end the drive after the timeout."""
        if time.monotonic() - self.waiting_since < RESEND:
            return
        at = self.simulation.elapsed_ns / NANOSECONDS
        missing = " and no ".join(self.unanswered())
        self.check_time_out(f"no {missing} answered the state at {at:.1f} s", self.time_out)
        self.send()

    def on_real_time(self) -> None:
        """Advance under the newest commands; a pause longer than LONGEST_CATCH_UP is left out."""
        if not self.is_driving:
            self.wait_at_start()
            return
        due_ns = self.now_ns - self.stamp_ns
        if due_ns < 0:
            self.get_logger().warning("time went backwards: the car restarts the scenario")
            self.place_at_start()
            self.waiting_since = time.monotonic()
            return
        if due_ns > LONGEST_CATCH_UP * NANOSECONDS:
            pause = due_ns / NANOSECONDS
            self.get_logger().warning(f"no state for {pause:.1f} s: the car stood still meanwhile")
            self.start_ns += due_ns - STEP_NS - LAG_NS
            due_ns, now_ns = STEP_NS, self.now_ns  # the commands of the pause are still to come
            self.answers = {t: a._replace(stamp_ns=now_ns) for t, a in self.answers.items()}
        if due_ns >= STEP_NS:
            self.check_silence()
            self.move(due_ns // STEP_NS * STEP_NS)

    def wait_at_start(self) -> None:
        """Publish the standing car; begin the drive once both commands are there.

        A stop request keeps the car at its start: the target speed is zero then.
        """
        self.start_ns = self.now_ns
        self.publish_state()
        if missing := self.waits_for():
            self.check_time_out(f"no {missing}", self.start_time_out)
            return
        start, target = self.simulation.start_speed, self.answers[ros.TARGET_SPEED].value
        self.simulation.set_speed(min(start, target))
        self.start_ns -= LAG_NS
        self.is_driving = True

    def waits_for(self) -> str:
        """Return what the car waits for at its start, in real time; empty: it does not wait."""
        if self.is_driving:
            return ""
        if missing := self.unanswered():
            return " and ".join(missing)
        is_held = self.simulation.start_speed > 0.0 >= self.answers[ros.TARGET_SPEED].value
        return "target_speed above 0 m/s" if is_held else ""

    def check_silence(self) -> None:
        """Real time: end the drive if a command is older than the timeout."""
        for topic, answer in self.answers.items():
            if self.now_ns - answer.stamp_ns > self.time_out * NANOSECONDS:
                self.end_drive(f"no {topic} within {self.time_out:g} s")

    def check_time_out(self, what: str, time_out: float) -> None:
        """End the drive if the wait exceeds the timeout [s]."""
        if time.monotonic() - self.waiting_since > time_out:
            self.end_drive(f"{what} within {time_out:g} s")

    def end_drive(self, why: str) -> None:
        """End the drive because a peer is missing."""
        self.get_logger().fatal(why)
        raise SystemExit(TIMED_OUT)

    def move(self, period_ns: int) -> None:
        """Integrate a period [ns] and publish the new state, or end the drive."""
        steering, speed = (self.answers[t].value for t in (ros.STEERING_COMMAND, ros.TARGET_SPEED))
        self.simulation.advance(steering, speed, period_ns)
        if self.simulation.finished:
            self.get_logger().info(f"drive finished after {self.simulation.scenario.duration:g} s")
            raise SystemExit(0)
        self.publish_state()

    def publish_state(self) -> None:
        """Measure, and publish time, wind, steering angle and state."""
        stamp_ns, car = self.stamp_ns, self.simulation.car
        steering = ros.joint_message(stamp_ns, car.steering, 0.0, self.config.vehicle.steering)
        self.state = [
            (self.wind, ros.wind_message(stamp_ns, self.simulation.wind())),
            (self.steering, steering),
            (self.odom, ros.odometry_message(car.measure(stamp_ns))),
        ]
        if self.lock_step:
            self.state.insert(0, (self.clock, ClockMessage(clock=ros.time_message(stamp_ns))))
        self.send()

    def send(self) -> None:
        """Publish the last measurement."""
        for publisher, message in self.state:
            publisher.publish(message)

    def on_diagnostics(self) -> None:
        """Publish diagnostics once a second; in lock-step not before the first state."""
        if self.lock_step and not self.state:
            return
        values = {
            "elapsed": self.simulation.elapsed_ns / NANOSECONDS,
            "duration": self.simulation.scenario.duration,
            "speed": float(self.simulation.car.state[3]),
        }
        stamp_ns = self.stamp_ns if self.lock_step else self.now_ns
        missing = "" if self.lock_step else self.missing()
        if missing and self.is_driving:
            self.get_logger().warning(missing, throttle_duration_sec=5.0)
        conflict = self.sources.conflict
        self.report(stamp_ns, conflict or missing, values, ERROR if conflict else WARN)

    def missing(self) -> str:
        """Return which commands are missing or old in real-time mode, or an empty text."""
        if waits_for := self.waits_for():
            return f"the car waits at its start for {waits_for}"
        silent = {
            topic: (self.now_ns - answer.stamp_ns) / NANOSECONDS
            for topic, answer in self.answers.items()
        }
        old = [f"no {topic} for {age:.1f} s" for topic, age in silent.items() if age > MAX_SILENCE]
        return f"{' and '.join(old)}: the car continues with the last one" if old else ""


def main() -> int:
    """Run the node."""
    return spin(SimulatorNode)


if __name__ == "__main__":
    sys.exit(main())
