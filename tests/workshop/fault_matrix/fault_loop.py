"""A drive in which messages come when they come: the node's real time, computed.

The controller ticks on its own clock, states and paths arrive when the faults let them, and the car
drives on under the last command meanwhile. Nothing waits and nothing is read from a clock, so a
drive is repeated bit for bit, a hundred times as fast as real time.
"""

from collections import Counter
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.paths.path import Progress
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import SpeedPlanner
from ampc_msgs_config.types import NANOSECONDS, QUATERNION_LENGTH, Array, VehicleState
from ampc_ros.supervision.supervisor import Decision, Supervisor
from ampc_ros.supervision.ticks import Ticks
from launch_scripts.faults.messages import MAP, ODOM, PATH, STEERING, Message
from launch_scripts.faults.schedule import Injector
from sim_vehicle.closed_loop import Simulation

ODOM_NS, PATH_NS = 20_000_000, 500_000_000
"""From one state, and from one path, to the next [ns]."""
PHASE_NS = 10_000_000
"""By which the controller's ticks come after a state [ns]."""
BRAKING = 2.0
"""Deceleration of a driver who obeys: one that the tyres can spare in a bend [m/s^2]."""
START_NS = 1000 * NANOSECONDS
"""What clocks show at the start [ns]."""


class Tick(NamedTuple):
    """One command."""

    time: float
    """Since the start [s]."""
    v_x: float
    """Speed that the guard went by [m/s]."""
    decision: Decision


class Log(NamedTuple):
    """What happened in a drive."""

    time: Array
    """(n,) of the states [s]."""
    error: Array
    """Real cross-track error of the centre of gravity (n,) [m]."""
    speed: Array
    """Real (n,) [m/s]."""
    swing: Array
    """Real lateral acceleration, speed times yaw rate (n,) [m/s^2]."""
    ticks: list[Tick]
    rejected: Counter[str]
    """Inputs, by cause."""
    clips: Counter[str]
    """Commands clipped by the guard, by limit."""
    missed: int
    """Ticks without a command, as the node counts them."""


