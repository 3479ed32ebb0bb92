"""Fixtures and markers of all tests: a ROS domain for each process and for single tests."""

import os
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import count

import pytest
from domain_coordinator import domain_id
from hypothesis.internal.conjecture import providers

from launch_scripts.run.processes import ros_environment
from tests.markers import markers_of

DOMAINS = 100
"""ROS domains 1 to 100 are available to tests."""
candidates = count(os.getpid())

# Hypothesis draws constants of the modules that a process has loaded. Without this line, the
# examples of a derandomised test would depend on the earlier tests of the same worker.
providers.is_local_module_file = lambda _: False  # type: ignore[assignment, attr-defined]


def next_domain() -> int:
    """Return the next domain to try.

    Each process starts elsewhere and goes round, so a domain in which nodes have been killed, or of
    another test run, is not used again soon. `domain_id` skips domains that are in use.
    """
    return next(candidates) % DOMAINS + 1


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests by file and name."""
    for item in items:
        for marker in markers_of(item.path.stem, item.path.parent.name, item.name):
            item.add_marker(marker)


@pytest.fixture(scope="session", autouse=True)
def ros_domain() -> Iterator[int]:
    """Reserve a ROS domain for this process, without other nodes; return its number."""
    with domain_id(next_domain) as number, pytest.MonkeyPatch.context() as patch:
        for name, value in ros_environment().items():
            patch.setenv(name, value)
        patch.setenv("ROS_DOMAIN_ID", str(number))
        yield number


@pytest.fixture(scope="module")
def reserved() -> Iterator[ExitStack]:
    """Hold the domains of a module's tests until its end."""
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def own_domain(ros_domain: int, reserved: ExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reserve a ROS domain for one test.

    Services of a node that an earlier test has ended remain visible in its domain for a while. A
    service that two nodes of one name seem to offer is not reported as ready, or not answered.
    """
    monkeypatch.setenv("ROS_DOMAIN_ID", str(reserved.enter_context(domain_id(next_domain))))


@pytest.fixture(scope="module", autouse=True)
def own_domain_of_module(ros_domain: int) -> Iterator[None]:
    """Reserve a ROS domain for the tests of a module, without nodes that other modules left."""
    with domain_id(next_domain) as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        yield
