"""Which measured states and which paths are used. No clock is read here: all times come in."""

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
    FUTURE,
    WINDOW,
    Refusal,
    Track,
    seconds,
    seconds_between,
    unusable,
)

CONFIRMED = 3
"""States in a row that confirm a clock that jumped back."""
PACE = 0.5
"""Least time in which they come, per time that they tell: a queue of old ones comes at once."""
LATE = ("duplicate", "out_of_order")
"""States that say nothing new."""
MAX_GAP = 25.0
"""Between points of a path that has more than two [m]."""


class Verdict(NamedTuple):
    """What to do with a state that has arrived."""

    accepted: bool
    """Whether it is the newest valid one now."""
    reset: bool = False
    """Whether it begins anew: what was remembered of earlier states no longer holds."""
    cause: str = ""
    """One of CAUSES where it is refused, or why it begins anew."""
    reason: str = ""
    """A sentence with name, value and bound."""


class StateFilter:
    """Decides about each state when it arrives.

    A refused state changes nothing but a count. States that are refused but follow from each other
    are remembered as a track of their own; when that has lasted for WINDOW the car really is there
    (its localisation began anew), and the track takes the place of the old one. A frozen pose never
    gets there: it contradicts its own twist within the same window.

    Note:
        A stamp that goes back is an overtaken message, or a clock that jumped. It is the clock
        where the node's own went back, too; or, beyond REORDERED, where three states in a row
        go on from there, as fast as they tell: those of a queue that empties itself come all at
        once. In lock-step the stamp is the node's clock, so that both go back together.
    """

    def __init__(self) -> None:
        """Make a filter that takes any first state."""
        self.rejected = dict.fromkeys(CAUSES, 0)
        self.track: Track | None = None
        self.candidate: Track | None = None
        self.now_ns = self.candidate_ns = 0

    def reset(self) -> None:
        """Forget all states; the counts go on."""
        self.track = self.candidate = None

    def accept(self, state: VehicleState, now_ns: int) -> Verdict:
        """Judge a state.

        Args:
            state: As it arrived.
            now_ns: Time of the node's clock; 0: it has none yet [ns].
        """
        refusal = unusable(state, now_ns)
        if refusal:
            return self._refuse(refusal)
        if self.track is None:
            self.track, self.now_ns = Track(state), now_ns
            return Verdict(True)
        refusal = self.track.objection(state, silent=self._silent_before(state))
        if refusal is None:
            self.track.append(state)
            self.candidate, self.now_ns = None, now_ns
            return Verdict(True)
        if self._begins_anew(refusal, state, now_ns):
            self.track, self.candidate, self.now_ns = self.candidate, None, now_ns
            return Verdict(True, True, *refusal)
        return self._refuse(refusal)

    def _refuse(self, refusal: Refusal) -> Verdict:
        self.rejected[refusal.cause] += 1
        return Verdict(False, False, *refusal)

    def _begins_anew(self, refusal: Refusal, state: VehicleState, now_ns: int) -> bool:
        """Add a refused state to the candidate; tell whether that has proved itself."""
        if refusal.cause == "duplicate":
            return False
        back = refusal.cause in ("out_of_order", "clock_jumped_back")
        clock_went_back = 0 < now_ns < self.now_ns - FUTURE * NANOSECONDS
        if back and clock_went_back:
            self.candidate = Track(state)
            return True
        if refusal.cause == "out_of_order":
            return False
        candidate = self._continued(state, now_ns)
        lasted = seconds_between(candidate.first_ns, candidate.last.stamp_ns)
        if back and seconds_between(self.candidate_ns, now_ns) < PACE * lasted:
            return False
        return lasted >= WINDOW or (back and candidate.count >= CONFIRMED)

    def _silent_before(self, state: VehicleState) -> bool:
        """Tell whether nothing has come for longer than WINDOW, neither accepted nor refused."""
        tracks = (self.track, self.candidate)
        return all(seconds(track.last, state) > WINDOW for track in tracks if track)

    def _continued(self, state: VehicleState, now_ns: int) -> Track:
        """Add a state to the candidate where it follows; where it contradicts, begin another."""
        silent = self._silent_before(state)
        objection = self.candidate.objection(state, silent=silent) if self.candidate else None
        if self.candidate is None or (objection and objection.cause not in LATE):
            self.candidate, self.candidate_ns = Track(state), now_ns
        elif objection is None:
            self.candidate.append(state)
        return self.candidate


def check_path(
    points: ArrayLike, chassis: ChassisParameters, max_angle: float, max_gap: float = MAX_GAP
) -> Path:
    """Give the path through points, if this car can drive it.

    Args:
        points: (n, 2) positions in driving order [m].
        chassis: The car.
        max_angle: To which it can steer [rad].
        max_gap: Longest distance between points, where there are more than two [m].

    Raises:
        ValueError: What `make_path` refuses, a gap, or a bend; with place, value and bound.

    Note:
        Curvature counts as its mean over a wheelbase: points that jitter by 5 cm, as a planner may
        give them, make curvatures of 0.5 1/m of which the car feels a quarter.
    """
    check_gaps(np.asarray(points, dtype=float), max_gap)
    path = make_path(points)
    most = math.tan(max_angle) / chassis.wheelbase
    bend = mean_curvature(path, chassis.wheelbase)
    sharpest = int(np.argmax(np.abs(bend)))
    if abs(bend[sharpest]) > most:
        raise ValueError(
            f"path: curvature after {sharpest * path.spacing:.4g} m = {bend[sharpest]:.3g} 1/m "
            f"must lie in [{-most:.3g}, {most:.3g}] 1/m, what the car can steer"
        )
    return path


def check_gaps(points: Array, max_gap: float) -> None:
    """Raise a ValueError at the widest gap; what is no list of points is left to `make_path`."""
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
    """Give the mean curvature over a length [m] from each sample on, round a closed path too."""
    heading = path.heading
    n = min(max(round(length / path.spacing), 1), len(heading) - 1)
    if path.closed:
        heading = np.concatenate((heading, heading[1:n] + heading[-1] - heading[0]))
    return np.asarray((heading[n:] - heading[:-n]) / (n * path.spacing))
