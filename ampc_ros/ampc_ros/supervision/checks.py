"""Checks of measured states and paths. All times are arguments."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.supervision.plausibility import (
    CAUSES,
    CHECK_WINDOW,
    FUTURE,
    Rejection,
    StateHistory,
    stamp_difference,
    time_between,
    unusable,
)

CONFIRMED = 3
"""Consecutive states that confirm a clock that jumped back."""
PACE = 0.5
"""Smallest ratio of their arrival times to their stamps: a queue of old states arrives at once."""
LATE = ("duplicate", "out_of_order")
"""Causes of states without new information."""
MAX_GAP = 25.0
"""Largest gap between points of a path with more than two points [m]."""


class StateCheck(NamedTuple):
    """Result of the check of a state."""

    accepted: bool
    """True: the state is now the newest valid one."""
    reset: bool = False
    """True: earlier states are no longer valid, and this one starts a new history."""
    cause: str = ""
    """Cause of the rejection or of the new track, one of CAUSES."""
    reason: str = ""
    """A sentence with name, value and bound."""


class StateFilter:
    """Accepts or rejects each state when it arrives.

    A rejected state changes only a count. Rejected states that are consistent with each other form
    a track of their own. When that track has lasted for WINDOW the car really is there (its
    localisation was restarted), and the track replaces the old one. A frozen pose never does: it
    contradicts its own twist within the same window.

    Note:
        A stamp that goes back is an overtaken message, or a clock that jumped. It is the clock
        where the node's own clock went back, too; or, beyond REORDERED, where three consecutive
        states continue from there at the pace of their stamps: those of a queue that empties
        arrive all at once. In lock-step the stamp is the node's clock, so both go back together.
    """

    def __init__(self) -> None:
        """Create a filter that accepts any first state."""
        self.rejected = dict.fromkeys(CAUSES, 0)
        self.track: StateHistory | None = None
        self.candidate: StateHistory | None = None
        self.now_ns = self.candidate_ns = 0

    def reset(self) -> None:
        """Forget all states; the counts continue."""
        self.track = self.candidate = None

    def accept(self, state: VehicleState, now_ns: int) -> StateCheck:
        """Check a state.

        Args:
            state: State as it arrived.
            now_ns: Time of the node's clock; 0: the clock has not started yet [ns].
        """
        rejection = unusable(state, now_ns)
        if rejection:
            return self._reject(rejection)
        if self.track is None:
            self.track, self.now_ns = StateHistory(state), now_ns
            return StateCheck(True)
        rejection = self.track.objection(state, silent=self._silent_before(state))
        if rejection is None:
            self.track.append(state)
            self.candidate, self.now_ns = None, now_ns
            return StateCheck(True)
        if self._starts_new_track(rejection, state, now_ns):
            self.track, self.candidate, self.now_ns = self.candidate, None, now_ns
            return StateCheck(True, True, *rejection)
        return self._reject(rejection)

    def _reject(self, rejection: Rejection) -> StateCheck:
        self.rejected[rejection.cause] += 1
        return StateCheck(False, False, *rejection)

    def _starts_new_track(self, rejection: Rejection, state: VehicleState, now_ns: int) -> bool:
        """Add a rejected state to the candidate; return whether the candidate is confirmed."""
        if rejection.cause == "duplicate":
            return False
        back = rejection.cause in ("out_of_order", "clock_jumped_back")
        clock_went_back = 0 < now_ns < self.now_ns - FUTURE * NANOSECONDS
        if back and clock_went_back:
            self.candidate = StateHistory(state)
            return True
        if rejection.cause == "out_of_order":
            return False
        candidate = self._extend_candidate(state, now_ns)
        lasted = stamp_difference(candidate.first_ns, candidate.last.stamp_ns)
        if back and stamp_difference(self.candidate_ns, now_ns) < PACE * lasted:
            return False
        return lasted >= CHECK_WINDOW or (back and candidate.count >= CONFIRMED)

    def _silent_before(self, state: VehicleState) -> bool:
        """Return whether no state, accepted or rejected, came for longer than WINDOW."""
        tracks = (self.track, self.candidate)
        return all(time_between(track.last, state) > CHECK_WINDOW for track in tracks if track)

    def _extend_candidate(self, state: VehicleState, now_ns: int) -> StateHistory:
        """Add a state to the candidate if consistent; if it contradicts, start another one."""
        silent = self._silent_before(state)
        objection = self.candidate.objection(state, silent=silent) if self.candidate else None
        if self.candidate is None or (objection and objection.cause not in LATE):
            self.candidate, self.candidate_ns = StateHistory(state), now_ns
        elif objection is None:
            self.candidate.append(state)
        return self.candidate


def check_path(
    points: ArrayLike,
    chassis: ChassisParameters,
    max_angle: float,
    max_gap: float = MAX_GAP,
    path_noise: float | None = None,
) -> Path:
    """Return the path through points if this car can drive it.

    Args:
        points: (n, 2) positions in driving order [m].
        chassis: Parameters of the car.
        max_angle: Largest steering angle [rad].
        max_gap: Largest gap between points, if there are more than two [m].
        path_noise: Standard deviation of the points [m]; None: estimated from them.

    Raises:
        ValueError: An error of `make_path`, a gap, or a bend; with position, value and bound.

    Note:
        The curvature is averaged over a wheelbase: what remains of the noise of the points in the
        curvature affects the car only as that mean.
    """
    check_gaps(np.asarray(points, dtype=float), max_gap)
    path = make_path(points, path_noise)
    most = math.tan(max_angle) / chassis.wheelbase
    bend = mean_curvature(path, chassis.wheelbase)
    sharpest = int(np.argmax(np.abs(bend)))
    if abs(bend[sharpest]) > most:
        raise ValueError(
            f"path: curvature after {sharpest * path.spacing:.4g} m = {bend[sharpest]:.3g} 1/m "
            f"must lie in [{-most:.3g}, {most:.3g}] 1/m, the range of the steering"
        )
    return path


def check_gaps(points: Array, max_gap: float) -> None:
    """Raise a ValueError at the widest gap; other errors are left to `make_path`."""
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        return
    gaps = np.nan_to_num(np.hypot(*np.diff(points, axis=0).T), nan=0.0, posinf=0.0)
    widest = int(np.argmax(gaps))
    if gaps[widest] > max_gap:
        raise ValueError(
            f"path: gap between points {widest} and {widest + 1} = {gaps[widest]:g} m "
            f"must be at most {max_gap:g} m"
        )


def mean_curvature(path: Path, length: float) -> Array:
    """Return the mean curvature over a length [m] from each sample (n,), also across a lap."""
    heading = path.heading
    n = min(max(round(length / path.spacing), 1), len(heading) - 1)
    if path.closed:
        heading = np.concatenate((heading, heading[1:n] + heading[-1] - heading[0]))
    return np.asarray((heading[n:] - heading[:-n]) / (n * path.spacing))