class FaultyDrive:
    """A car, its controller, and a line with faults between them."""

    def __init__(
        self,
        simulation: Simulation,
        supervisor: Supervisor,
        injector: Injector,
        *,
        obey: bool = False,
    ) -> None:
        """Stand at the start.

        Args:
            simulation: The car.
            supervisor: The controller; it is told everything by the line only.
            injector: The line.
            obey: The driver brakes once a stop is requested; else the car drives on, which is
                harder.
        """
        self.simulation, self.supervisor, self.line = simulation, supervisor, injector
        self.obey = obey
        self.points = simulation.scenario.points
        self.progress = Progress(make_path(self.points))
        self.planner = SpeedPlanner(simulation.scenario)
        self.ticks, self.period_ns = (
            Ticks(supervisor.period),
            round(supervisor.period * NANOSECONDS),
        )
        self.tick_ns, self.steering, self.speed = PHASE_NS, 0.0, 0.0
        self.answered_ns = -1
        self.refused: Counter[str] = Counter()
        self.seen: list[tuple[float, float, float, float]] = []
        self.told: list[Tick] = []

    @property
    def now_ns(self) -> int:
        """Time since the start [ns]."""
        return self.simulation.elapsed_ns

    def run(self, until: float) -> None:
        """Drive on to a time since the start [s]."""
        end_ns = round(until * NANOSECONDS)
        while self.now_ns < end_ns:
            self.measure()
            for message in self.line.due(self.now_ns):
                self.receive(message)
            if self.now_ns >= self.tick_ns:
                self.on_tick()
            self.advance()

    def advance(self) -> None:
        """Drive to where something happens next."""
        step_ns = self.simulation.step_ns
        next_state = (self.now_ns // ODOM_NS + 1) * ODOM_NS
        due = min(next_state, self.tick_ns, self.line.next_ns) - self.now_ns
        steps = max(-(-int(due) // step_ns), 1)
        self.simulation.advance(self.steering, self.speed, steps * step_ns)

    def measure(self) -> None:
        """Send what is measured and planned now on its way."""
        now_ns = self.now_ns
        if now_ns % ODOM_NS == 0:
            car, stamp_ns = self.simulation.car, START_NS + now_ns
            state = as_received(car.measure(stamp_ns))
            self.speed = self.target_speed(state)
            centre = at_distance(state, self.simulation.vehicle.chassis.cg_to_rear_axle)
            error = self.progress.errors(centre)[0]
            self.seen.append((now_ns / NANOSECONDS, error, state.v_x, state.v_x * state.yaw_rate))
            self.line.put(Message(STEERING, now_ns, stamp_ns, car.steering))
            self.line.put(Message(ODOM, now_ns, stamp_ns, state))
        if now_ns % PATH_NS == 0:
            self.line.put(Message(PATH, now_ns, START_NS + now_ns, self.points))

    def target_speed(self, state: VehicleState) -> float:
        """Give the planned speed, or, where the driver obeys a request to stop, less and less."""
        planned = self.planner.target_speed(state)
        if not (self.obey and self.supervisor.stop_requested):
            return planned
        return max(min(planned, self.speed) - BRAKING * ODOM_NS / NANOSECONDS, 0.0)

    def clock_ns(self) -> int:
        """Give the time of the controller's clock [ns]."""
        return START_NS + self.line.clock_ns(self.now_ns)

    def receive(self, message: Message) -> None:
        """Take a message as the node does: what is wrong is refused and counted."""
        cause = unreadable(message)
        if cause:
            self.refused[cause] += 1
            return
        try:
            self.take(message)
        except ValueError:
            if message.topic != ODOM:  # states are counted by the supervisor
                self.refused[message.topic] += 1

    def take(self, message: Message) -> None:
        """Give a message to the supervisor; a state that is waited for is answered at once."""
        supervisor = self.supervisor
        if message.topic == STEERING:
            supervisor.take_steering(message.value)
        elif message.topic == PATH:
            supervisor.take_path(message.value, message.stamp_ns, self.clock_ns())
        else:
            resets = supervisor.resets
            state = message.value._replace(stamp_ns=message.stamp_ns)
            supervisor.take_state(state, self.clock_ns())
            if supervisor.resets > resets:
                self.ticks.restart()
                self.answered_ns = -1
            if self.ticks.is_deferred:
                self.step()

    def on_tick(self) -> None:
        """Answer the newest state, once; where there is none, the next one is answered at once."""
        self.tick_ns += self.period_ns
        self.ticks.begin(self.now_ns, self.period_ns)
        newest = self.supervisor.newest_ns
        if newest != self.answered_ns or self.supervisor.is_state_late(self.clock_ns()):
            self.step()
        else:
            self.ticks.defer_to_next_state()

    def step(self) -> None:
        """Decide, and steer."""
        self.ticks.is_deferred = False
        self.supervisor.ladder.qp_fault = self.line.is_on("qp_fault", self.now_ns)
        decision = self.supervisor.tick(self.clock_ns())
        if decision:
            assert self.supervisor.state is not None
            self.steering, self.answered_ns = decision.command.steering, decision.command.stamp_ns
            v_x = self.supervisor.state.value.v_x
            self.told.append(Tick(self.now_ns / NANOSECONDS, v_x, decision))

    def log(self) -> Log:
        """Give what has happened so far."""
        time, error, speed, swing = np.array(self.seen).T
        filtered, clips = self.supervisor.filter.rejected, self.supervisor.guard.count
        rejected = self.refused + Counter({cause: n for cause, n in filtered.items() if n})
        clipped = Counter({limit: n for limit, n in clips.items() if n})
        return Log(time, error, speed, swing, self.told, rejected, clipped, self.ticks.missed)


def unreadable(message: Message) -> str:
    """Say why the node would not even unpack a message; empty: it would."""
    if message.frame_id != MAP:
        return "wrong_frame"
    return "" if QUATERNION_LENGTH[0] <= message.length <= QUATERNION_LENGTH[1] else "no_rotation"
