"""What a node logs: missing inputs with the reason, transitions, changed parameters, choices."""

import time
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from lifecycle_msgs.msg import Transition
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.msg import ParameterType
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.config import shipped
from ampc_msgs_config.nodes.marker_node import MarkerNode
from ampc_msgs_config.nodes.qos import NEWEST
from ampc_msgs_config.nodes.waiting import SILENCE_OF_STOPPED, WAIT_PATIENCE, WaitLog
from ampc_msgs_config.types import VehicleState
from ampc_ros.configuration import CONTROLLERS
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.gate_node import GateNode
from ampc_ros.nodes.planner_node import PlannerNode
from sim_vehicle.nodes.simulator_node import SimulatorNode
from tests.driver_of_nodes import Driver, set_parameter
from tests.ros_nodes import add, ros_context, spin_until

pytestmark = pytest.mark.usefixtures("own_domain")

STATE = VehicleState(0, 0.0, 0.0, 0.0, 5.0, 0.0, 0.0)
STRAIGHT = np.array([(float(x), 0.0) for x in range(0, 100, 5)])


class Log:
    """Stands in for a node: stores what is logged."""

    wait_for_recorder = False

    def __init__(self) -> None:
        """Start empty."""
        self.lines: list[str] = []

    def get_logger(self) -> "Log":
        """Return the logger."""
        return self

    def create_timer(self, *_: Any, **__: Any) -> None:
        """Create no timer: the test looks."""

    def info(self, line: str) -> None:
        """Store a line."""
        self.lines.append(line)

    warning = info


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Replace the steady time of the log; its only element is the time [s]."""
    now = [100.0]
    monkeypatch.setattr("ampc_msgs_config.nodes.waiting.time.monotonic", lambda: now[0])
    return now


def test_a_reason_is_logged_once_after_five_seconds_and_again_when_it_changes(
    clock: list[float],
) -> None:
    log: Any = Log()
    reasons = ["/odom: it has no publisher"]
    waiting = WaitLog(log, lambda: reasons[-1])

    def look_for(seconds: int) -> list[str]:
        log.lines.clear()
        for _ in range(seconds):
            clock[0] += 1.0
            waiting.look()
        return list(log.lines)

    assert look_for(5) == []
    assert look_for(1) == ["waiting for /odom: it has no publisher"]
    assert look_for(20) == []
    reasons.append("/odom: /car publishes nothing")
    assert look_for(20) == ["waiting for /odom: /car publishes nothing"]
    reasons.append("")
    assert look_for(20) == ["no longer waiting: all inputs arrive"]
    reasons.append("/odom: /car has stopped publishing")
    assert look_for(4) == []
    assert look_for(4) == ["waiting for /odom: /car has stopped publishing"]
    assert WAIT_PATIENCE == 5.0


def test_a_short_wait_is_not_logged_and_a_missing_recorder_is(clock: list[float]) -> None:
    log: Any = Log()
    reasons = ["/odom: it has no publisher"]
    waiting = WaitLog(log, lambda: reasons[-1])
    waiting.look()
    clock[0] += 4.0
    reasons.append("")
    waiting.look()
    assert log.lines == []
    log.wait_for_recorder = True
    for _ in range(8):
        clock[0] += 1.0
        waiting.look()
    assert log.lines == ["waiting for a recorder that subscribes to this node"]


WAITS: dict[Any, tuple[str, ...]] = {
    ControllerNode: ("/odom", "/reference_path"),
    PlannerNode: ("/odom",),
    GateNode: ("/steering_command", "/target_speed"),
    SimulatorNode: ("/steering_command", "/target_speed"),
}


@pytest.mark.parametrize("lock_step", ["true", "false"])
@pytest.mark.parametrize("make_node", WAITS, ids=lambda each: each.__name__)
def test_a_node_alone_names_every_input_that_nobody_publishes(
    make_node: Any, lock_step: str
) -> None:
    with ros_context(lock_step=lock_step, controller="pure_pursuit") as executor:
        node = make_node()
        add(executor, node)
        expected = "; ".join(f"{topic}: it has no publisher" for topic in WAITS[make_node])
        assert node.waiting.reason() == expected


def test_a_publisher_that_is_silent_stops_or_is_rejected_is_named() -> None:
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node, car = ControllerNode(), Node("car")
        add(executor, node, car)
        odom = car.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        paths = car.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)

        def is_driving_and(expected: str) -> bool:
            odom.publish(ros.odometry_message(STATE._replace(stamp_ns=node.now_ns)))
            return node.waits_for() == expected

        silent = "/odom: /car publishes nothing; /reference_path: /car publishes nothing"
        spin_until(executor, lambda: node.waits_for() == silent)

        # odometry without a frame is rejected
        wrong = ros.odometry_message(STATE._replace(stamp_ns=node.now_ns))
        wrong.header.frame_id = ""
        odom.publish(wrong)
        rejected = "/odom: the messages of /car are rejected, for the reason in /diagnostics"
        spin_until(executor, lambda: node.waits_for().startswith(rejected))

        # a path in a frame without a transform
        paths.publish(ros.path_message(STRAIGHT, node.now_ns, "odom"))
        spin_until(executor, lambda: node.newest_path is not None)
        no_transform = "a transform of reference_path from 'odom' into 'map'"
        spin_until(executor, lambda: is_driving_and(no_transform))

        # a car that falls silent; the path may be old
        paths.publish(ros.path_message(STRAIGHT, node.now_ns))
        spin_until(executor, lambda: is_driving_and(""))
        node.inputs.topics[ros.ODOM].arrived_at = time.monotonic() - 2.0 * SILENCE_OF_STOPPED
        node.inputs.topics[ros.REFERENCE_PATH].arrived_at = (
            time.monotonic() - 2.0 * SILENCE_OF_STOPPED
        )
        assert node.waits_for() == "/odom: /car has stopped publishing"


def test_a_publisher_whose_qos_does_not_match_is_named_with_both_profiles() -> None:
    with ros_context() as executor:
        node, other = SimulatorNode(), Node("other")
        add(executor, node, other)
        other.create_publisher(JointState, ros.STEERING_COMMAND, NEWEST)
        other.create_publisher(TwistStamped, ros.TARGET_SPEED, ros.RELIABLE)
        expected = (
            "/steering_command: /other offers volatile, best effort, but this node requests "
            "volatile, reliable"
        )
        spin_until(executor, lambda: expected in node.waits_for_peers())


def test_the_log_names_each_transition_and_each_changed_parameter(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with ros_context(controller="pure_pursuit", static_path="true", autostart="false") as executor:
        driver = Driver(executor, ControllerNode())

        def logged_after(transition: int) -> str:
            capfd.readouterr()
            assert driver.change(transition)
            return capfd.readouterr().err

        assert "configured" in logged_after(Transition.TRANSITION_CONFIGURE)
        assert ": active\n" in logged_after(Transition.TRANSITION_ACTIVATE)
        set_parameter(driver.node, "guard", "track")
        assert "configuration 2 in use: guard = 'track'" in capfd.readouterr().err
        assert ": inactive" in logged_after(Transition.TRANSITION_DEACTIVATE)
        assert ": unconfigured" in logged_after(Transition.TRANSITION_CLEANUP)
        logged = logged_after(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
        assert ": finalized" in logged


def test_every_text_parameter_describes_its_values_and_lists_the_shipped_names() -> None:
    folders = {
        "vehicle": "vehicles",
        "scenario": "scenarios",
        "settings": "controllers",
        "gain_table": "gains",
        "guard": "guards",
        "noise": "noise",
    }
    seen = set()
    with ros_context(controller="pure_pursuit") as executor:
        for make_node in (*WAITS, MarkerNode):
            node = make_node()
            add(executor, node)
            names = list(node.get_parameters_by_prefix(""))
            for each in node.describe_parameters(names):
                if each.type != ParameterType.PARAMETER_STRING:
                    continue
                assert each.additional_constraints, each.name
                listed = shipped(folders[each.name]) if each.name in folders else ()
                known = CONTROLLERS if each.name == "controller" else listed
                assert all(name in each.additional_constraints for name in known)
                seen.add(each.name)
    assert folders.keys() | {"controller", "fixed_frame", "path", "columns"} <= seen
