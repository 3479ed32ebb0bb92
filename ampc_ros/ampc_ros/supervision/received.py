"""An input with its stamp and arrival time."""

from typing import Generic, NamedTuple, TypeVar

from ampc_msgs_config.types import NANOSECONDS

T = TypeVar("T")


class Ages(NamedTuple):
    """Age of an input by both of its times."""

    age: float
    """Time since its stamp [s]."""
    silence: float
    """Time since its arrival [s]."""


class Received(NamedTuple, Generic[T]):
    """An input, its stamp and its arrival time."""

    value: T
    stamp_ns: int
    arrival_ns: int

    def ages(self, now_ns: int) -> Ages:
        """Return the age by both times."""
        return Ages(
            (now_ns - self.stamp_ns) / NANOSECONDS, (now_ns - self.arrival_ns) / NANOSECONDS
        )

    def is_older(self, now_ns: int, limit: float) -> bool:
        """Return whether it is older than a limit [s] by either time."""
        return max(self.ages(now_ns)) > limit
