"""Prediction of a state from its stamp to the present, with the commands sent in the meantime."""

import math
from collections import deque
from dataclasses import astuple
from typing import NamedTuple

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.configuration import Configuration
from ampc_ros.mpc.internal_model import LARGEST_LAG

MODEL_ABOVE = 1.5
"""Speed from which the bicycle model is used; a slower car keeps its twist [m/s]."""
STEP = 0.01
"""Longest step of the integration [s]."""
MOST_STEPS = 10_000
"""Bound of the number of steps for a model with extreme parameters."""
SETTLED = 5.0
"""Time after which a first-order lag has settled, in time constants."""


class SentCommand(NamedTuple):
    """A command and the time from which it holds."""

    time_ns: int
    steering: float


class CarModel(NamedTuple):
    """Parameters of the prediction."""

    vehicle: tuple[float, float, float, float, float, float]
    """m, I_z, l_f, l_r, C_f, C_r."""
    friction: float
    lag: float
    """Time constant of the steering [s]."""
    lateral: float
    """Unmodelled lateral acceleration [m/s^2]."""
    yaw: float
    """Unmodelled yaw acceleration [rad/s^2]."""


class Motion(NamedTuple):
    """Motion of the centre of gravity, and the road-wheel angle."""

    x: float
    y: float
    yaw: float
    v_x: float
    v_y: float
    yaw_rate: float
    steering: float


@compiled
def axle_force(stiffness: float, limit: float, slip_angle: float) -> float:
    """Return the lateral force of an axle, which saturates at the limit of friction [N].

    For small slip angles it is that of Eq. (7).

    Args:
        stiffness: Cornering stiffness of both tyres [N/rad].
        limit: Friction times load [N].
        slip_angle: [rad].
    """
    return limit * math.tanh(stiffness * slip_angle / limit)


@compiled
def advance_car(
    model: CarModel, motion: Motion, command: float, elapsed: float
) -> tuple[float, float, float, float, float, float, float]:
    """Return the `Motion` after a time with a constant command: midpoint rule.

    The single-track model of Eqs. (1)-(3) with `axle_force` and first-order steering lag.

    Args:
        model: Parameters.
        motion: Motion at the start.
        command: Commanded angle, after its delay [rad].
        elapsed: Time [s].
    """
    m, I_z, l_f, l_r, C_f, C_r = model.vehicle
    x, y, yaw, v, v_y, r, steering = motion
    steering = steering if model.lag > 0.0 else command
    load = model.friction * m * GRAVITY / (l_f + l_r)
    stiff = 2.0 * max((C_f + C_r) / m, (C_f * l_f**2 + C_r * l_r**2) / I_z) / max(v, MODEL_ABOVE)
    steps = min(max(math.ceil(elapsed * max(1.0 / STEP, stiff)), 1), MOST_STEPS)
    h = elapsed / steps
    keep = math.exp(-0.5 * h / model.lag) if model.lag > 0.0 else 0.0
    for _ in range(steps):
        # State at the middle of the step, then the whole step with the slope there
        u, w, q, heading = v_y, r, steering, yaw
        for half in (0.5 * h, h):
            dv, dr = 0.0, 0.0
            if v >= MODEL_ABOVE:
                front = axle_force(2 * C_f, load * l_r, q - (u + l_f * w) / v)
                rear = axle_force(2 * C_r, load * l_f, (l_r * w - u) / v)
                dv = (front + rear) / m - v * w + model.lateral
                dr = (l_f * front - l_r * rear) / I_z + model.yaw
            heading, middle_v, middle_r = yaw + half * w, u, w
            u, w = v_y + half * dv, r + half * dr
            q = command + (steering - command) * (keep if half < h else keep * keep)
        x += h * (v * math.cos(0.5 * (yaw + heading)) - middle_v * math.sin(0.5 * (yaw + heading)))
        y += h * (v * math.sin(0.5 * (yaw + heading)) + middle_v * math.cos(0.5 * (yaw + heading)))
        yaw, v_y, r, steering = yaw + h * middle_r, u, w, q
    return x, y, yaw, v, v_y, r, steering


