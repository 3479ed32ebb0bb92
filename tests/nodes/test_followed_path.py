"""Paths of other planners: their speed, what is wrong with them, and the planner that follows."""

import importlib
import math
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from ampc_msgs_config import ros
from ampc_msgs_config.paths.path_file import SpeedLimits
from ampc_msgs_config.scenarios.scenario import PathWithSpeed, speed_at
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.nodes import followed_path
from ampc_ros.nodes.followed_path import build_route
from ampc_ros.nodes.planner_node import PlannerNode
from ampc_ros.nodes.received_path import Shift
from tests.message_packages import importable
from tests.nodes.test_reports import report_of
from tests.ros_nodes import add, ros_context, spin_until

STRAIGHT = np.column_stack((np.arange(0.0, 200.0, 2.0), np.zeros(100)))
ANGLES = np.linspace(0.0, math.pi, 100)
ARC = 20.0 * np.column_stack((np.sin(ANGLES), 1.0 - np.cos(ANGLES)))
NO_LIMITS = SpeedLimits(longitudinal_acceleration=100.0)


@pytest.fixture(autouse=True)
def _nothing_built(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget the newest path of this process."""
    monkeypatch.setattr(followed_path, "_last_built", None)


@pytest.fixture(scope="module")
def trajectory() -> Iterator[Any]:
    """Return a function that packs points and speeds as Autoware's Trajectory."""
    with importable(["autoware_planning_msgs"]):
        messages = importlib.import_module("autoware_planning_msgs.msg")

        def packed(points: Array, speeds: Any) -> bytes:
            message = messages.Trajectory()
            message.header.frame_id = "map"
            for (x, y), v in zip(points.tolist(), speeds, strict=True):
                point = messages.TrajectoryPoint()
                point.pose.position.x, point.pose.position.y = x, y
                point.longitudinal_velocity_mps = float(v)
                message.points.append(point)
            return bytes(serialize_message(message))

        yield packed


def path_of(points: Array, seconds: Any = None) -> bytes:
    """Return a serialised path, with arrival times [s] as the stamps of its poses."""
    message = ros.path_message(points, 5 * NANOSECONDS)
    for pose, at in zip(message.poses, [] if seconds is None else seconds, strict=False):
        pose.header = Header(stamp=ros.time_message(round(at * NANOSECONDS)), frame_id="map")
    return bytes(serialize_message(message))


def route_of(data: bytes, kind: str, limits: SpeedLimits = NO_LIMITS) -> PathWithSpeed:
    """Return the path with its speed."""
    route = build_route(data, kind, 0, Shift(), limits).route
    assert route
    return route


def test_a_path_gets_the_constant_speed_and_the_limit_of_the_lateral_acceleration() -> None:
    route = route_of(path_of(ARC), "path", NO_LIMITS._replace(speed=7.0))
    assert route.speed.speed == pytest.approx(7.0)
    limits = NO_LIMITS._replace(speed=30.0, lateral_acceleration=2.0)
    route = route_of(path_of(ARC + 0.5), "path", limits)
    middle = speed_at(route.speed, route.path.length / 2)
    assert middle == pytest.approx(math.sqrt(2.0 * 20.0), rel=0.01), "v^2 = a r"


def test_arrival_times_give_the_speed_between_the_points() -> None:
    v = 4.0 + 0.02 * STRAIGHT[:, 0]
    seconds = 1.7e9 + np.concatenate(([0.0], np.cumsum(2.0 / ((v[1:] + v[:-1]) / 2))))
    route = route_of(path_of(STRAIGHT, seconds), "timed_path")
    for s in (20.0, 100.0, 180.0):
        assert speed_at(route.speed, s) == pytest.approx(4.0 + 0.02 * s, rel=0.01)


def test_a_trajectory_carries_a_speed_for_each_point(trajectory: Any) -> None:
    v = np.linspace(8.0, 0.0, len(ARC))
    route = route_of(trajectory(ARC, v), "autoware")
    s = np.linspace(0.0, route.path.length, 9)
    found = [speed_at(route.speed, each) for each in s.tolist()]
    assert found == pytest.approx((8.0 * (1 - s / s[-1])).tolist(), abs=0.05)
    capped = route_of(trajectory(ARC, v), "autoware", NO_LIMITS._replace(speed=3.0))
    assert max(capped.speed.speed) == pytest.approx(3.0)


def test_an_equal_message_is_not_built_again_and_another_speed_is(trajectory: Any) -> None:
    data = trajectory(ARC, np.full(len(ARC), 5.0))
    assert build_route(data, "autoware", 1, Shift(), NO_LIMITS).points is not None
    again = build_route(data, "autoware", 2, Shift(), NO_LIMITS)
    assert (again.points, again.stamp_ns) == (None, 2)
    other = trajectory(ARC, np.full(len(ARC), 6.0))
    assert build_route(other, "autoware", 3, Shift(), NO_LIMITS).points is not None


def test_a_path_in_another_frame_is_shifted() -> None:
    built = build_route(path_of(STRAIGHT), "path", 0, Shift(10.0, 0.0, math.pi / 2), NO_LIMITS)
    assert built.route
    assert built.route.path.x == pytest.approx(np.full(len(built.route.path.x), 10.0), abs=1e-9)
    assert built.route.path.y[-1] == pytest.approx(198.0)


@pytest.mark.parametrize(
    ("speed", "said"),
    [
        (-1.0, r"points\[3\].longitudinal_velocity_mps = -1 must lie in \[0, 100\]"),
        (math.nan, r"points\[3\].longitudinal_velocity_mps = nan must be finite"),
        (1.0e6, r"points\[3\].longitudinal_velocity_mps = 1e\+06 must lie in"),
    ],
)
def test_a_wrong_speed_is_named_with_its_index(speed: float, said: str, trajectory: Any) -> None:
    speeds = np.full(len(ARC), 5.0)
    speeds[3] = speed
    with pytest.raises(ValueError, match=said):
        build_route(trajectory(ARC, speeds), "autoware", 0, Shift(), NO_LIMITS)


@pytest.mark.parametrize("seconds", [np.zeros(100), np.arange(100.0)[::-1] + 1.0])
def test_times_that_do_not_increase_are_named(seconds: Array) -> None:
    with pytest.raises(ValueError, match=r"poses\[1\].header.stamp = .* must be later than"):
        build_route(path_of(STRAIGHT, seconds), "timed_path", 0, Shift(), NO_LIMITS)


def test_random_bytes_raise_nothing_but_a_sentence(trajectory: Any) -> None:
    assert trajectory
    rng = np.random.default_rng(3)
    good = path_of(STRAIGHT, np.arange(100.0))
    for i in range(200):
        kind = ("path", "timed_path", "autoware")[i % 3]
        data = bytearray(good)
        for at in rng.integers(0, len(good), 3).tolist():
            data[at] = int(rng.integers(0, 256))
        data = data[: int(rng.integers(4, len(good)))] if i % 2 else data
        with suppress(ValueError):
            build_route(bytes(data), kind, 0, Shift(), NO_LIMITS)


class Peer(Node):
    """Another planner, and a car on a straight."""

    def __init__(self) -> None:
        """Create the publishers."""
        super().__init__("peer")
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, 1)
        self.odom = self.create_publisher(Odometry, ros.ODOM, 1)
        self.speeds: list[TwistStamped] = []
        self.create_subscription(TwistStamped, ros.TARGET_SPEED, self.speeds.append, 1)
        self.x, self.sent_ns = 0.0, 0

    def send(self, points: Array | None, v: float) -> None:
        """Publish a state, and a path."""
        now_ns = self.get_clock().now().nanoseconds
        if self.sent_ns:
            self.x += v * (now_ns - self.sent_ns) / NANOSECONDS
        self.sent_ns = now_ns
        if points is not None:
            self.paths.publish(ros.path_message(points, now_ns))
        state = VehicleState(now_ns, self.x, 0.0, 0.0, v, 0.0, 0.0)
        self.odom.publish(ros.odometry_message(state))


