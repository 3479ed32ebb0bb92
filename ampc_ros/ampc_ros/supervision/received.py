"""An input with the times that belong to it, and how old it is."""

from typing import Generic, NamedTuple, TypeVar

from ampc_msgs_config.types import NANOSECONDS

T = TypeVar("T")


class Ages(NamedTuple):
    """How old an input is."""

    age: float
    """Since its stamp [s]."""
    silence: float
    """Since its arrival [s]."""


class Received(NamedTuple, Generic[T]):
    """An input, the time to which it belongs, and when it came in."""

    value: T
    stamp_ns: int
    arrival_ns: int

    def ages(self, now_ns: int) -> Ages:
        """Give how old it is by both times."""
        return Ages(
            (now_ns - self.stamp_ns) / NANOSECONDS, (now_ns - self.arrival_ns) / NANOSECONDS
        )

    def is_older(self, now_ns: int, limit: float) -> bool:
        """Whether it is older than a limit [s], by either time."""
        return max(self.ages(now_ns)) > limit
