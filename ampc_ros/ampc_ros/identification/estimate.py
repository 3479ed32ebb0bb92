"""Prediction-error method: least squares between measured and simulated steering, yaw and slip.

L. Ljung, "System Identification", 2nd edition, chapters 7 (method) and 9 (covariance where the
model is not exact).
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize
from scipy.ndimage import gaussian_filter1d

from ampc_msgs_config.parameters import GRAVITY, ChassisParameters
from ampc_msgs_config.types import Array
from ampc_ros.identification.model import (
    ModelActuator,
    ModelCar,
    actuator_angles,
    car_motion,
)
from ampc_ros.identification.recording import (
    GRID_STEP,
    Mask,
    RecordedDrive,
    RowIndices,
    Segment,
)

PARAMETERS = (
    "delay",
    "lag",
    "log_max_rate",
    "log_ratio",
    "offset",
    "log_C_f",
    "log_C_r",
    "log_I_z",
    "x_P",
    "log_relaxation",
    "log_curvature",
    "latency",
    "misalignment",
    "scrub",
)
"""Parameters; logarithms are relative to the start values."""
(
    DELAY,
    LAG,
    LOG_RATE,
    RATIO,
    OFFSET,
    C_F,
    C_R,
    I_Z,
    X_P,
    RELAXATION,
    TYRE_CURVE,
    LATENCY,
    TWIST,
    SCRUB,
) = range(len(PARAMETERS))
PRIOR = np.array([1.0, 1.0, 3.0, 1.0, 0.3, 1.0, 1.0, 0.3, 3.0, 0.7, 0.4, 0.05, 0.05, 0.5])
"""Standard deviations of weak priors about the start values: they hold what a drive leaves open.
Only the last five, which no vehicle file contains, have ones that matter."""
STEPS = np.array(
    [2e-3, 2e-3, 1e-2, 1e-3, 1e-4, 3e-3, 3e-3, 3e-3, 1e-3, 3e-2, 3e-2, 2e-3, 1e-3, 3e-2]
)
"""Steps of the finite differences."""
LOWER_BOUND = np.array(
    [0.0, 0.0, -6.0, -1.5, -0.3, -3.0, -3.0, -3.0, -10.0, -4.0, -2.0, -0.005, -0.3, -0.75]
)
UPPER_BOUND = np.array([0.8, 0.8, 6.0, 1.5, 0.3, 3.0, 3.0, 3.0, 15.0, 3.0, 2.0, 0.4, 0.3, 0.75])
OUTLIER = 6.0
"""Residual in robust standard deviations beyond which a row is left out."""
MOST_OUTLIERS = 0.02
"""Largest share of outliers."""
FLOOR = 0.01
"""Least standard deviation of an output as a share of its RMS: errors of the model remain."""
GAIN_ERROR, GEOMETRY_ERROR = 0.001, 0.01
"""Standard deviation of the model's error of the yaw rate, as a share of it, in each window: load
transfer and road, and steering geometry, which grows with the square of the angle [rad]. Without
it, errors of half a percent would decide on stiffness and inertia against the lateral velocity,
whose noise is larger."""
GAIN_WINDOW = 3.0
"""Duration of such a window [s]."""
BIN = 0.1
"""Width of the bins of the scores [s]."""
BANDWIDTH = 15
"""Bins over which residuals are taken for correlated (Bartlett window)."""
CURVATURE_OF_TYRES = 0.55
"""q mu^2 of `tyre_force` for the Magic Formula with usual shape factors."""
RELAXATION_SHARE = 0.12
"""Relaxation length of a usual tyre, as a share of the wheelbase."""
MEAN_SCRUB = 0.5
"""Centre of the prior of 1 - A, for the Ackermann share A of the steering."""
RATE_SHARES = (1.0, 0.75, 0.55, 0.4)
"""Rate limits that are tried, as shares of the largest mean rate over RATE_STEPS without one."""
RATE_STEPS = 10
"""Steps of the grid over which the largest rate of a drive is taken."""
RATE_EVIDENCE = 30.0
"""Decrease of the sum of squares from which a rate limit is accepted."""


class Start(NamedTuple):
    """Vehicle that the identification starts from; mass and axle distances are not changed."""

    chassis: ChassisParameters
    ratio: float = 1.0
    """Units of the topic per road-wheel angle."""
    friction: float = 0.9
    relaxation: float | None = None
    """Relaxation length [m]; None: from the wheelbase."""
    front_drive: float = 1.0
    """Front share of the drive force."""
    front_brake: float = 0.65
    """Front share of the brake force."""
    rolling: float = 0.012
    """Rolling resistance divided by the weight."""
    track: float = 1.5
    """Track width [m]."""
    height: float = 0.55
    """Height of the centre of gravity [m]."""
    front_roll_share: float = 0.55
    """Front share of the roll stiffness."""
    stiffest_load: float = 2.0
    """Load of the largest stiffness of a tyre in static loads, p."""


def compile_model() -> None:
    """Compile the simulation of steering and car."""
    chassis = ChassisParameters(
        mass=1.0,
        yaw_inertia=1.0,
        cg_to_front_axle=1.0,
        cg_to_rear_axle=1.0,
        front_cornering_stiffness=1.0,
        rear_cornering_stiffness=1.0,
    )
    theta, start, flat = np.zeros(len(PARAMETERS)), Start(chassis), np.ones(2)
    grid = np.array([0.0, GRID_STEP])
    angles = actuator_angles(grid, flat, grid, actuator_parameters(theta, start))
    car_motion(angles, flat, flat, flat, GRID_STEP, car_parameters(theta, start))


class ComparedOutputs(NamedTuple):
    """Values that are compared."""

    steering: Array
    """In units of the topic."""
    yaw_rate: Array
    """[rad/s]"""
    lateral_velocity: Array
    """Of the measured point [m/s]."""


class LeastSquaresFit(NamedTuple):
    """Result of the least squares."""

    theta: Array
    """(14,) parameters in the order of PARAMETERS."""
    covariance: Array
    """(14, 14), robust against correlated residuals; zero for parameters that are not estimated."""
    classical: Array
    """(14, 14) for white residuals."""
    cost: float
    """Half the sum of squares of the weighted residuals."""
    sigma: ComparedOutputs
    """Standard deviation of each output, one number each."""
    free: Mask
    """(14,) whether a parameter was estimated."""
    largest_rate: float
    """Largest mean rate of the simulated road-wheel angle over 0.1 s [rad/s]."""


def actuator_parameters(theta: Array, start: Start) -> ModelActuator:
    """Return the actuator of a parameter vector."""
    delay, lag = float(theta[DELAY]), float(theta[LAG])
    gain = math.exp(-theta[RATIO]) / start.ratio
    return ModelActuator(delay, lag, math.exp(float(theta[LOG_RATE])), gain, float(theta[OFFSET]))


def car_parameters(theta: Array, start: Start) -> ModelCar:
    """Return the car of a parameter vector."""
    c = start.chassis
    sigma = start.relaxation or RELAXATION_SHARE * c.wheelbase
    share = c.cg_to_rear_axle / c.wheelbase  # of the front axle in the weight
    roll = start.height / (GRAVITY * start.track / 2)  # times the axle's share of roll and weight
    return ModelCar(
        c.mass,
        c.cg_to_front_axle,
        c.cg_to_rear_axle,
        c.yaw_inertia * math.exp(theta[I_Z]),
        2 * c.front_cornering_stiffness * math.exp(theta[C_F]),
        2 * c.rear_cornering_stiffness * math.exp(theta[C_R]),
        sigma * math.exp(theta[RELAXATION]),
        CURVATURE_OF_TYRES / start.friction**2 * math.exp(theta[TYRE_CURVE]),
        start.front_drive,
        start.front_brake,
        start.rolling,
        start.friction,
        MEAN_SCRUB + theta[SCRUB],
        start.track / 2,
        start.height,
        roll * start.front_roll_share / share,
        roll * (1 - start.front_roll_share) / (1 - share),
        start.stiffest_load,
    )


def predicted_outputs(
    theta: Array, recording: RecordedDrive, segment: Segment, start: Start
) -> ComparedOutputs:
    """Simulate a segment, and return the outputs at its rows."""
    actuator = actuator_parameters(theta, start)
    grid = segment.grid
    angles = actuator_angles(recording.command_time, recording.command, grid, actuator)
    motion = car_motion(
        angles,
        segment.speed,
        segment.acceleration,
        segment.restart,
        GRID_STEP,
        car_parameters(theta, start),
    )
    seen = recording.time[segment.rows] - theta[LATENCY]
    yaw_rate = np.interp(seen, grid, motion[:, 1])
    v_y = np.interp(seen, grid, motion[:, 0])
    from_cg = theta[X_P] - start.chassis.cg_to_rear_axle
    slip = v_y + from_cg * yaw_rate + theta[TWIST] * np.interp(seen, grid, segment.speed)
    steering = np.interp(recording.steering_time[segment.steering_rows], grid, angles)
    return ComparedOutputs((steering - actuator.offset) / actuator.gain, yaw_rate, slip)


def measured_outputs(recording: RecordedDrive, segment: Segment) -> ComparedOutputs:
    """Return the measured outputs at the rows of a segment."""
    return ComparedOutputs(
        recording.steering[segment.steering_rows],
        recording.yaw_rate[segment.rows],
        recording.v_y[segment.rows],
    )


def output_times(recording: RecordedDrive, segment: Segment) -> ComparedOutputs:
    """Return the times of the outputs of a segment [s]."""
    time = recording.time[segment.rows]
    return ComparedOutputs(recording.steering_time[segment.steering_rows], time, time)


def joined(parts: Sequence[ComparedOutputs]) -> ComparedOutputs:
    """Return the outputs of all segments, one after the other."""
    return ComparedOutputs(*(np.concatenate(each) for each in zip(*parts, strict=True)))


class Problem(NamedTuple):
    """Weighted least squares over the free parameters."""

    recording: RecordedDrive
    segments: Sequence[Segment]
    start: Start
    weights: ComparedOutputs
    """Inverse standard deviation of each value, 0 for an outlier."""
    free: RowIndices
    """RowIndices of the estimated parameters."""
    fixed: Array
    """(14,) values of the others."""
    centre: Array
    """(14,) centre of the priors."""
    window: RowIndices
    """Number of the window of GAIN_WINDOW of each yaw rate."""
    gain_error: Array
    """Standard deviation of the model's error of each yaw rate [rad/s]."""

    def full(self, p: Array) -> Array:
        """Return all parameters."""
        theta = self.fixed.copy()
        theta[self.free] = p
        return theta

    def residuals(self, p: Array) -> Array:
        """Return weighted residuals (N,)."""
        parts = [
            predicted_outputs(self.full(p), self.recording, s, self.start) for s in self.segments
        ]
        values = joined([measured_outputs(self.recording, s) for s in self.segments])
        differences = zip(values, joined(parts), self.weights, strict=True)
        steering, yaw, slip = (w * (y - y_hat) for y, y_hat, w in differences)
        return np.concatenate((steering, self.without_gain_error(yaw), slip))

    def without_gain_error(self, residual: Array) -> Array:
        """Return whitened residuals of the yaw rate: e = noise + gain error x yaw rate (n,).

        In each window the component along the yaw rate is divided by its standard deviation.
        """
        window, b = self.window, self.weights.yaw_rate * self.gain_error
        square = np.bincount(window, b * b) + 1e-12
        share = np.bincount(window, b * residual) / square * (1 - 1 / np.sqrt(1 + square))
        return np.asarray(residual - share[window] * b)

    def with_prior(self, p: Array) -> Array:
        """Return residuals and deviations from the priors (N + free,)."""
        pull = (p - self.centre[self.free]) / PRIOR[self.free]
        return np.concatenate((self.residuals(p), pull))

    def jacobian(self, p: Array, function: Callable[[Array], Array]) -> Array:
        """Return the Jacobian of residuals by one-sided differences."""
        at, columns = function(p), []
        for k, i in enumerate(self.free):
            moved, step = p.copy(), STEPS[i]
            if p[k] + step > UPPER_BOUND[i]:
                step = -step
            moved[k] += step
            columns.append((function(moved) - at) / step)
        return np.asarray(np.column_stack(columns))

    def solve(self, theta: Array, evaluations: int = 30) -> tuple[Array, float]:
        """Minimise from a starting point; return all parameters and the cost."""
        low, high = LOWER_BOUND[self.free], UPPER_BOUND[self.free]
        start = np.clip(theta[self.free], low + 1e-4, high - 1e-4)
        least_squares: Any = optimize.least_squares  # mypy takes it for a module
        result = least_squares(
            self.with_prior,
            start,
            jac=lambda p: self.jacobian(p, self.with_prior),
            bounds=(low, high),
            x_scale="jac",
            max_nfev=evaluations,
            ftol=1e-8,
            xtol=1e-8,
        )
        return self.full(result.x), float(result.cost)


