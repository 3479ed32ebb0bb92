"""What all tests share: a ROS domain of their own."""

from collections.abc import Iterator

import pytest
from domain_coordinator import domain_id

from launch_scripts.environment import ros_environment


@pytest.fixture(scope="session", autouse=True)
def ros_domain() -> Iterator[int]:
    """Reserves a ROS domain for this session, so that no other node is seen, and gives its id."""
    with domain_id() as number, pytest.MonkeyPatch.context() as patch:
        for name, value in ros_environment().items():
            patch.setenv(name, value)
        patch.setenv("ROS_DOMAIN_ID", str(number))
        yield number
