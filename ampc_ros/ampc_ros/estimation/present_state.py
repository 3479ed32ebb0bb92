"""The state at the time of a tick, and the car that is assumed for it."""

from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.assumed_car import AssumedCar, assumed_car
from ampc_ros.configuration import Configuration
from ampc_ros.controller_interface import Controller
from ampc_ros.estimation.adaptation import Adaptation
from ampc_ros.estimation.command_history import SETTLED, CommandHistory
from ampc_ros.estimation.state_prediction import StatePredictor
from ampc_ros.mpc.internal_model import LARGEST_LAG, SHORT_LAG

STEADY_TIME = 3.0
"""Time over which the disturbance is averaged that acts while there is no state: what the tyres do
in a fast manoeuvre does not last [s]."""
STEADY_ACCELERATION = 6.0
"""Lateral acceleration up to which it is averaged [m/s^2]."""


class PresentState:
    """Continues the newest state to the present, and adapts the model of the car."""

    def __init__(self, config: Configuration, controller: Controller) -> None:
        """Start at rest, with the configured car."""
        self.commands = CommandHistory(0.0, longest_history_ns(config))
        """Commands sent [rad], without the estimated offset."""
        self._answered_ns, self._first_ns, self._repeats = -1, 0, 0
        self._steady = 0.0, 0.0
        self._adaptation: Adaptation | None = None
        self._config: Configuration | None = None
        self.install(config, controller)

    def install(self, config: Configuration, controller: Controller) -> None:
        """Use another configuration; the estimates of the same car are kept."""
        before, self._config, self._controller = self._config, config, controller
        self.commands.longest_ns = longest_history_ns(config)
        self.predictor = StatePredictor(config, self.commands)
        self._period_ns = round(controller.period * NANOSECONDS)
        is_adaptive = config.settings.adaptation and controller.formulation == "preview"
        if not is_adaptive:
            self._adaptation = None
        elif self._adaptation is None or config.difference or not is_same_car(before, config):
            self._adaptation = Adaptation(config)
        self._use(self._adaptation.adapted_car if self._adaptation else assumed_car(config))

    @property
    def adaptation(self) -> Adaptation | None:
        """Estimation of the car; None: it is switched off."""
        return self._adaptation

    def _use(self, car: AssumedCar) -> None:
        """Use a car in prediction and controller."""
        self.car = car
        self.predictor.use(car)
        self._controller.use_car(car)

    def freeze(self) -> None:
        """Learn nothing about the car from this tick."""
        if self._adaptation:
            self._adaptation.freeze()

    def at(self, state: VehicleState, now_ns: int, *, is_measured: bool) -> VehicleState:
        """Return the state at the time of the tick.

        The error of a prediction over several ticks is learnt as that of so many ticks.

        Args:
            state: Newest state at `base_link`.
            now_ns: Time of the tick [ns].
            is_measured: Whether its yaw rate is the measured one.
        """
        assert self._config is not None
        controller = self._controller
        is_new = state.stamp_ns != self._answered_ns
        if is_new:
            controller.expect_after(self._repeats + 1)
            self._repeats, self._answered_ns, self._first_ns = 0, state.stamp_ns, now_ns
            is_linear = state.v_x * abs(state.yaw_rate) < STEADY_ACCELERATION
            share = min(controller.period / STEADY_TIME, 1.0) if is_linear else 0.0
            newest = controller.disturbance(state.v_x)
            lateral, yaw = (a + share * (b - a) for a, b in zip(self._steady, newest, strict=True))
            self._steady = lateral, yaw
        else:
            controller.hold_estimates()
            self._repeats += 1
        if is_new and is_measured and self._adaptation:
            self._adaptation.observe(state, self.commands)
            self._use(self._adaptation.adapted_car)
        if not is_measured:  # the slope of the heading replaces a yaw rate that is wrong
            if self._adaptation:  # and may have been wrong before
                self._adaptation.reset()
                self._use(self._adaptation.adapted_car)
            controller.distrust_noise()
        # The steady disturbance acts from the first answer on: an earlier one would feed back
        longest_ns = round(self._config.settings.state_prediction * NANOSECONDS)
        last_ns = min(now_ns, state.stamp_ns + longest_ns)
        self.predictor.disturbance = 0.0, 0.0
        answered = self.predictor.predict(state, min(self._first_ns, last_ns))
        self.predictor.disturbance = self._steady
        present = self.predictor.predict(answered, last_ns)
        self.predictor.disturbance = 0.0, 0.0
        return present


def longest_history_ns(config: Configuration) -> int:
    """Return the time for which commands are needed: prediction, delay and settling of a lag [ns].

    Both are those of an estimated steering, too.
    """
    steering = config.steering
    slowest = SETTLED * max(steering.time_constant, SHORT_LAG) + steering.delay + LARGEST_LAG
    return round((config.settings.state_prediction + slowest) * NANOSECONDS)


def is_same_car(a: Configuration | None, b: Configuration) -> bool:
    """Return whether two configurations describe the same car."""
    return a is not None and (a.chassis, a.steering) == (b.chassis, b.steering)
