"""The gate without ROS: passes commands on, or brakes along the last plan.

All times are arguments: seconds of one steady clock. The inputs are checked where they arrive;
`step` decides from their ages alone what the car receives.
"""

import math
from typing import NamedTuple

from ampc_msgs_config.parameters import ChassisParameters, GuardLimits
from ampc_ros.gate.following import MeasuredPose, followed_angle, place_on, pose_correction
from ampc_ros.gate.plan import SteeringPlan
from ampc_ros.gate.settings import DRIVES, STOPS, GateSettings, GateState
from ampc_ros.supervision.guard import (
    LONGEST_PAUSE,
    MAX_GUARD_SPEED,
    MAX_MEASURED,
    Guard,
    bounds,
)

SPEED_TIMEOUT = 1.0
"""Age of the target speed that stops the car [s]."""
PLAN_TIMEOUT = 0.6
"""A plan that is older when it is needed is not followed [s]."""
MEASURED_TIMEOUT = 0.5
"""Older measurements of speed and angle are not used [s]."""
POSE_TIMEOUT = 0.2
"""The same for a pose [s]."""
LIMIT_SHARE = 1.25
"""The controller may know another speed: its angle may reach this share of the gate's limit before
it counts as unsafe. What is published is clipped at the limit itself."""
CONVERSION_ERROR = 1e-9
"""Differences below this come from ratio and offset of the steering topics [rad]."""
CREEPING = 0.2
"""A slower car stands [m/s]."""


class Measured(NamedTuple):
    """A number and its arrival."""

    value: float
    at: float
    """Steady time [s]."""


class ReceivedCommand(NamedTuple):
    """The last sound steering command."""

    angle: float
    """Road-wheel angle [rad]."""
    rate: float
    """Its rate [rad/s]."""
    at: float
    """Arrival, steady time [s]."""


class ReceivedPlan(NamedTuple):
    """The last plan."""

    plan: SteeringPlan
    at: float
    """Arrival, steady time [s]."""
    odometer: float
    """Distance that the car had travelled at that time [m]."""


class GateOutput(NamedTuple):
    """What the car receives."""

    angle: float
    """Road-wheel angle [rad]."""
    rate: float
    """Its rate [rad/s]."""
    speed: float
    """Speed [m/s]."""
    is_command: bool
    """The angle is that of the last command, unchanged."""

    def curvature(self, wheelbase: float) -> float:
        """Return the curvature that the angle gives a slow car with a wheelbase [m] [1/m]."""
        return math.tan(self.angle) / wheelbase