def estimate(
    recording: RecordedDrive,
    segments: Sequence[Segment],
    start: Start,
    log: Callable[[str], object] = lambda _: None,
) -> LeastSquaresFit:
    """Estimate all parameters from the segments of a drive.

    Args:
        recording: The drive.
        segments: Its usable parts, at least one.
        start: Vehicle to start from.
        log: Receives a line on each stage.
    """
    theta: Array = np.zeros(len(PARAMETERS))
    theta[LOG_RATE] = UPPER_BOUND[LOG_RATE]  # no limit
    theta[[DELAY, LAG]] = 0.1
    values = joined([measured_outputs(recording, s) for s in segments])
    free = [DELAY, LAG, RATIO, OFFSET, C_F, C_R, I_Z, X_P, RELAXATION, TYRE_CURVE, TWIST, SCRUB]
    if len(values.steering):
        free.append(LATENCY)
    # Weights from the noise at first, then from the residuals
    sigma = first_deviations(values, recording)
    problem = weighted(recording, segments, start, values, sigma, np.array(sorted(free)), theta)
    starts = []
    for delay in (0.03, 0.15, 0.3):
        theta[DELAY] = delay
        starts.append(problem.solve(theta, 4))
    theta = min(starts, key=lambda each: each[1])[0]
    theta, cost = problem.solve(theta)
    log(f"first estimate: delay {theta[DELAY]:.3f} s, lag {theta[LAG]:.3f} s")
    for _ in range(2):
        problem, sigma = reweighted(problem, theta, values, most_outliers=0.0)
        theta, cost = problem.solve(theta, 60)
    # Rate limit, then outliers
    problem, theta, cost = with_rate_limit(problem, theta, cost)
    if LOG_RATE in problem.free:
        log(f"rate limit of the steering reached: {math.exp(theta[LOG_RATE]):.3g} rad/s")
    for _ in range(2):
        problem, sigma = reweighted(problem, theta, values, MOST_OUTLIERS)
        theta, cost = problem.solve(theta, 60)
    covariance, classical = covariances(problem, theta)
    chosen = np.isin(np.arange(len(PARAMETERS)), problem.free)
    largest = largest_rate(theta, problem, RATE_STEPS)
    return LeastSquaresFit(theta, covariance, classical, cost, sigma, chosen, largest)


