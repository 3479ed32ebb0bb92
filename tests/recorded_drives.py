"""Bags of drives without ROS, with the messages that the nodes would have recorded."""

from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message
from std_msgs.msg import String

from ampc_msgs_config import ros
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.recording.bag_writer import Recording
from ampc_msgs_config.recording.message_types import type_name_of
from ampc_msgs_config.types import TickRecord, VehicleState
from ampc_ros.configuration import to_yaml
from ampc_ros.supervision.supervisor import Supervisor


class Bag:
    """A bag to which messages are appended; a context manager."""

    def __init__(self, folder: Path) -> None:
        """Open a new bag."""
        self.recording = Recording(folder)
        self.now_ns = 0

    def __enter__(self) -> "Bag":
        """Return the open bag."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bag."""
        self.recording.close()

    def add(self, topic: str, message: Any) -> None:
        """Append a message, with a later log time than all others."""
        self.now_ns += 1000
        if topic not in self.recording.topics:
            self.recording.add_topic(topic, type_name_of(type(message)))
        self.recording.write(topic, serialize_message(message), self.now_ns, self.now_ns)

    def configuration(self, supervisor: Supervisor) -> None:
        """Append the configuration of a controller."""
        text = to_yaml(supervisor.config, supervisor.number)
        self.add(f"/controller/{ros.CONFIGURATION}", String(data=text))

    def path(self, points: Any, stamp_ns: int) -> None:
        """Append a reference path."""
        self.add(f"/{ros.REFERENCE_PATH}", ros.path_message(points, stamp_ns))

    def state(self, state: VehicleState) -> VehicleState:
        """Append a measured state; return it as a subscriber receives it."""
        message = ros.odometry_message(state)
        self.add(f"/{ros.ODOM}", message)
        return ros.vehicle_state(message)

    def decision(
        self,
        record: TickRecord,
        commands: int,
        *,
        tick: bool = True,
        steering: SteeringParameters = ros.ROAD_WHEEL,
    ) -> None:
        """Write a command and its tick record."""
        command = record.command
        self.add(f"/{ros.STEERING_COMMAND}", ros.steering_message(command, steering))
        values = (*command.diagnosis, 0.001, 0.0, *record.quantities, 0, 0, commands)
        if tick:
            self.add(f"/{ros.TICK}", ros.tick_message(command.stamp_ns, values))
