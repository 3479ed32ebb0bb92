"""The planner over ROS: messages out of order, stops of several publishers, a silent controller."""

import numpy as np
import pytest
from rclpy.clock import ROSClock
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from ampc_msgs_config.types import ERROR, NANOSECONDS, WARN
from ampc_ros.nodes.planner_node import PlannerNode
from tests.nodes.test_nodes import odometry
from tests.nodes.test_reports import receive_stop_request, report_of
from tests.ros_nodes import add, ros_context, spin_until

pytestmark = pytest.mark.usefixtures("own_domain")

PERIOD_NS = NANOSECONDS // 50


def speed_of(node: PlannerNode) -> float:
    """Return the newest target speed [m/s]."""
    assert node.newest
    return float(node.newest.twist.linear.x)


@pytest.mark.parametrize("seed", range(3))
def test_messages_out_of_order_or_from_the_future_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    with ros_context(use_sim_time="true", scenario="sc3_varying") as executor:
        clean, disturbed = PlannerNode(), PlannerNode()
        add(executor, clean, disturbed)
        for tick in range(1, 400):
            stamp_ns = tick * PERIOD_NS
            for node in (clean, disturbed):
                node.on_odometry(odometry(stamp_ns, x=0.18 * tick))
            if rng.random() < 0.1:
                back_ns = int(rng.integers(1, NANOSECONDS // 3))
                disturbed.on_odometry(odometry(max(stamp_ns - back_ns, 1), x=0.18 * tick))
            assert speed_of(disturbed) == speed_of(clean)
        assert disturbed.rejected > 10


def test_time_that_goes_back_restarts_the_drive_but_not_the_speed_of_a_braking_car() -> None:
    with ros_context(use_sim_time="true", scenario="straight") as executor:
        node = PlannerNode()
        add(executor, node)
        clock = node.get_clock()
        assert isinstance(clock, ROSClock)

        def drive(tick: int) -> float:
            clock.set_ros_time_override(Time(nanoseconds=tick * PERIOD_NS))
            node.on_odometry(odometry(tick * PERIOD_NS, x=0.18 * tick))
            return speed_of(node)

        speeds = [drive(tick) for tick in range(100, 151)]
        receive_stop_request(node, True, 2)
        speeds += [drive(tick) for tick in range(151, 200)]
        assert speeds[-1] < 7.1
        plan = node.plan
        speeds += [drive(tick) for tick in range(10, 60)]
        assert node.plan is not plan
    assert speeds[50:] == sorted(speeds[50:], reverse=True)


def publish_stop(executor: SingleThreadedExecutor, name: str, *requests: bool) -> Node:
    """Return a node that has published stop requests."""
    node = Node(name)
    add(executor, node)
    output = node.create_publisher(Bool, ros.STOP_REQUEST, ros.LATCHED)
    spin_until(executor, lambda: output.get_subscription_count() > 0)
    for each in requests:
        output.publish(Bool(data=each))
        for _ in range(5):
            executor.spin_once(timeout_sec=0.02)
    return node


def test_a_restarted_controller_does_not_take_back_the_stop_of_its_predecessor() -> None:
    with ros_context(scenario="straight") as executor:
        node = PlannerNode()
        add(executor, node)
        first = publish_stop(executor, "controller", False, True)
        spin_until(executor, lambda: node.stop_requested)
        first.destroy_node()
        publish_stop(executor, "controller", False)
        spin_until(executor, lambda: len(node.requests._others) > 0)
        assert node.stop_requested
        assert report_of(node).message == "waiting for odom"
        node.on_reset_stop(Trigger.Request(), Trigger.Response())
        assert node.stop_requested
        spin_until(executor, lambda: not node.stop_requested)


def test_the_planner_s_reset_keeps_the_stop_of_a_publisher_that_is_alive() -> None:
    with ros_context(scenario="straight") as executor:
        node = PlannerNode()
        add(executor, node)
        publish_stop(executor, "gate", False, True)
        spin_until(executor, lambda: node.stop_requested)
        node.sources.conflict = "two controllers"
        node.on_reset_stop(Trigger.Request(), Trigger.Response())
        assert not node.sources.conflict
        spin_until(executor, lambda: node.requests.in_force)
        assert node.stop == "a stop is requested"


def test_the_planner_brakes_while_the_controller_is_silent_and_continues_with_it() -> None:
    with ros_context(scenario="straight") as executor:
        node, controller = PlannerNode(), Node("controller")
        add(executor, node, controller)
        commands = controller.create_publisher(JointState, ros.STEERING_COMMAND, ros.COMMAND)
        spin_until(executor, lambda: commands.get_subscription_count() > 0)
        assert not node.stop_requested

        def steer() -> bool:
            commands.publish(ros.joint_message(1, 0.0, 0.0))
            return bool(node.sources.arrivals) and not node.stop_requested

        spin_until(executor, steer)
        start_ns = node.now_ns

        def drive() -> bool:
            now_ns = node.now_ns
            x = 9.0 * (now_ns - start_ns) / NANOSECONDS
            node.on_odometry(odometry(now_ns, x=x))
            return node.newest is not None and speed_of(node) < 8.5

        spin_until(executor, drive)
        report = report_of(node)
        assert report.level[0] == ERROR
        assert report.message == "no steering_command for 0.5 s: braking"
        receive_stop_request(node, True, 2)
        assert report_of(node).level[0] == WARN
        spin_until(executor, lambda: steer() or node.stop == "a stop is requested")
        receive_stop_request(node, False, 3)
        spin_until(executor, steer)
