"""Fixtures of the node tests."""

import pytest

from ampc_ros.nodes import initial_angle


@pytest.fixture(autouse=True)
def start_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let controllers of this process start from zero without a wait, where no angle is known.

    `test_initial_angle.py` tests the wait; the other tests publish no `steering_state`.
    """
    monkeypatch.setattr(initial_angle, "START_WAIT", 0.0)
