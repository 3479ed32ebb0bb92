"""What all tests share: a ROS domain of their own."""

from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from domain_coordinator import domain_id

from launch_scripts.run.environment import ros_environment


@pytest.fixture(scope="session", autouse=True)
def ros_domain() -> Iterator[int]:
    """Reserves a ROS domain for this session, so that no other node is seen, and gives its id."""
    with domain_id() as number, pytest.MonkeyPatch.context() as patch:
        for name, value in ros_environment().items():
            patch.setenv(name, value)
        patch.setenv("ROS_DOMAIN_ID", str(number))
        yield number


@pytest.fixture(scope="module")
def reserved() -> Iterator[ExitStack]:
    """Hold the domains of a module's tests until its end, so that none is used twice."""
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def own_domain(ros_domain: int, reserved: ExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a test a ROS domain of its own.

    Services of a node that an earlier test has ended may be seen for a while in its domain, and a
    service that two nodes of one name seem to offer is not called ready, or not answered.
    """
    monkeypatch.setenv("ROS_DOMAIN_ID", str(reserved.enter_context(domain_id())))