def first_deviations(values: ComparedOutputs, recording: RecordedDrive) -> ComparedOutputs:
    """Return the noise of each output from its second differences, with a floor."""
    series = (recording.steering, recording.yaw_rate, recording.v_y)
    noise = (high_frequency_noise(each) for each in series)
    floors = (5 * FLOOR * root_mean_square(each) for each in values)
    return ComparedOutputs(
        *(np.array(math.hypot(*pair)) for pair in zip(noise, floors, strict=True))
    )


def high_frequency_noise(values: Array) -> float:
    """Return the standard deviation of white noise on a smooth signal, from third differences."""
    if len(values) < 5:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(values, 3))) / math.sqrt(20.0))


def root_mean_square(values: Array) -> float:
    """Return the root of the mean square, at least 1e-9."""
    return max(math.sqrt(float(np.mean(values**2))), 1e-9) if len(values) else 1.0


def weighted(
    recording: RecordedDrive,
    segments: Sequence[Segment],
    start: Start,
    values: ComparedOutputs,
    sigma: ComparedOutputs,
    free: RowIndices,
    theta: Array,
) -> Problem:
    """Return the problem with equal weights for all rows of an output."""
    weights = ComparedOutputs(
        *(np.full(len(y), 1.0 / s) for y, s in zip(values, sigma, strict=True))
    )
    centre = np.zeros(len(PARAMETERS))
    rows = joined([output_times(recording, s) for s in segments]).yaw_rate
    window = np.unique(np.floor(rows / GAIN_WINDOW), return_inverse=True)[1]
    every = np.concatenate([s.rows for s in segments])
    yaw = gaussian_filter1d(recording.yaw_rate[every], 3.0)
    speed = np.maximum(gaussian_filter1d(recording.v_x[every], 3.0), 0.5)
    error = GAIN_ERROR + GEOMETRY_ERROR * (start.chassis.wheelbase * yaw / speed) ** 2
    return Problem(
        recording, segments, start, weights, free, theta.copy(), centre, window, error * yaw
    )


