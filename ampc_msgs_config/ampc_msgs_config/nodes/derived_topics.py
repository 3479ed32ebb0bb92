"""Topics that a recorder derives from others: transforms, picture, and quantities of a tick."""

import math
import struct
from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import partial
from typing import NamedTuple

from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from visualization_msgs.msg import MarkerArray

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.marker_messages import load_outline, marker
from ampc_msgs_config.nodes.scene import View, shapes
from ampc_msgs_config.nodes.serialized_path import LITTLE_ENDIAN
from ampc_msgs_config.recording.message_types import TOPIC_TYPES
from ampc_msgs_config.recording.transforms import (
    TF_MESSAGE,
    footprint_transform,
    pose_transform,
    prefixed,
)
from ampc_msgs_config.types import NANOSECONDS, VehicleState

PICTURE_PERIOD_NS = NANOSECONDS // 5
"""Time between two recorded pictures [ns]."""
ANGLES = (ros.STEERING_STATE, ros.STEERING_COMMAND)
"""Topics of the road-wheel angle; the measured one comes first."""
PICTURED = (*ANGLES, ros.STOP_REQUEST)
"""Topics besides `odom` that change the picture."""
DEBUG_TOPICS = dict(zip(ros.DEBUG_QUANTITIES, ros.QUANTITIES, strict=True))
"""Debug topic of the controller by its quantity."""
FLOAT64 = struct.Struct("<4sd")
"""A serialised std_msgs/Float64: header of plain CDR, number."""


class Derived(NamedTuple):
    """A message that was not received, but derived from another one."""

    topic: str
    type_name: str
    data: bytes
    profile: QoSProfile


class DerivedTopics:
    """Transforms of every odometry, pictures at most 5 times a second, quantities of every tick.

    The picture has no paths: viewers draw them from their own topics. It is locked to the frame of
    the car, so that `/tf` moves it at the full rate of the odometry. The controller publishes its
    debug topics only where somebody listens: they are twenty messages at each tick.
    """

    def __init__(
        self,
        vehicle: str,
        base_link_to_cg: float,
        prefix: str,
        *,
        transforms: bool,
        pictures: bool,
        recorded: Collection[str] = (),
    ) -> None:
        """Load the car.

        Args:
            vehicle: Shipped vehicle, or YAML file.
            base_link_to_cg: From `odom` to the centre of gravity [m]; REAR_AXLE: the rear axle.
            prefix: Prefix of the frames of the car.
            transforms: Whether transforms are derived.
            pictures: Whether pictures are derived.
            recorded: Debug topics that are not derived.

        Raises:
            ValueError: The vehicle is missing or wrong.
        """
        self.car, steering = load_outline(vehicle, base_link_to_cg)
        self.angle_of = partial(ros.steering_angle, steering=steering)
        self.debug = {key: name for key, name in DEBUG_TOPICS.items() if name not in recorded}
        self.prefix, self.has_transforms, self.has_pictures = prefix, transforms, pictures
        self.begin()

    def begin(self) -> None:
        """Forget all messages."""
        self.newest: dict[str, bytes] = {}
        """Newest message of each topic in PICTURED."""
        self.is_first, self.last_ns = True, 0

    def of(self, name: str, data: bytes) -> Iterator[Derived]:
        """Return what follows from a message.

        Args:
            name: Relative name of its topic.
            data: The serialised message.
        """
        if name in PICTURED:
            self.newest[name] = data
        if name == ros.TICK:
            yield from self.quantities(data)
        elif name == ros.ODOM:
            yield from self.of_odometry(data)

    def quantities(self, tick: bytes) -> Iterator[Derived]:
        """Return the debug topics of a tick; none if the message is invalid."""
        with suppress(ValueError):
            message: JointState = ros.decode(tick, JointState)
            for key, value in zip(message.name, message.position, strict=False):
                if topic := self.debug.get(key):
                    data = FLOAT64.pack(LITTLE_ENDIAN, value)
                    yield Derived(topic, TOPIC_TYPES[topic], data, ros.RELIABLE)

    def of_odometry(self, data: bytes) -> Iterator[Derived]:
        """Return transforms and picture."""
        if self.has_transforms and (pose := pose_transform(data, self.prefix)):
            if self.is_first:
                static = footprint_transform(data, self.prefix)
                yield Derived(ros.TF_STATIC, TF_MESSAGE, static, ros.LATCHED)
            self.is_first = False
            yield Derived(ros.TF, TF_MESSAGE, pose, ros.RELIABLE)
        if self.has_pictures and (picture := self.picture(data)):
            yield Derived(ros.MARKERS, TOPIC_TYPES[ros.MARKERS], picture, ros.RELIABLE)

    def picture(self, odometry: bytes) -> bytes | None:
        """Return a serialised MarkerArray; None: the last one is young, or the odometry invalid."""
        try:
            message: Odometry = ros.decode(odometry, Odometry)
        except ValueError:
            return None
        stamp_ns, speed = ros.nanoseconds(message.header.stamp), message.twist.twist.linear.x
        is_young = self.last_ns and 0 <= stamp_ns - self.last_ns < PICTURE_PERIOD_NS
        if is_young or not (message.child_frame_id and math.isfinite(speed)):
            return None
        self.last_ns = stamp_ns
        at_origin = VehicleState(stamp_ns, 0.0, 0.0, 0.0, speed, 0.0, 0.0)
        view = View(at_origin, steering=self.steering(), stop=self.stop())
        frame = prefixed(message.child_frame_id, self.prefix)
        markers = [marker(shape, stamp_ns, frame) for shape in shapes(view, self.car)]
        for each in markers:
            each.frame_locked = True
        return bytes(serialize_message(MarkerArray(markers=markers)))

    def steering(self) -> float:
        """Return the newest valid road-wheel angle; 0 if there is none [rad]."""
        for topic in ANGLES:
            with suppress(ValueError, KeyError):
                return self.angle_of(ros.decode(self.newest[topic], JointState)).value
        return 0.0

    def stop(self) -> bool:
        """Return whether a stop is requested."""
        with suppress(ValueError, KeyError):
            return bool(ros.decode(self.newest[ros.STOP_REQUEST], Bool).data)
        return False
