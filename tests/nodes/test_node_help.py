"""The help texts of the nodes: those that are shipped describe the nodes as they are."""

import pytest

from tests.workshop.proofs.node_help import NODES, help_file, help_text


@pytest.mark.parametrize("executable", NODES)
def test_the_shipped_help_of_a_node_is_the_generated_one(executable: str) -> None:
    expected = help_text(executable)
    assert help_file(executable).read_text(encoding="utf-8") == expected, (
        "write it anew: python -m tests.workshop.proofs.node_help"
    )


def test_the_help_of_the_controller_names_topics_services_and_parameters() -> None:
    text = help_file("ampc_ros/controller").read_text(encoding="utf-8")
    for line in (
        "  odom              nav_msgs/msg/Odometry",
        "  ~/reset_stop    std_srvs/srv/Trigger",
    ):
        assert line.split() in [each.split() for each in text.splitlines()]
    assert "\n  gain_table *" in text
    assert "one of: " not in text
    assert max(map(len, text.splitlines())) <= 100