class StatePredictor:
    """Bicycle model with steering actuator that continues a state; it stores the commands sent."""

    def __init__(self, config: Configuration, steering: float) -> None:
        """Create the model of a configuration; `steering` is the angle in force [rad]."""
        self._to_cg = config.base_link_to_cg
        self.use_steering(config.steering.delay, config.steering.time_constant)
        self.disturbance = 0.0, 0.0
        """Unmodelled lateral [m/s^2] and yaw acceleration [rad/s^2]."""
        unknown = 0.0 if config.steering.is_lag_configured else LARGEST_LAG
        longest = config.settings.state_prediction + unknown
        self._history_ns = round(longest * NANOSECONDS) + self._delay_ns + self._settling_ns
        friction = config.settings.friction
        self._vehicle, self._friction = astuple(config.chassis), friction
        self.reset(steering)

    def reset(self, steering: float) -> None:
        """Forget the commands sent; `steering` is the angle in force [rad]."""
        self._sent: deque[SentCommand] = deque()
        self._before = steering

    def inherit(self, other: "StatePredictor") -> None:
        """Continue with the commands of another predictor."""
        self._sent, self._before = other._sent, other._before

    def use_steering(self, delay: float, lag: float) -> None:
        """Use another delay and lag of the steering [s]."""
        self._delay_ns, self._lag = round(delay * NANOSECONDS), lag
        self._settling_ns = round(SETTLED * lag * NANOSECONDS)

    def store(self, steering: float, now_ns: int) -> None:
        """Store the command [rad] that is sent now [ns].

        After a clock that was set back the times of the earlier commands mean nothing: the newest
        of them counts as in force since long ago.
        """
        if self._sent and now_ns < self._sent[-1].time_ns:
            self.reset(self._sent[-1].steering)
        if self._sent and now_ns == self._sent[-1].time_ns:
            self._sent.pop()
        while self._sent and self._sent[0].time_ns < now_ns - self._history_ns:
            self._before = self._sent.popleft().steering
        self._sent.append(SentCommand(now_ns, steering))

    def correct(self, steering: float) -> None:
        """Replace the newest command: another angle [rad] was sent."""
        if self._sent:
            self._sent[-1] = self._sent[-1]._replace(steering=steering)
        else:
            self._before = steering

    def predict(self, state: VehicleState, end_ns: int) -> VehicleState:
        """Return the state at a later time; a state of that time or later is not changed.

        The speed is constant.

        Args:
            state: Measured state at `base_link`.
            end_ns: Time of the prediction [ns].
        """
        if end_ns <= state.stamp_ns:
            return state
        car = at_distance(state, self._to_cg)
        model = CarModel(self._vehicle, self._friction, self._lag, *self.disturbance)
        motion = Motion(*car[1:], self._wheel(state.stamp_ns))
        for command, elapsed in self._commands(state.stamp_ns, end_ns):
            motion = Motion(*advance_car(model, motion, command, elapsed))
        car = VehicleState(end_ns, *motion[:-1])._replace(yaw=wrap_angle(motion.yaw))
        return at_distance(car, -self._to_cg)

    def _commands(self, begin_ns: int, end_ns: int) -> list[tuple[float, float]]:
        """Return the commands that leave the delay between two times [rad], and how long [s]."""
        commands = []
        for time_ns, steering in reversed(self._sent):
            if begin_ns >= end_ns:
                break
            since_ns = max(time_ns + self._delay_ns, begin_ns)
            if since_ns < end_ns:
                commands.append((steering, (end_ns - since_ns) / NANOSECONDS))
                end_ns = since_ns
        if begin_ns < end_ns:
            commands.append((self._before, (end_ns - begin_ns) / NANOSECONDS))
        return commands[::-1]

    def _wheel(self, time_ns: int) -> float:
        """Return the road-wheel angle at a time, after delay and lag [rad]."""
        commands = self._commands(time_ns - self._settling_ns, time_ns)
        angle = commands[0][0] if commands else self._before
        for command, elapsed in commands:
            angle = command + (angle - command) * math.exp(-elapsed / self._lag)
        return angle
