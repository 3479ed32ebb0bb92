"""States of the gate, and its settings."""

from enum import Enum
from typing import NamedTuple

LATE_PERIODS, SHORTEST_LATE = 1.5, 0.06
"""Age from which a command is late [periods], at least [s]."""
TIMEOUT_PERIODS, SHORTEST_TIMEOUT = 2.5, 0.12
"""Age of a command that stops the car [periods], at least [s], which a loaded machine needs."""


class GateState(Enum):
    """What the gate does."""

    WAITING = "waiting"
    """Publishes nothing: the inputs are not complete yet."""
    DRIVING = "driving"
    """Passes commands on."""
    DEGRADED = "degraded"
    """Follows the last plan, or passes commands on without a plan for a stop."""
    STOPPING = "stopping"
    """Brakes along the last plan; latched."""
    STOPPED = "stopped"
    """Holds the car at standstill; latched."""


DRIVES = (GateState.DRIVING, GateState.DEGRADED)
STOPS = (GateState.STOPPING, GateState.STOPPED)


class GateSettings(NamedTuple):
    """Times and limits of the gate."""

    period: float = 0.1
    """Period of the commands [s]."""
    timeout: float = 0.0
    """Age of a command that stops the car; 0: that which follows from the period [s]."""
    deceleration: float = 2.5
    """Deceleration of a stop [m/s^2]."""

    @property
    def late(self) -> float:
        """Age from which a command is late [s]."""
        return max(LATE_PERIODS * self.period, SHORTEST_LATE)

    @property
    def command_timeout(self) -> float:
        """Age of a command that stops the car [s]."""
        return self.timeout or max(TIMEOUT_PERIODS * self.period, SHORTEST_TIMEOUT)
