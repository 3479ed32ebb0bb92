"""Node `markers`: subscriptions, pictures, invalid input."""

import math
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from visualization_msgs.msg import Marker, MarkerArray

from ampc_msgs_config import ros
from ampc_msgs_config.nodes import live_transforms
from ampc_msgs_config.nodes.marker_node import PICTURE_PERIOD, MarkerNode, main
from ampc_msgs_config.nodes.scene import MAX_DRAWN_POINTS, STOP_COLOUR
from ampc_msgs_config.recording.transforms import prefix_of, prefixed
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from tests.ros_nodes import add, ros_context, spin_until

LONG = np.column_stack((np.arange(5000.0), np.zeros(5000)))
TYPES: dict[str, Any] = {
    ros.ODOM: Odometry,
    ros.STEERING_COMMAND: JointState,
    ros.STEERING_STATE: JointState,
    ros.REFERENCE_PATH: PathMessage,
    ros.PREDICTED_PATH: PathMessage,
    ros.WIND: Vector3Stamped,
    ros.STOP_REQUEST: Bool,
}
LATCHED = {ros.REFERENCE_PATH, ros.STOP_REQUEST}


class Viewer(Node):
    """Publishes a drive, and subscribes to the pictures."""

    def __init__(self, executor: SingleThreadedExecutor) -> None:
        """Create a publisher for every input."""
        super().__init__("viewer")
        self.all = executor
        self.time_ns = 0
        self.pictures: list[dict[tuple[str, int], Marker]] = []
        self.inputs = {
            name: self.create_publisher(cls, name, ros.LATCHED if name in LATCHED else ros.RELIABLE)
            for name, cls in TYPES.items()
        }

    def look(self) -> None:
        """Subscribe to the pictures."""
        self.eye = self.create_subscription(MarkerArray, ros.MARKERS, self.see, ros.RELIABLE)

    def see(self, message: MarkerArray) -> None:
        """Store a picture."""
        self.pictures.append({(each.ns, each.id): each for each in message.markers})
        assert len(self.pictures[-1]) == len(message.markers)

    def drive(self, **changes: Any) -> None:
        """Publish the next state."""
        self.time_ns += NANOSECONDS // 10
        state = VehicleState(self.time_ns, 3.0, 4.0, 0.5, 9.0, 0.0, 0.0)
        self.inputs[ros.ODOM].publish(ros.odometry_message(state._replace(**changes)))

    def picture(self, **changes: Any) -> dict[tuple[str, int], Marker]:
        """Publish states until a picture of them arrives; return the newest."""
        seen = len(self.pictures)

        def drawn() -> bool:
            self.drive(**changes)
            return len(self.pictures) > seen

        spin_until(self.all, drawn)
        return self.pictures[-1]

    def picture_with(self, name: str, message: Any, key: tuple[str, int]) -> Marker:
        """Publish a message until a picture shows it; return its marker."""

        def shown() -> bool:
            self.inputs[name].publish(message)
            return key in self.picture()

        spin_until(self.all, shown)
        return self.pictures[-1][key]


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    """Create a viewer without a subscription, beside a marker node."""
    with ros_context() as executor:
        node = Viewer(executor)
        add(executor, node, MarkerNode())
        yield node


def drawer(viewer: Viewer) -> MarkerNode:
    """Return the marker node."""
    return next(node for node in viewer.all.get_nodes() if isinstance(node, MarkerNode))


