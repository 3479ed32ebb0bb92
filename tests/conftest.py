"""Fixtures and markers of all tests: ROS domains, and a check that no process is left."""

import gc
import os
import time
from collections.abc import Generator, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from domain_coordinator import domain_id
from hypothesis.internal.conjecture import providers

from launch_scripts.run.processes import ros_environment
from tests import message_packages
from tests.default_signals import restore_signals
from tests.foreign_messages import PACKAGES
from tests.left_processes import kill_processes, parent_of, processes_with
from tests.markers import markers_of
from tests.ros_domains import new_domain, next_domain

PERMANENT = ("multiprocessing.forkserver", "multiprocessing.resource_tracker")
"""Processes that Python starts for itself, and ends with this one."""
GRACE = 10.0
"""Wall time that processes of a module have to end after its last test [s]."""

# Hypothesis draws constants of the modules that a process has loaded. Without this line, the
# examples of a derandomised test would depend on the earlier tests of the same worker.
providers.is_local_module_file = lambda _: False  # type: ignore[assignment, attr-defined]


def pytest_configure() -> None:
    """Let signals end the processes of the tests."""
    restore_signals()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Load the tests without searches for garbage: each of them would go through all of them."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests by file and name."""
    for item in items:
        for marker in markers_of(item.path.stem, item.path.parent.name, item.name):
            item.add_marker(marker)


@pytest.fixture(scope="session", autouse=True)
def ros_domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Reserve a ROS domain for this process, without other nodes; return its number."""
    with new_domain() as number, pytest.MonkeyPatch.context() as patch:
        for name, value in ros_environment().items():
            patch.setenv(name, value)
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield number


@pytest.fixture(scope="session")
def foreign_packages() -> dict[str, Path]:
    """Build the message packages of other stacks, once; return their folders by name."""
    try:
        return {name: message_packages.built(name) for name in PACKAGES}
    except RuntimeError as error:
        return pytest.fail(str(error), pytrace=False)


@pytest.fixture
def foreign_messages(foreign_packages: dict[str, Path]) -> Iterator[None]:
    """Make these packages importable in this process and its children, for one test."""
    with message_packages.importable(foreign_packages):
        yield


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
    with new_domain():
        yield


@pytest.fixture(scope="session")
def mark() -> Iterator[str]:
    """Set a variable of the environment that the processes of this session inherit."""
    name = f"AMPC_TESTS_{os.getpid()}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(name, "1")
        yield name


@pytest.fixture(scope="module", autouse=True)
def no_process_is_left(mark: str, request: pytest.FixtureRequest) -> Iterator[None]:
    """Check that all processes have ended that the tests of a module started."""
    yield
    until = time.monotonic() + GRACE
    while left := temporary_processes(mark):
        if time.monotonic() > until:
            kill_processes(left)
            pytest.fail(f"{request.node.name} leaves {'; '.join(left.values())}", pytrace=False)
        time.sleep(0.05)


def temporary_processes(mark: str) -> dict[int, str]:
    """Return the processes of this session that have to end with their module."""
    return {
        number: command
        for number, command in processes_with(mark).items()
        if parent_of(number) != os.getpid() or not any(name in command for name in PERMANENT)
    }