class Gate:
    """Decides what the car receives."""

    def __init__(
        self, limits: GuardLimits, chassis: ChassisParameters, settings: GateSettings
    ) -> None:
        """Wait for the inputs.

        Args:
            limits: Limits by speed, applied to each output.
            chassis: Parameters of the car.
            settings: Times and limits of the gate.
        """
        self.settings = settings
        self.guard = Guard(limits, chassis, settings.period)
        self.state, self.reason = GateState.WAITING, ""
        self.command: ReceivedCommand | None = None
        self._heard: float | None = None
        """Angle of the last finite command, sound or not [rad]."""
        self.target: Measured | None = None
        self.speed: Measured | None = None
        self.pose: tuple[MeasuredPose, float] | None = None
        """Measured pose and its arrival."""
        self.measured: Measured | None = None
        self.plan: ReceivedPlan | None = None
        self.output: GateOutput | None = None
        self.intruders = ""
        """Second publishers of an input, in one sentence; empty: none."""
        self.suspicion = ""
        """Event since the last sound command that makes it doubtful; empty: none."""
        self.odometer, self._travelled_at = 0.0, -math.inf
        self._moved_at = self._stepped_at = -math.inf
        self._stop_at, self._stop_speed = math.inf, 0.0
        self._stop_plan: ReceivedPlan | None = None
        self._follows_commands = False

    def step(self, now: float) -> GateOutput | None:
        """Return what the car receives at a time [s]; None while waiting."""
        # Plans are followed by the distance travelled since their arrival.
        self._travel(now)

        # The state follows from the ages of the inputs; a stop is latched.
        self._decide(now)
        if self.state is GateState.WAITING:
            return None

        # Angle: that of the command while it is sound, else that of the plan, else the last one.
        command = self._sound_command(now)
        if command:
            angle, rate = command.angle, command.rate
        else:
            angle = self._planned_angle(now)
            rate = (angle - self.guard.steering) / self.settings.period

        # Speed: the target, or the falling speed of a stop.
        speed = self._commanded_speed(now)

        # The guard limits each change over the true time since the last one, of a plan, which is
        # followed in every round, since the last round. Time in which it has held the angle back
        # does not add up.
        before, since = self.guard.steering, self._moved_at if command else self._stepped_at
        self._stepped_at = now
        guarded = self.guard.step(
            angle,
            rate,
            self.speed_at(now),
            value_of(self.measured, now),
            now - since,
        )
        if guarded.steering != before or guarded.steering != angle:
            self._moved_at = now
        is_command = command is not None and abs(guarded.steering - angle) <= CONVERSION_ERROR
        self.output = GateOutput(guarded.steering, guarded.steering_rate, speed, is_command)
        return self.output

    def take_command(self, angle: float, rate: float, now: float) -> str:
        """Use a steering command, or return in one sentence why it is unsafe.

        Args:
            angle: Road-wheel angle [rad].
            rate: Its rate [rad/s].
            now: Arrival, steady time [s].
        """
        problem = self._danger(angle, rate, now)
        self._heard = angle if math.isfinite(angle) else self._heard
        if problem:
            self.suspect(problem)
        else:
            self.command, self.suspicion = ReceivedCommand(angle, rate, now), ""
        return problem

    def _danger(self, angle: float, rate: float, now: float) -> str:
        """Return why a command is unsafe; empty: it is sound."""
        if not (math.isfinite(angle) and math.isfinite(rate)):
            return f"steering_command: angle {angle:g} rad, rate {rate:g} rad/s must be finite"
        guard = self.guard
        bound = bounds(guard.limits, guard.chassis, self.speed_at(now))
        most = LIMIT_SHARE * min(bound.angle, bound.acceleration)
        is_followed = self.command is not None and self.state in DRIVES
        last = self.command.angle if self.command and is_followed else self._heard
        if last is not None:
            # A sound controller moves at most at the limit of the rate, and after a pause as far
            # as in two periods. One that has jumped does not become sound by staying there.
            turn = LONGEST_PAUSE * self.settings.period * min(bound.rate, bound.jerk)
            reach = turn + CONVERSION_ERROR
            if abs(angle - last) > reach:
                step = f"{angle - last:.3f} rad from the last one"
                return f"steering_command: step of {step} must lie within {reach:.3f} rad"
            most = max(most, abs(last))  # it may be on its way back
        if abs(angle) > most:
            return f"steering_command: angle {angle:.3f} must lie in [{-most:.3f}, {most:.3f}] rad"
        return ""

    def suspect(self, event: str) -> None:
        """Distrust the last command until the next sound one; the event in one sentence."""
        self.suspicion = event

    def take_speed(self, speed: float, now: float) -> str:
        """Use a target speed [m/s], or return in one sentence why it is refused."""
        if not 0.0 <= speed <= MAX_GUARD_SPEED:
            return f"target_speed: {speed:g} must lie in [0, {MAX_GUARD_SPEED:g}] m/s"
        self.target = Measured(speed, now)
        return ""

    def take_plan(self, plan: SteeringPlan, now: float) -> None:
        """Use a plan that starts now."""
        self._travel(now)
        self.plan = ReceivedPlan(plan, now, self.odometer)

    def take_odometry(self, pose: MeasuredPose, now: float) -> None:
        """Use a measured pose with its speed; an impossible one is ignored."""
        if abs(pose.v_x) <= MAX_GUARD_SPEED:
            self._travel(now)
            self.speed = Measured(pose.v_x, now)
            self.pose = (pose, now) if all(map(math.isfinite, pose)) else None

    def take_measured(self, angle: float, now: float) -> None:
        """Use a measured road-wheel angle [rad]; an impossible one is ignored."""
        if abs(angle) <= MAX_MEASURED:
            self.measured = Measured(angle, now)

    def reset(self, now: float) -> str:
        """Drive again after a stop, from the present angle, or return why not in one sentence."""
        if self.state not in STOPS:
            return f"the gate is {self.state.value}: there is no stop to reset"
        problem = self._fault(now) or self._doubt(now)
        if not problem and self.plan and now - self.plan.at > PLAN_TIMEOUT:
            problem = f"steering_plan is {now - self.plan.at:.1f} s old"
        if not problem:
            self.state, self.reason = GateState.DRIVING, ""
        return problem

    def speed_at(self, now: float) -> float:
        """Return the speed of the car [m/s]: measured, else commanded, else the target."""
        measured = value_of(self.speed, now)
        if measured is not None:
            return measured
        if self.output:
            return self.output.speed
        return self.target.value if self.target else 0.0

    def _travel(self, now: float) -> None:
        """Add the distance since the last call."""
        if self.state is not GateState.WAITING:
            self.odometer += max(self.speed_at(now), 0.0) * max(now - self._travelled_at, 0.0)
        self._travelled_at = now

    def _decide(self, now: float) -> None:
        """Change the state."""
        fault = self._fault(now)
        if self.state is GateState.WAITING:
            self.reason = fault
            if fault:
                return
            self._begin(now)
        if self.state in DRIVES:
            self.reason = fault or self._doubt(now) or self._missing_plan(now)
            self.state = GateState.DEGRADED if self.reason else GateState.DRIVING
            if fault:
                self._stop(now)
        elif self.intruders:
            self._follows_commands = False
        if self.state is GateState.STOPPING and self._stands(now):
            self.state = GateState.STOPPED

    def _fault(self, now: float) -> str:
        """Return why the car must stop, or must not start yet; empty: it may drive."""
        if self.intruders:
            return self.intruders
        age = now - self.command.at if self.command else math.inf
        if age > self.settings.command_timeout:
            why = f" ({self.suspicion})" if self.suspicion else ""
            return f"no sound steering_command{age_text(age)}{why}"
        age = now - self.target.at if self.target else math.inf
        return f"no target_speed{age_text(age)}" if age > SPEED_TIMEOUT else ""

    def _doubt(self, now: float) -> str:
        """Return why the last command is not followed; empty: it is."""
        if self.suspicion or not self.command:
            return self.suspicion
        age = now - self.command.at
        return f"steering_command is {age:.2f} s old" if age > self.settings.late else ""

    def _missing_plan(self, now: float) -> str:
        """Return why a stop would have no plan; empty: it would have one."""
        age = now - self.plan.at if self.plan else math.inf
        text = f"no steering_plan{age_text(age)}: a stop would hold the angle"
        return text if age > PLAN_TIMEOUT else ""

    def _begin(self, now: float) -> None:
        """Start to drive, from the measured angle where it is known."""
        assert self.command
        measured = value_of(self.measured, now)
        self.guard.reset(self.command.angle if measured is None else measured)
        self.state, self._moved_at = GateState.DRIVING, now

    def _stop(self, now: float) -> None:
        """Start to brake from the lower one of measured and commanded speed."""
        # The commands are still followed where they are sound and only the speed is missing.
        self._follows_commands = not (self.intruders or self._doubt(now))
        commanded = self.output.speed if self.output else 0.0
        self._stop_speed = min(commanded, max(self.speed_at(now), 0.0))
        self._stop_at, self._stop_plan = now, self.plan
        self.state = GateState.STOPPING

    def _stands(self, now: float) -> bool:
        """Return whether the car is commanded to stand, and does."""
        stands = abs(value_of(self.speed, now) or 0.0) < CREEPING
        return stands and self._commanded_speed(now) == 0.0

    def _sound_command(self, now: float) -> ReceivedCommand | None:
        """Return the last command if it is to be followed."""
        is_trusted = self.state in DRIVES or (
            self.state is GateState.STOPPING and self._follows_commands
        )
        return self.command if is_trusted and not self._doubt(now) else None

    def _planned_angle(self, now: float) -> float:
        """Return the angle of the last plan, or the last angle where there is none [rad]."""
        is_stop = self.state in STOPS
        needed_at = self._stop_at if is_stop else now
        plan = self._stop_plan if is_stop and not self._follows_commands else self.plan
        if not plan or needed_at - plan.at > PLAN_TIMEOUT or self.state is GateState.STOPPED:
            return self.guard.steering
        chassis, distance, change = self.guard.chassis, self.odometer - plan.odometer, 0.0
        if self.pose and now - self.pose[1] <= POSE_TIMEOUT:
            pose = self.pose[0].after(now - self.pose[1])
            if place := place_on(plan.plan, pose, distance):
                self.odometer, distance = plan.odometer + place.distance, place.distance
                change = pose_correction(place, chassis, pose)
        return change + followed_angle(plan.plan, chassis, distance, self.speed_at(now))

    def _commanded_speed(self, now: float) -> float:
        """Return the target speed, or the falling speed of a stop [m/s]."""
        if self.state in STOPS:
            fallen = self.settings.deceleration * (now - self._stop_at)
            return max(self._stop_speed - fallen, 0.0)
        assert self.target
        return self.target.value


def value_of(measured: Measured | None, now: float) -> float | None:
    """Return a measured number, or None where it is missing or old."""
    return measured.value if measured and now - measured.at <= MEASURED_TIMEOUT else None


def age_text(age: float) -> str:
    """Return an age [s] as the end of `no <topic>`."""
    return f" for {age:.2f} s" if age < math.inf else " yet"
