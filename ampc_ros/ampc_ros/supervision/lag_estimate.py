"""Estimation of an unknown lag of the steering from the yaw rate, while the car is driven."""

import numpy as np

from ampc_msgs_config.parameters import ASSUMED_LAG
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
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
ERROR_DEVIATION, ERROR_WALK = 0.5, 0.05
"""Standard deviation of the constant error at the start [rad/s^2], and its random walk
[rad/s^2 / s^0.5]."""
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
    """Recursive least squares: which lag, and which constant error, predict the yaw rate.

    Ljung, "System Identification", 2nd edition, Section 11.4: prediction-error method, where the
    gradient is the difference of two predictions. The constant error is that of a misaligned wheel
    or of side wind, which would otherwise be read as a lag.
    """

    def __init__(self, delay: float) -> None:
        """Start with the assumed lag, after a configured delay [s]."""
        self.delay = delay
        self.lag, self.error = ASSUMED_LAG, 0.0
        """Lag [s], and the constant error of the predicted yaw acceleration [rad/s^2]."""
        self.covariance: Array = np.diag(np.square((START_DEVIATION, ERROR_DEVIATION)))
        self.anchor: VehicleState | None = None

    @property
    def caution(self) -> float:
        """Share of the filter's gains that is used also without noise, 0 to 1.

        An uncertain lag, or a long one, which is rather a delay, needs the margin of the filter.
        """
        uncertain = float(self.covariance[0, 0]) / START_DEVIATION**2
        long = (self.lag - SHORT_LAG) / (LONG_LAG - SHORT_LAG)
        return min(max(uncertain, long), 1.0)

    @property
    def is_known(self) -> bool:
        """Whether the car was driven enough for an estimate."""
        return bool(self.covariance[0, 0] < 0.5 * START_DEVIATION**2)

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
        if state.yaw_rate == anchor.yaw_rate:  # a sensor that is stuck, or a straight road
            return
        if not 0.0 < elapsed <= LONGEST or state.v_x < SLOWEST or fast:
            return
        self._update(anchor, state, predictor, elapsed)

    def _update(
        self, anchor: VehicleState, state: VehicleState, predictor: StatePredictor, elapsed: float
    ) -> None:
        """Correct the estimate by the residual of the prediction from an earlier state."""
        expected = self._yaw_rate(anchor, state.stamp_ns, predictor, self.lag)
        shifted = self._yaw_rate(anchor, state.stamp_ns, predictor, self.lag + DIFFERENCE)
        phi = np.array([(shifted - expected) / DIFFERENCE, elapsed])
        residual = state.yaw_rate - expected - self.error * elapsed
        if abs(residual) > MOST_RESIDUAL:
            return
        noise = DEVIATION**2 + (DEVIATION_SHARE * state.yaw_rate) ** 2
        P = self.covariance + np.diag(np.square((WALK, ERROR_WALK)) * elapsed)
        P[0, 0] = min(P[0, 0], START_DEVIATION**2)
        gain = P @ phi / (phi @ P @ phi + noise)
        self.covariance = P - np.outer(gain, phi @ P)
        self.lag = float(min(max(self.lag + gain[0] * residual, 0.0), LARGEST_LAG))
        self.error += float(gain[1] * residual)

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