def reweighted(
    problem: Problem, theta: Array, values: ComparedOutputs, most_outliers: float
) -> tuple[Problem, ComparedOutputs]:
    """Return the problem with weights from the residuals, and the deviations of the outputs.

    Rows far from the model are left out, but no more than a share of them: more would be an error
    of the model.
    """
    predicted = joined(
        [predicted_outputs(theta, problem.recording, s, problem.start) for s in problem.segments]
    )
    weights, sigma = [], []
    for y, y_hat in zip(values, predicted, strict=True):
        residual = y - y_hat
        spread = 1.4826 * float(np.median(np.abs(residual))) if len(y) else 1.0
        is_outlier = np.abs(residual) > OUTLIER * max(spread, FLOOR * root_mean_square(y))
        if is_outlier.sum() > most_outliers * len(y):
            is_outlier[:] = False
        deviation = math.hypot(root_mean_square(residual[~is_outlier]), FLOOR * root_mean_square(y))
        weights.append(np.where(is_outlier, 0.0, 1.0 / deviation))
        sigma.append(np.array(deviation))
    return problem._replace(weights=ComparedOutputs(*weights), fixed=theta.copy()), ComparedOutputs(
        *sigma
    )


def with_rate_limit(problem: Problem, theta: Array, cost: float) -> tuple[Problem, Array, float]:
    """Return problem, parameters and cost with a rate limit, where the drive shows one."""
    largest, actuator = largest_rate(theta, problem, RATE_STEPS), np.array([DELAY, LAG])
    free = np.array(sorted({*problem.free.tolist(), LOG_RATE}))
    trials = []
    for share in RATE_SHARES:
        limited = theta.copy()
        limited[LOG_RATE] = math.log(share * largest)
        limited = problem._replace(free=actuator, fixed=limited).solve(limited, 6)[0]
        centre = problem.centre.copy()
        centre[LOG_RATE] = limited[LOG_RATE]
        trial = problem._replace(free=free, centre=centre, fixed=limited)
        trials.append((trial, *trial.solve(limited, 12)))
    trial, found, new_cost = min(trials, key=lambda each: each[2])
    found, new_cost = trial.solve(found, 40)
    is_reached = math.exp(found[LOG_RATE]) < 0.95 * largest_rate(
        np.where(np.arange(len(found)) == LOG_RATE, UPPER_BOUND[LOG_RATE], found), problem
    )
    if is_reached and 2 * (cost - new_cost) > RATE_EVIDENCE:
        return trial, found, new_cost
    return problem, theta, cost


