"""Node `markers`: draw the drive for RViz2 and Foxglove. `ros2 run ampc_msgs_config markers`.

It subscribes to the drive only while a viewer is subscribed, draws at most 20 times a second of
wall time, and no other node waits for it. Where tf2_msgs is installed and no other node publishes
`/tf`, it broadcasts the pose of the car there.
"""

import math
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from visualization_msgs.msg import MarkerArray

from ampc_msgs_config import ros, topics
from ampc_msgs_config.config import shipped_or_file
from ampc_msgs_config.nodes import qos
from ampc_msgs_config.nodes.base_node import BaseNode, declare, spin
from ampc_msgs_config.nodes.inputs import Inputs
from ampc_msgs_config.nodes.live_transforms import LiveTransforms
from ampc_msgs_config.nodes.marker_messages import load_outline, marker
from ampc_msgs_config.nodes.scene import EMPTY_PATH, View, shapes, thin_points
from ampc_msgs_config.parameters import REAR_AXLE
from ampc_msgs_config.recording.transforms import prefix_of
from ampc_msgs_config.types import Array, VehicleState

PICTURE_PERIOD = 0.05
"""Wall time between two pictures [s]."""
LIFETIME = 2
"""Time after which a viewer removes a marker that is not redrawn [s]. It is simulated time if the
viewer uses that: a drive in lock-step runs up to 20 times as fast as the wall clock."""


class MarkerNode(BaseNode):
    """Keeps the newest message of each input, and unpacks it before drawing."""

    has_compiled_code = False

    def __init__(self) -> None:
        """Load the car, without subscriptions yet."""
        super().__init__("markers")
        vehicle = declare(self, "vehicle", "paper", "car to draw", shipped_or_file("vehicles"))
        to_cg = declare(
            self,
            "base_link_to_cg",
            REAR_AXLE,
            "odom to centre of gravity [m]; -1: rear axle",
            (-20, 20),
        )
        text, allowed = "prefix of the car's frames in /tf", "such as car1/; empty: the namespace"
        prefix = prefix_of(declare(self, "frame_prefix", "", text, allowed), self.get_namespace())
        self.car, steering = load_outline(vehicle, to_cg)
        angle_of = partial(ros.steering_angle, steering=steering)
        self.sources: dict[str, tuple[Any, QoSProfile, Callable[[Any], Any]]] = {
            topics.ODOM: (Odometry, qos.NEWEST, self.state_of),
            topics.STEERING_COMMAND: (JointState, qos.NEWEST, angle_of),
            topics.STEERING_STATE: (JointState, qos.NEWEST, angle_of),
            topics.REFERENCE_PATH: (PathMessage, qos.LATCHED, self.points_of),
            topics.PREDICTED_PATH: (PathMessage, qos.NEWEST, self.points_of),
            topics.WIND: (Vector3Stamped, qos.NEWEST, wind_of),
            topics.STOP_REQUEST: (Bool, qos.LATCHED, lambda message: bool(message.data)),
        }
        self.inputs = Inputs(self)
        self.new: dict[str, Any] = {}
        self.values: dict[str, Any] = {}
        self.pictures = 0
        self.frame_id = topics.MAP
        self.publisher = self.create_publisher(MarkerArray, topics.MARKERS, qos.COMMAND)
        self.transforms = LiveTransforms(self, prefix)
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(PICTURE_PERIOD, self.on_timer, clock=self.steady)
        self.create_timer(1.0, self.on_diagnostics, clock=None if self.lock_step else self.steady)
        self.get_logger().info("ready")

    def on_timer(self) -> None:
        """Draw if there is a new state and a viewer is subscribed."""
        self.transforms.look()
        is_watched = self.publisher.get_subscription_count() > 0
        if not (is_watched or self.transforms.is_wanted):
            self.unsubscribe()
        elif not self.inputs.topics:
            self.subscribe()
        elif is_watched and self.unpack_new():
            self.draw()

    def subscribe(self) -> None:
        """Subscribe to the drive."""
        for topic, (message_type, profile, _) in self.sources.items():
            keep = partial(self.keep, topic)
            profiles = ros.ANY_PUBLISHER if topic == ros.REFERENCE_PATH else (profile,)
            self.inputs.add(message_type, topic, keep, *profiles)

    def keep(self, topic: str, message: Any) -> None:
        """Keep the newest message of a topic; broadcast the pose of the car at once."""
        self.new[topic] = message
        if topic == topics.ODOM:
            self.transforms.send(message)

    def unsubscribe(self) -> None:
        """Remove all subscriptions and values."""
        self.inputs.destroy()
        self.new.clear()
        self.values.clear()

    def state_of(self, message: Odometry) -> VehicleState:
        """Unpack a state; its frame is that of the drawing."""
        state = ros.vehicle_state(message)
        self.frame_id = message.header.frame_id
        return state

    def points_of(self, message: PathMessage) -> Array:
        """Unpack a path, thinned (n, 2) [m]; an empty one removes the line.

        Raises:
            ValueError: The frame is not that of `odom`, or a number is not finite.
        """
        if message.header.frame_id != self.frame_id:
            raise ValueError(
                f"header.frame_id = {message.header.frame_id!r} must be {self.frame_id!r}, as in "
                "odom"
            )
        positions = [pose.pose.position for pose in message.poses]
        return thin_points(np.array([(at.x, at.y) for at in positions]).reshape(-1, 2))

    def unpack_new(self) -> bool:
        """Unpack new messages; return whether there is a new state. Invalid input is left out."""
        if ros.ODOM not in self.new and ros.ODOM not in self.values:
            return False  # the frame is not known yet
        messages = {topic: self.new.pop(topic) for topic in self.sources if topic in self.new}
        updated = set()
        for topic, message in messages.items():
            try:
                self.values[topic] = self.sources[topic][2](message)
                updated.add(topic)
            except (ValueError, OverflowError) as error:
                self.reject(ValueError(f"{topic}: {error}"))
        return topics.ODOM in updated

    def draw(self) -> None:
        """Publish a picture of the current values."""
        values, straight = self.values, ros.Stamped(0, 0.0)
        state: VehicleState = values[topics.ODOM]
        view = View(
            state,
            values.get(topics.STEERING_STATE, values.get(topics.STEERING_COMMAND, straight)).value,
            values.get(topics.WIND, (0.0, 0.0)),
            values.get(topics.REFERENCE_PATH, EMPTY_PATH),
            values.get(topics.PREDICTED_PATH, EMPTY_PATH),
            values.get(topics.STOP_REQUEST, False),
        )
        markers = [marker(shape, state.stamp_ns, self.frame_id) for shape in shapes(view, self.car)]
        for each in markers:
            each.lifetime.sec = LIFETIME
        self.publisher.publish(MarkerArray(markers=markers))
        self.pictures += 1

    def on_diagnostics(self) -> None:
        """Publish diagnostics once a second, while a viewer is subscribed."""
        if self.inputs.topics:
            waiting = [] if ros.ODOM in self.values else ["waiting for odom"]
            sentence = "; ".join([*waiting, *self.inputs.mismatches()])
            self.report(self.now_ns, sentence, {"pictures": self.pictures})


def wind_of(message: Vector3Stamped) -> tuple[float, float]:
    """Unpack a wind velocity [m/s].

    Raises:
        ValueError: A number is not finite.
    """
    wind = message.vector.x, message.vector.y
    if not all(map(math.isfinite, wind)):
        raise ValueError(f"vector = {wind} must be finite")
    return wind


def main() -> int:
    """Run the node."""
    return spin(MarkerNode)


if __name__ == "__main__":
    sys.exit(main())