def test_it_subscribes_only_while_a_viewer_is_subscribed(viewer: Viewer) -> None:
    node = drawer(viewer)
    for _ in range(10):
        viewer.drive()
        viewer.all.spin_once(timeout_sec=PICTURE_PERIOD)
    assert not node.inputs.topics
    viewer.look()
    viewer.picture()
    assert node.inputs.topics.keys() == set(TYPES)
    assert {name for name, _ in viewer.picture()} == {"car", "text"}
    viewer.destroy_subscription(viewer.eye)
    at_rest = VehicleState(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    node.keep(ros.ODOM, ros.odometry_message(at_rest))  # it came with the end of the viewer
    spin_until(viewer.all, lambda: not node.inputs.topics)
    assert not node.values
    assert not node.new


def test_it_reports_while_a_viewer_is_subscribed(viewer: Viewer) -> None:
    reports: list[DiagnosticArray] = []
    viewer.create_subscription(DiagnosticArray, ros.DIAGNOSTICS, reports.append, ros.RELIABLE)
    viewer.look()
    spin_until(viewer.all, lambda: bool(reports))
    (status,) = reports[0].status
    assert (status.name, status.message) == ("/markers", "waiting for odom")


def test_everything_is_drawn_in_the_map_with_a_lifetime(viewer: Viewer) -> None:
    viewer.look()
    viewer.inputs[ros.REFERENCE_PATH].publish(ros.path_message(LONG, 0))
    road = viewer.picture_with(
        ros.PREDICTED_PATH, ros.path_message(LONG[:20], 0), ("predicted_path", 0)
    )
    assert len(road.points) == 20
    arrow = viewer.picture_with(ros.WIND, ros.wind_message(0, (0.0, 9.0)), ("wind", 0))
    assert arrow.points[1].y > arrow.points[0].y == 4.0
    picture = viewer.picture()
    assert len(picture["reference_path", 0].points) == MAX_DRAWN_POINTS
    assert picture["reference_path", 0].points[-1].x == LONG[-1, 0]
    for each in picture.values():
        assert each.header.frame_id == ros.MAP
        assert each.action == Marker.ADD
        assert each.lifetime.sec > 0
        assert each.color.a > 0
        assert abs(math.hypot(each.pose.orientation.z, each.pose.orientation.w) - 1) < 1e-9
    assert picture["car", 0].type == Marker.CUBE
    assert picture["text", 0].text.startswith("9.0 m/s")


def test_the_measured_angle_is_preferred_to_the_commanded_one(viewer: Viewer) -> None:
    viewer.look()

    def turns(angle: float) -> bool:
        text = viewer.picture()["text", 0].text
        return f"{math.degrees(angle):+.1f} deg" in str(text)

    for topic, angle in [(ros.STEERING_COMMAND, 0.2), (ros.STEERING_STATE, 0.1)]:
        viewer.picture()
        viewer.inputs[topic].publish(ros.joint_message(0, angle, 0.0))
        spin_until(viewer.all, partial(turns, angle))
    viewer.inputs[ros.STEERING_COMMAND].publish(ros.joint_message(0, 0.2, 0.0))
    for _ in range(3):
        assert turns(0.1)


def test_request_to_stop_turns_the_car_red_also_when_it_came_before(viewer: Viewer) -> None:
    viewer.inputs[ros.STOP_REQUEST].publish(Bool(data=True))
    viewer.look()
    spin_until(viewer.all, lambda: "STOP" in viewer.picture()["text", 0].text)
    colour = viewer.pictures[-1]["car", 0].color
    assert (colour.r, colour.g, colour.b) == pytest.approx(STOP_COLOUR[:3])


def rejects_more_than(node: MarkerNode, number: int) -> bool:
    """Check whether a node has rejected more than `number` inputs."""
    return node.rejected > number


def test_invalid_input_is_counted_and_the_last_valid_one_kept(viewer: Viewer) -> None:
    node = drawer(viewer)
    viewer.look()
    viewer.inputs[ros.REFERENCE_PATH].publish(ros.path_message(LONG[:9], 0))
    spin_until(viewer.all, lambda: ("reference_path", 0) in viewer.picture())
    foreign = ros.path_message(LONG[:3], 0)
    foreign.header.frame_id = "odom"
    broken = LONG[:3].copy()
    broken[1] = math.nan
    bad = [
        (ros.REFERENCE_PATH, foreign),
        (ros.REFERENCE_PATH, ros.path_message(broken, 0)),
        (ros.STEERING_COMMAND, JointState(position=[0.1, 0.2])),
        (ros.WIND, ros.wind_message(0, (math.inf, 0.0))),
        (ros.ODOM, ros.odometry_message(VehicleState(0, math.nan, 0.0, 0.0, 0.0, 0.0, 0.0))),
    ]
    for topic, message in bad:
        before = node.rejected
        viewer.inputs[topic].publish(message)
        spin_until(viewer.all, partial(rejects_more_than, node, before))
    assert node.rejected == len(bad)
    assert len(viewer.picture()["reference_path", 0].points) == 9


def test_an_empty_path_removes_the_line(viewer: Viewer) -> None:
    viewer.look()
    viewer.inputs[ros.REFERENCE_PATH].publish(ros.path_message(LONG[:9], 0))
    spin_until(viewer.all, lambda: ("reference_path", 0) in viewer.picture())
    empty = PathMessage()
    empty.header.frame_id = ros.MAP
    viewer.inputs[ros.REFERENCE_PATH].publish(empty)
    spin_until(viewer.all, lambda: ("reference_path", 0) not in viewer.picture())


def test_pictures_come_at_most_20_times_a_second(viewer: Viewer) -> None:
    viewer.look()
    viewer.picture()
    first, start = len(viewer.pictures), time.monotonic()
    while len(viewer.pictures) < first + 10:
        viewer.drive()
        viewer.all.spin_once(timeout_sec=0.001)
    assert time.monotonic() - start > 8 * PICTURE_PERIOD


class Transforms:
    """Stand-in for tf2_msgs/TFMessage, which the wheels lack."""

    def __init__(self, transforms: list[TransformStamped]) -> None:
        """Keep the transforms."""
        self.transforms = transforms


class Listeners:
    """Stand-in for a publisher of transforms, with so many subscribers."""

    def __init__(self, count: int) -> None:
        """Start without a message."""
        self.count, self.sent = count, list[TransformStamped]()

    def get_subscription_count(self) -> int:
        """Return the number of subscribers."""
        return self.count

    def publish(self, message: Transforms) -> None:
        """Store a message."""
        self.sent += message.transforms


def test_without_tf2_msgs_one_line_says_that_tf_is_missing(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def not_installed(_: str) -> None:
        raise ValueError("this message type is not installed")

    monkeypatch.setattr(live_transforms, "message_class", not_installed)
    with ros_context() as executor:
        add(executor, MarkerNode())
    assert capfd.readouterr().err.count("/tf is not published: tf2_msgs is not installed") == 1


@pytest.mark.parametrize(
    ("arguments", "base"), [((), "base_link"), (("-r", "__ns:=/car7"), "car7/base_link")]
)
def test_every_odometry_is_broadcast_as_a_transform_while_somebody_listens(
    arguments: tuple[str, ...], base: str
) -> None:
    with ros_context(*arguments) as executor:
        node, listeners = MarkerNode(), Listeners(0)
        add(executor, node)
        node.transforms.message_class, node.transforms.publisher = Transforms, listeners
        state = VehicleState(7, 3.0, 4.0, 0.5, 9.0, 0.0, 0.0)
        for listeners.count in (0, 1):
            node.on_timer()
            node.keep(ros.ODOM, ros.odometry_message(state, "odom"))
        assert bool(node.inputs.topics)
        node.keep(ros.ODOM, ros.odometry_message(state._replace(x=math.nan)))
    (found,) = listeners.sent
    place = found.transform
    assert (found.header.frame_id, found.child_frame_id) == ("odom", base)
    assert (ros.nanoseconds(found.header.stamp), place.translation.x) == (7, 3.0)
    assert 2 * math.atan2(place.rotation.z, place.rotation.w) == pytest.approx(0.5)


def test_it_is_silent_on_tf_where_another_node_broadcasts() -> None:
    with ros_context() as executor:
        node, other = MarkerNode(), Node("localisation")
        add(executor, node, other)
        other.create_publisher(TransformStamped, "/tf", 1)
        node.transforms.message_class, node.transforms.publisher = Transforms, Listeners(1)
        node.transforms.look()

        def is_silent() -> bool:
            node.transforms.look()
            return not node.transforms.is_wanted

        spin_until(executor, is_silent)


def test_a_prefix_is_added_once() -> None:
    assert prefixed("base_link", "car1/") == "car1/base_link"
    assert prefixed("car1/base_link", "car1/") == "car1/base_link"
    assert prefix_of("", "/") == ""
    assert prefix_of("", "/fleet/car1") == "fleet/car1/"
    assert prefix_of("ego_", "/car1") == "ego_"


def test_a_wrong_vehicle_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["markers", "--ros-args", "-p", "vehicle:=tank"])
    assert main() == 2
    assert "'tank' is neither a file" in capsys.readouterr().err
