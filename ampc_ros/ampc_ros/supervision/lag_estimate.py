"""Estimation of an unknown lag of the steering from the yaw rate, while the car is driven."""

from ampc_msgs_config.parameters import ASSUMED_LAG
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.mpc.internal_model import LARGEST_LAG, SHORT_LAG
from ampc_ros.supervision.state_prediction import StatePredictor

SHORTEST, LONGEST = 0.09, 0.5
"""Time over which the yaw rate is predicted: long enough for a signal above the noise [s]."""
LONG_LAG = 0.2
"""Lag from which the filter acts fully, also without noise [s]."""
DIFFERENCE = 0.02
"""Difference of two lags whose predictions are compared [s]."""
START_DEVIATION = 0.06
"""Standard deviation of the assumed lag [s]."""
WALK = 0.004
"""Random walk of the lag [s / s^0.5]."""
DEVIATION, DEVIATION_SHARE = 0.03, 0.1
"""Standard deviation of a predicted yaw rate: noise [rad/s], and share of the yaw rate, for model
errors."""
SLOWEST = 3.0
"""Speed from which the lag is estimated [m/s]."""
MOST_ACCELERATION = 4.0
"""Lateral acceleration up to which the tyres are linear enough [m/s^2]."""
MOST_RESIDUAL = 0.3
"""Larger residuals of the yaw rate are no effect of the lag [rad/s]."""


class LagEstimate:
    """Recursive least squares for one parameter: which lag predicts the measured yaw rate.

    Ljung, "System Identification", 2nd edition, Section 11.4: prediction-error method, where the
    gradient is the difference of two predictions.
    """

    def __init__(self, delay: float) -> None:
        """Start with the assumed lag, after a configured delay [s]."""
        self.delay = delay
        self.lag, self.variance = ASSUMED_LAG, START_DEVIATION**2
        self.anchor: VehicleState | None = None

    @property
    def caution(self) -> float:
        """Share of the filter's gains that is used also without noise, 0 to 1.

        An uncertain lag, or a long one, which is rather a delay, needs the margin of the filter.
        """
        uncertain = self.variance / START_DEVIATION**2
        long = (self.lag - SHORT_LAG) / (LONG_LAG - SHORT_LAG)
        return min(max(uncertain, long), 1.0)

    @property
    def steering(self) -> tuple[float, float]:
        """Delay and lag of the steering [s]."""
        return split(self.lag, self.delay)

    def observe(self, state: VehicleState, predictor: StatePredictor) -> None:
        """Correct the estimate by another measured state.

        Args:
            state: Measured state at `base_link`.
            predictor: Model with the commands sent; its steering is changed.
        """
        if self.anchor is None:
            self.anchor = state
            return
        elapsed = (state.stamp_ns - self.anchor.stamp_ns) / NANOSECONDS
        if 0.0 <= elapsed < SHORTEST:
            return
        anchor, self.anchor = self.anchor, state
        fast = state.v_x * abs(state.yaw_rate) > MOST_ACCELERATION
        if not 0.0 < elapsed <= LONGEST or state.v_x < SLOWEST or fast:
            return
        self._update(anchor, state, predictor, elapsed)

    def _update(
        self, anchor: VehicleState, state: VehicleState, predictor: StatePredictor, elapsed: float
    ) -> None:
        """Correct the estimate by the residual of the prediction from an earlier state."""
        expected = self._yaw_rate(anchor, state.stamp_ns, predictor, self.lag)
        shifted = self._yaw_rate(anchor, state.stamp_ns, predictor, self.lag + DIFFERENCE)
        gradient, residual = (shifted - expected) / DIFFERENCE, state.yaw_rate - expected
        if abs(residual) > MOST_RESIDUAL:
            return
        noise = DEVIATION**2 + (DEVIATION_SHARE * state.yaw_rate) ** 2
        self.variance = min(self.variance + WALK**2 * elapsed, START_DEVIATION**2)
        gain = self.variance * gradient / (gradient**2 * self.variance + noise)
        self.lag = min(max(self.lag + gain * residual, 0.0), LARGEST_LAG)
        self.variance *= 1.0 - gain * gradient

    def _yaw_rate(
        self, anchor: VehicleState, end_ns: int, predictor: StatePredictor, lag: float
    ) -> float:
        """Return the yaw rate that is predicted with a lag [rad/s]."""
        predictor.use_steering(*split(lag, self.delay))
        return predictor.predict(anchor, end_ns).yaw_rate


def split(lag: float, delay: float) -> tuple[float, float]:
    """Return delay and lag of a steering [s]; the part beyond SHORT_LAG is taken for a delay."""
    short = min(lag, SHORT_LAG)
    return delay + lag - short, short