@pytest.mark.usefixtures("own_domain")
def test_the_planner_drives_along_the_path_of_another_one_and_brakes_when_it_is_empty() -> None:
    with ros_context(follow="path", speed="6.0") as executor:
        planner, peer = PlannerNode(), Peer()
        add(executor, planner, peer)
        spin_until(executor, lambda: peer.odom.get_subscription_count() > 0)
        assert report_of(planner).message == "waiting for reference_path"
        assert planner.count_publishers(ros.REFERENCE_PATH) == 1, "only that of the other planner"

        def speed_after(points: Array | None, v: float) -> float:
            known = len(peer.speeds)

            def is_answered() -> bool:
                peer.send(points, v)
                return len(peer.speeds) > known

            spin_until(executor, is_answered)
            return float(peer.speeds[-1].twist.linear.x)

        straight = np.column_stack((np.arange(0.0, 3000.0, 5.0), np.zeros(600)))
        assert speed_after(straight, 0.0) > 0.0
        plan = planner.plan
        spin_until(executor, lambda: speed_after(straight, 1.0) == pytest.approx(6.0))
        assert planner.plan is plan, "an equal path keeps the position on it"
        spin_until(executor, lambda: speed_after(straight[:0], 1.0) < 0.7)
        spin_until(executor, lambda: speed_after(straight, 1.0) == pytest.approx(6.0))


@pytest.mark.usefixtures("own_domain")
def test_an_empty_trajectory_becomes_an_empty_path_and_the_next_one_is_followed(
    trajectory: Any,
) -> None:
    with ros_context(follow="autoware") as executor:
        planner, peer = PlannerNode(), Peer()
        heard: list[int] = []

        def hear(message: PathMessage) -> None:
            heard.append(len(message.poses))

        peer.create_subscription(PathMessage, ros.REFERENCE_PATH, hear, ros.LATCHED)
        add(executor, planner, peer)
        assert planner.follower
        peer.destroy_publisher(peer.paths)
        spin_until(executor, lambda: peer.odom.get_subscription_count() > 0)
        peer.send(None, 0.0)
        spin_until(executor, lambda: planner.follower.frame is not None)  # type: ignore[union-attr]
        full = trajectory(ARC, np.full(len(ARC), 5.0))
        for data in (full, trajectory(ARC[:0], []), full):
            known = len(heard)
            planner.follower.on_data(data)
            spin_until(executor, lambda count=known: len(heard) > count)  # type: ignore[misc]
        assert heard == [len(ARC), 0, len(ARC)]
        assert planner.plan is not None


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"follow": "path"}, "speed = -1 or lateral_acceleration = -1 must be greater than 0"),
        ({"follow": "path", "speed": "5.0", "lock_step": "true"}, "needs lock_step = false"),
        ({"follow": "paths"}, "follow = 'paths' must be one of none, path, timed_path, autoware"),
    ],
)
def test_a_planner_without_a_speed_or_in_lock_step_does_not_follow(
    parameters: dict[str, str], said: str
) -> None:
    with ros_context(**parameters), pytest.raises(ValueError, match=said):
        PlannerNode()
