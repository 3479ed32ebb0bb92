"""A recorder that joins a drive, as `ros2 bag record` does: its bag is replayed bit for bit."""

import re
from functools import partial
from pathlib import Path

import pytest
from rclpy.node import Node

from ampc_msgs_config import ros
from ampc_msgs_config.recording.message_types import TOPIC_TYPES, message_class
from ampc_ros.nodes.controller_node import ControllerNode
from launch_scripts.replay import main as replay
from tests.driver_of_nodes import Driver
from tests.ros_nodes import add, ros_context, spin_until
from tests.rosbag2_bags import LATCHED, Recorded, write_mcap

pytestmark = pytest.mark.usefixtures("own_domain")
TOPICS = (ros.ODOM, ros.STEERING_COMMAND, ros.TICK, *LATCHED)


class LateRecorder(Node):
    """Stores the serialised messages of a drive in the order of their arrival."""

    def __init__(self) -> None:
        """Subscribe to all topics as their publishers offer them."""
        super().__init__("rosbag2_recorder")
        self.messages: list[Recorded] = []
        for name in TOPICS:
            qos = ros.LATCHED if name in LATCHED else ros.RELIABLE
            store = partial(self.store, f"/{name}", TOPIC_TYPES[name])
            self.create_subscription(message_class(TOPIC_TYPES[name]), name, store, qos, raw=True)

    def store(self, topic: str, type_name: str, data: bytes) -> None:
        """Store a message."""
        now_ns = int(self.get_clock().now().nanoseconds)
        self.messages.append(Recorded(topic, type_name, data, now_ns, now_ns))

    def count(self, name: str) -> int:
        """Return the number of messages of a topic."""
        return sum(each.topic == f"/{name}" for each in self.messages)


def test_a_bag_begun_in_mid_drive_is_exact_from_the_next_memory_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with ros_context(static_path="true") as executor:
        driver = Driver(executor, ControllerNode())
        driver.create_timer(0.02, driver.drive)
        spin_until(executor, lambda: len(driver.commands) >= 15)
        recorder = LateRecorder()
        add(executor, recorder)
        spin_until(executor, lambda: recorder.count(ros.MEMORY) >= 2)
        end = recorder.count(ros.TICK) + 12
        spin_until(executor, lambda: recorder.count(ros.TICK) >= end)
    # the path was published before, and is delivered at the start
    assert ros.REFERENCE_PATH in {each.topic[1:] for each in recorder.messages}
    assert replay([str(write_mcap(tmp_path / "bag", recorder.messages))]) == 0
    text = capsys.readouterr().out
    found = re.search(r"(\d+) ticks are missing from tick 1 on: exact from tick (\d+)", text)
    assert found
    missing, exact = map(int, found.groups())
    assert 10 <= missing < exact <= missing + 42
    compared = re.search(r"each of (\d+) commands equals the recorded one, bit for bit", text)
    assert compared
    assert int(compared[1]) >= 12
