"""Why a recording that is played gives no commands, and what helps; without ROS."""

import re

from ampc_ros.supervision.supervisor import Supervisor

OTHER_CLOCK = 5.0
"""Age of a state that has just arrived, beyond that of any network [s]."""
PATH_PATIENCE = 3.0
"""Wall time for which a path is awaited before it is reported as missing [s]."""
PLAY = "set use_sim_time:=true and play the bag with --clock 1000"


class PlaybackAdvice:
    """Finds what stands in the way of a played recording."""

    def __init__(self) -> None:
        """Begin without an input."""
        self._early = 0
        self._without_path: float | None = None
        """Wall time since which a path is awaited [s]."""
        self._reported: set[str] = set()

    def is_new(self, sentence: str) -> bool:
        """Return whether a sentence has not been asked about before; its numbers do not count."""
        words = re.sub(r"\d+ s", "", sentence)
        is_new = bool(words) and words not in self._reported
        self._reported.add(words)
        return is_new

    def take(self, supervisor: Supervisor, now_ns: int, wall: float) -> str:
        """Return cause and remedy in one sentence; empty: there is none.

        Args:
            supervisor: Supervisor with its inputs.
            now_ns: Time of the node's clock [ns].
            wall: Steady wall time of this call [s].
        """
        state, is_simulated = supervisor.state, supervisor.config.simulated_time
        count = supervisor.rejected["in_the_future"]
        early, self._early = count > self._early, count
        if state is None or supervisor.path is not None or self._without_path is None:
            self._without_path = wall
        if early and is_simulated:
            return "odom is ahead of /clock, whose steps are too large: play with --clock 1000"
        if state is None:
            return f"odom is stamped by a clock that is ahead: {PLAY}" if early else ""
        age, silence = state.ages(now_ns)
        if age > OTHER_CLOCK > silence:
            if is_simulated:
                return f"odom is {age:.0f} s behind /clock: only one player may publish /clock"
            return f"odom arrives, but its stamps are {age:.0f} s old: {PLAY}"
        if is_simulated and wall - self._without_path > PATH_PATIENCE:
            remedy = "play the bag from its start, or publish the path transient local"
            return f"reference_path is missing, --start-offset leaves it out: {remedy}"
        return ""
