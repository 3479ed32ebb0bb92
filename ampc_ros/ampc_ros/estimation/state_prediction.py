"""Prediction of a state from its stamp to the present, with the commands sent in the meantime."""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.types import VehicleState
from ampc_ros.assumed_car import AssumedCar, assumed_car
from ampc_ros.configuration import Configuration
from ampc_ros.estimation.command_history import CommandHistory

MODEL_ABOVE = 1.5
"""Speed from which the bicycle model is used; a slower car keeps its twist [m/s]."""
STEP = 0.01
"""Longest step of the integration [s]."""
MOST_STEPS = 10_000
"""Bound of the number of steps for a model with extreme parameters."""


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
    """Bicycle model with steering actuator that continues a state."""

    def __init__(self, config: Configuration, commands: CommandHistory) -> None:
        """Create the model of a configuration, with the commands sent."""
        self._to_cg, self._friction = config.base_link_to_cg, config.settings.friction
        self.commands = commands
        self.disturbance = 0.0, 0.0
        """Unmodelled lateral [m/s^2] and yaw acceleration [rad/s^2]."""
        self.use(assumed_car(config))

    def use(self, car: AssumedCar) -> None:
        """Use another car."""
        self._car = car

    def predict(self, state: VehicleState, end_ns: int) -> VehicleState:
        """Return the state at a later time; a state of that time or later is not changed.

        The speed is constant.

        Args:
            state: Measured state at `base_link`.
            end_ns: Time of the prediction [ns].
        """
        if end_ns <= state.stamp_ns:
            return state
        centre, (vehicle, response, offset) = at_distance(state, self._to_cg), self._car[:3]
        model = CarModel(vehicle, self._friction, response.lag, *self.disturbance)
        wheel = self.commands.wheel(state.stamp_ns, response) + offset
        motion = Motion(*centre[1:], wheel)
        for command, elapsed in self.commands.between(state.stamp_ns, end_ns, response.delay):
            motion = Motion(*advance_car(model, motion, command + offset, elapsed))
        centre = VehicleState(end_ns, *motion[:-1])._replace(yaw=wrap_angle(motion.yaw))
        return at_distance(centre, -self._to_cg)
