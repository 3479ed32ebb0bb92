"""One car that lives across control periods."""

from dataclasses import astuple

import numpy as np

from ampc_msgs_config.types import Array, VehicleState
from ampc_msgs_config.validation import check_range, number
from sim_vehicle.measurement import Deviations, measured, noisy
from sim_vehicle.parameters import MeasurementNoise, Vehicle
from sim_vehicle.vehicle import CAR_STEERING, CAR_V_X, SIZE, WORK_SIZE, drive_steps
from sim_vehicle.vehicle_row import vehicle_numbers

CAR_RANGES = {
    "x": number(-1.0e9, 1.0e9, "m"),
    "y": number(-1.0e9, 1.0e9, "m"),
    "yaw": number(-1.0e3, 1.0e3, "rad"),
    "speed": number(0.0, 100.0, "m/s"),
    "step": number(1.0e-5, 0.02, "s"),
    "friction": number(0.01, 3.0),
    "steering": number(-10.0, 10.0, "rad"),
    "target_speed": number(0.0, 100.0, "m/s"),
    "wind": number(-100.0, 100.0, "m/s"),
}


class Car:
    """Simulated car with steering actuator and driver.

    Attributes:
        state: (SIZE,) state, see `vehicle.py`.
        friction: Coefficient mu; may be changed during the drive.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        speed: float = 0.0,
        *,
        friction: float | None = None,
        step: float = 0.005,
        noise: MeasurementNoise | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Create a car that rolls straight ahead.

        Args:
            vehicle: Parameters.
            start: x and y of the CENTRE OF GRAVITY [m] and yaw [rad] in `map`.
            speed: Longitudinal speed [m/s].
            friction: Coefficient mu; by default that of the tyres.
            step: Integration step [s]; the steering delay is rounded to a multiple of it.
            noise: Noise of `measure`.
            rng: Random numbers of the noise.

        Raises:
            ValueError: Names the argument, its value and its bound.
        """
        self.friction = vehicle.tyre.friction if friction is None else friction
        x, y, yaw = start
        _check(x=x, y=y, yaw=yaw, speed=speed, step=step, friction=self.friction)
        if noise is not None and rng is None:
            raise ValueError("noise needs rng, a numpy Generator")
        self.state: Array = np.zeros(SIZE)
        self.state[: CAR_V_X + 1] = x, y, yaw, speed
        self.waiting: Array = np.zeros(round(vehicle.steering.delay / step))
        self._numbers, self._step = vehicle_numbers(vehicle), step
        self._work = np.empty(WORK_SIZE)
        self._to_rear_axle = -vehicle.chassis.cg_to_rear_axle
        self.noise, self.rng = noise, rng

    @property
    def steering(self) -> float:
        """Road-wheel angle [rad]."""
        return float(self.state[CAR_STEERING])

    def advance(self, steering: float, target_speed: float, wind: Array) -> None:
        """Integrate one control period: one step for each row of the wind.

        Args:
            steering: Commanded road-wheel angle [rad].
            target_speed: Target speed of the driver [m/s].
            wind: Velocity of the air in `map` [m/s]: (n, 3, 2) at begin, middle and end of each
                step, or (n, 2) constant during each step.

        Raises:
            ValueError: Names the argument, its value and its bound.
        """
        if wind.shape[1:] not in ((2,), (3, 2)) or len(wind) == 0:
            raise ValueError(f"wind has shape {wind.shape}, must be (n, 2) or (n, 3, 2), n > 0")
        _check(steering=steering, target_speed=target_speed)
        _check(wind=float(wind.max()))
        _check(wind=float(wind.min()))
        self.state = self.state.copy()  # references to the old state stay valid
        stages = wind if wind.ndim == 3 else np.repeat(wind[:, np.newaxis], 3, axis=1)
        drive_steps(
            self.state,
            self.waiting,
            steering,
            target_speed,
            stages,
            0,
            len(wind),
            self.friction,
            self._step,
            self._numbers,
            self._work,
        )

    def measure(self, stamp_ns: int) -> VehicleState:
        """Return the measured motion of `base_link`, the centre of the rear axle."""
        exact = measured(self.state, self._to_rear_axle, stamp_ns)
        if self.noise is None or self.rng is None:
            return exact
        return noisy(exact, Deviations(*astuple(self.noise)), self.rng.standard_normal(6))


def _check(**values: float) -> None:
    for name, value in values.items():
        check_range(name, value, CAR_RANGES[name])
