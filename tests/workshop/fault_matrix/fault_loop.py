"""A drive with faults in the messages: the node's real time, simulated.

The controller ticks on its own clock by the TickPolicy of the node. States and paths arrive as the
faults allow, and the car continues under the last command meanwhile. Nothing waits and no clock is
read, so a drive is repeatable bit for bit, a hundred times as fast as real time.
"""

from collections import Counter
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.paths.path import Progress
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import SpeedPlanner
from ampc_msgs_config.topics import MAP
from ampc_msgs_config.types import NANOSECONDS, QUATERNION_LENGTH, Array, TickRecord, VehicleState
from ampc_ros.gate.core import Gate
from ampc_ros.gate.following import MeasuredPose
from ampc_ros.gate.plan import PlanPoint, SteeringPlan, make_plan
from ampc_ros.supervision.stopping_plan import StoppingPlan
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.tick_policy import Action, TickPolicy
from launch_scripts.faults.messages import ODOM_INPUT, PATH, STEERING_INPUT, Message
from launch_scripts.faults.schedule import Injector
from sim_vehicle.closed_loop import Simulation

ODOM_NS, PATH_NS = 20_000_000, 500_000_000
"""Periods of states and of paths [ns]."""
PHASE_NS = 10_000_000
"""Delay of the controller's ticks after a state [ns]."""
BRAKING = 2.0
"""Deceleration of a driver who obeys, possible for the tyres in a bend [m/s^2]."""
START_NS = 1000 * NANOSECONDS
"""Time of the clocks at the start [ns]."""


class CommandedTick(NamedTuple):
    """One command."""

    time: float
    """Time since the start [s]."""
    v_x: float
    """Speed used by the guard [m/s]."""
    record: TickRecord


class Log(NamedTuple):
    """Log of a drive."""

    time: Array
    """Times of the states (n,) [s]."""
    error: Array
    """True cross-track error of the centre of gravity (n,) [m]."""
    speed: Array
    """True speed (n,) [m/s]."""
    swing: Array
    """True lateral acceleration, speed times yaw rate (n,) [m/s^2]."""
    ticks: list[CommandedTick]
    rejected: Counter[str]
    """Rejected inputs by cause."""
    clips: Counter[str]
    """Commands clipped by the guard, by limit."""
    missed: int
    """Missed ticks, as the node counts them."""