def largest_rate(theta: Array, problem: Problem, steps: int = 1) -> float:
    """Return the largest mean rate of the road-wheel angle over steps of the grid [rad/s]."""
    actuator, data = actuator_parameters(theta, problem.start), problem.recording
    changes = []
    for segment in problem.segments:
        angles = actuator_angles(data.command_time, data.command, segment.grid, actuator)
        changes.append(float(np.abs(angles[steps:] - angles[:-steps]).max()))
    return max(max(changes) / (steps * GRID_STEP), 1e-3)


def covariances(problem: Problem, theta: Array) -> tuple[Array, Array]:
    """Return the covariance with correlated residuals, and that with white ones (14, 14).

    Sandwich estimator with a Bartlett window: W. K. Newey, K. D. West, Econometrica 55 (1987).
    """
    p = theta[problem.free]
    J, e = -problem.jacobian(p, problem.residuals), problem.residuals(p)
    P = np.diag(1.0 / PRIOR[problem.free] ** 2)
    times = joined([output_times(problem.recording, s) for s in problem.segments])
    place = np.floor(np.concatenate(times) / BIN).astype(np.int64)
    rows = np.unique(place, return_inverse=True)[1]
    full = np.zeros((int(rows.max()) + 1, len(p)))
    np.add.at(full, rows, J * e[:, None])
    meat = full.T @ full
    for lag in range(1, min(BANDWIDTH, len(full) - 1) + 1):
        product = full[lag:].T @ full[:-lag]
        meat += (1 - lag / (BANDWIDTH + 1)) * (product + product.T)
    inverse = np.linalg.inv(J.T @ J + P)
    result = []
    for middle in (meat + P, J.T @ J + P):
        covariance = np.zeros((len(theta), len(theta)))
        covariance[np.ix_(problem.free, problem.free)] = inverse @ middle @ inverse
        result.append(covariance)
    return result[0], result[1]
