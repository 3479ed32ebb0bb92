"""ROS domains of the tests: nodes that an earlier test left are not heard in the next one."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

import pytest
from domain_coordinator import domain_id

DOMAINS = 100
"""ROS domains 1 to 100 are available to tests."""
candidates = count(os.getpid())


def next_domain() -> int:
    """Return the next domain to try.

    Each process starts elsewhere and goes round, so a domain in which nodes have been killed, or of
    another test run, is not used again soon. `domain_id` skips domains that are in use.
    """
    return next(candidates) % DOMAINS + 1


@contextmanager
def new_domain() -> Iterator[int]:
    """Reserve a ROS domain, and use it inside the block; yield its number."""
    with domain_id(next_domain) as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        yield number