class FaultyDrive:
    """A car, its controller, and a faulty line between them."""

    def __init__(
        self,
        simulation: Simulation,
        supervisor: Supervisor,
        injector: Injector,
        *,
        obey: bool = False,
        gate: Gate | None = None,
    ) -> None:
        """Start at rest.

        Args:
            simulation: The car.
            supervisor: The controller; all its inputs come over the line.
            injector: The line.
            obey: The driver brakes once a stop is requested; else the car drives on, which is
                harder.
            gate: Gate between controller and car, which hears odometry and steering sensor over
                the line, too; None: the car receives the commands themselves.
        """
        self.gate = gate
        self.simulation, self.supervisor, self.line = simulation, supervisor, injector
        self.obey = obey
        self.points = simulation.scenario.points
        self.progress = Progress(make_path(self.points))
        self.planner = SpeedPlanner(simulation.scenario)
        self.policy = TickPolicy(supervisor)
        self.period_ns = round(supervisor.period * NANOSECONDS)
        self.tick_ns, self.steering, self.speed = PHASE_NS, 0.0, 0.0
        self.rejected: Counter[str] = Counter()
        self.samples: list[tuple[float, float, float, float]] = []
        self.ticks: list[CommandedTick] = []

    @property
    def now_ns(self) -> int:
        """Time since the start [ns]."""
        return self.simulation.elapsed_ns

    def run(self, until: float) -> None:
        """Drive until a time since the start [s]."""
        end_ns = round(until * NANOSECONDS)
        while self.now_ns < end_ns:
            self.measure()
            for message in self.line.due(self.now_ns):
                self.receive(message)
            if self.now_ns >= self.tick_ns:
                self.on_timer()
            self.advance()

    def advance(self) -> None:
        """Drive until the next event."""
        step_ns = self.simulation.step_ns
        next_state = (self.now_ns // ODOM_NS + 1) * ODOM_NS
        due = min(next_state, self.tick_ns, self.line.next_ns) - self.now_ns
        steps = max(-(-int(due) // step_ns), 1)
        angle, speed = self.passed_on()
        self.simulation.advance(angle, speed, steps * step_ns)

    def passed_on(self) -> tuple[float, float]:
        """Return angle [rad] and speed [m/s] that the car receives."""
        if self.gate is None:
            return self.steering, self.speed
        now = self.now_ns / NANOSECONDS
        self.gate.take_speed(self.speed, now)
        output = self.gate.step(now)
        return (output.angle, output.speed) if output else (self.steering, self.speed)

    def tell_gate(self, message: Message) -> None:
        """Let the gate hear a readable message, as its node does."""
        assert self.gate
        now = self.now_ns / NANOSECONDS
        if message.topic == STEERING_INPUT:
            self.gate.take_measured(message.value, now)
        elif message.topic == ODOM_INPUT:
            state = message.value
            pose = MeasuredPose(state.x, state.y, state.yaw, state.v_x, state.v_y)
            self.gate.take_odometry(pose, now)

    def measure(self) -> None:
        """Send the measurements and the path of this time over the line."""
        now_ns = self.now_ns
        if now_ns % ODOM_NS == 0:
            car, stamp_ns = self.simulation.car, START_NS + now_ns
            state = as_received(car.measure(stamp_ns))
            self.speed = self.target_speed(state)
            centre = at_distance(state, self.simulation.vehicle.chassis.cg_to_rear_axle)
            error = self.progress.errors(centre)[0]
            self.samples.append(
                (now_ns / NANOSECONDS, error, state.v_x, state.v_x * state.yaw_rate)
            )
            self.line.put(Message(STEERING_INPUT, now_ns, stamp_ns, car.steering))
            self.line.put(Message(ODOM_INPUT, now_ns, stamp_ns, state))
        if now_ns % PATH_NS == 0:
            self.line.put(Message(PATH, now_ns, START_NS + now_ns, self.points))

    def target_speed(self, state: VehicleState) -> float:
        """Return the planned speed, or a falling one where the driver obeys a request to stop."""
        planned = self.planner.target_speed(state)
        if not (self.obey and self.supervisor.stop_requested):
            return planned
        return max(min(planned, self.speed) - BRAKING * ODOM_NS / NANOSECONDS, 0.0)

    def clock_ns(self) -> int:
        """Return the time of the controller's clock [ns]."""
        return START_NS + self.line.clock_ns(self.now_ns)

    def receive(self, message: Message) -> None:
        """Use a message as the node does: an invalid one is rejected and counted."""
        cause = unreadable(message)
        if cause:
            self.rejected[cause] += 1
            return
        if self.gate:
            self.tell_gate(message)
        try:
            self.take(message)
        except ValueError:
            if message.topic != ODOM_INPUT:  # states are counted by the supervisor
                self.rejected[message.topic] += 1

    def take(self, message: Message) -> None:
        """Pass a message to the supervisor; after a deferred tick a state is answered at once."""
        supervisor = self.supervisor
        if message.topic == STEERING_INPUT:
            supervisor.take_steering(message.value)
        elif message.topic == PATH:
            supervisor.take_path(message.value, message.stamp_ns, self.clock_ns())
        else:
            state = message.value._replace(stamp_ns=message.stamp_ns)
            self.policy.take_state(state, self.clock_ns())
            self.act(self.policy.on_input())

    def on_timer(self) -> None:
        """Call the timer of the policy."""
        self.tick_ns += self.period_ns
        self.act(self.policy.on_timer(self.clock_ns(), self.period_ns))

    def act(self, action: Action) -> None:
        """Tick and steer where the policy calls for it."""
        if action is not Action.TICK:
            return
        self.supervisor.inject_qp_fault(self.line.is_on("qp_fault", self.now_ns))
        record = self.policy.tick(self.clock_ns())
        if record:
            assert self.supervisor.state is not None
            self.steering = record.command.steering
            v_x = self.supervisor.state.value.v_x
            if self.gate:
                self.command_gate(record)
            self.ticks.append(CommandedTick(self.now_ns / NANOSECONDS, v_x, record))

    def command_gate(self, record: TickRecord) -> None:
        """Send command and plan to the gate."""
        assert self.gate
        now, command = self.now_ns / NANOSECONDS, record.command
        problem = self.gate.take_command(command.steering, command.steering_rate, now)
        self.rejected["gate"] += bool(problem)
        if plan := self.supervisor.stopping_plan(self.clock_ns()):
            self.gate.take_plan(received_plan(plan), now)

    def log(self) -> Log:
        """Return the log until now."""
        time, error, speed, swing = np.array(self.samples).T
        supervisor = self.supervisor
        rejected = self.rejected + Counter({key: n for key, n in supervisor.rejected.items() if n})
        clipped = Counter({limit: n for limit, n in supervisor.clips.items() if n})
        return Log(time, error, speed, swing, self.ticks, rejected, clipped, self.policy.missed)


def received_plan(plan: StoppingPlan) -> SteeringPlan:
    """Return a plan of the controller as the gate receives it."""
    rows = zip(*(each.tolist() for each in plan), strict=True)
    return make_plan([PlanPoint(*row) for row in rows])


def unreadable(message: Message) -> str:
    """Return why the node could not unpack a message; empty: it could."""
    if message.frame_id != MAP:
        return "wrong_frame"
    return "" if QUATERNION_LENGTH[0] <= message.length <= QUATERNION_LENGTH[1] else "no_rotation"
