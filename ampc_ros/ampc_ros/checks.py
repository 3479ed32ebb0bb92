"""Which measured states and which paths are used. No clock is read here: all times come in."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ampc_msgs_config.path import Path
from ampc_msgs_config.path_making import make_path
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.track import CAUSES, FUTURE, WINDOW, Refusal, Track, seconds_between, unusable

CONFIRMED = 3
"""States in a row that confirm a clock that jumped back."""
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
        go on from there; or where messages cannot overtake each other.
    """

    def __init__(self, *, in_order: bool = False) -> None:
        """Make a filter that takes any first state.

        Args:
            in_order: Messages cannot overtake each other, as in lock-step.
        """
        self.in_order = in_order
        self.rejected = dict.fromkeys(CAUSES, 0)
        self.track: Track | None = None
        self.candidate: Track | None = None
        self.now_ns = 0

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
        refusal = self.track.objection(state)
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
        if back and (self.in_order or clock_went_back):
            self.candidate = Track(state)
            return True
        if refusal.cause == "out_of_order":
            return False
        candidate = self._continued(state)
        lasted = seconds_between(candidate.first_ns, candidate.last.stamp_ns) >= WINDOW
        return lasted or (back and candidate.count >= CONFIRMED)

    def _continued(self, state: VehicleState) -> Track:
        """Add a state to the candidate where it follows; where it contradicts, begin another."""
        objection = self.candidate.objection(state) if self.candidate else None
        if self.candidate is None or (objection and objection.cause not in LATE):
            self.candidate = Track(state)
        elif objection is None:
            self.candidate.append(state)
        return self.candidate


def check_path(points: ArrayLike, sharpest: float, max_gap: float = MAX_GAP) -> Path:
    """Give the path through points, if this car can drive it.

    Args:
        points: (n, 2) positions in driving order [m].
        sharpest: Largest curvature that the car can drive, tan(max_angle) / wheelbase [1/m].
        max_gap: Longest distance between points, where there are more than two [m].

    Raises:
        ValueError: What `make_path` refuses, a gap, or a bend; with place, value and bound.
    """
    path = make_path(points)
    gaps = np.hypot(*np.diff(np.asarray(points, dtype=float), axis=0).T)
    widest = int(np.argmax(gaps))
    if len(gaps) > 1 and gaps[widest] > max_gap:
        raise ValueError(
            f"path: gap between points {widest} and {widest + 1} = {gaps[widest]:g} m "
            f"must be at most {max_gap:g} m"
        )
    bend = np.abs(path.curvature[:-1] if path.closed else path.curvature)
    worst = int(np.argmax(bend))
    if np.count_nonzero(bend > sharpest) > 1:
        raise ValueError(
            f"path: curvature = {path.curvature[worst]:.3g} 1/m at {worst * path.spacing:.4g} m "
            f"must lie in [{-sharpest:.3g}, {sharpest:.3g}] 1/m, what the car can steer"
        )
    return path
