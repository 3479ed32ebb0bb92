"""A recording that is played as `ros2 bag play` does: commands, or one message with the remedy."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.supervision import playback
from tests.ros_nodes import add, connect, ros_context, spin_until

pytestmark = pytest.mark.usefixtures("own_domain")

START_NS = 1_600_000_000 * NANOSECONDS
"""First stamp of the recording [ns]."""
ODOM_NS = NANOSECONDS // 50
ROAD = np.column_stack((np.arange(0.0, 300.0, 2.0), np.zeros(150)))


class Player(Node):
    """Plays a drive along a straight road at 9 m/s, as fast as the controller receives it."""

    def __init__(self, executor: SingleThreadedExecutor, clock_hz: float, rate: float) -> None:
        """Create the publishers, and the controller.

        Args:
            executor: Executor of both nodes.
            clock_hz: Wall rate of /clock, as `--clock` states it [1/s]; 0: none.
            rate: Recorded time that passes in a second, as `--rate` states it.
        """
        super().__init__("player", use_global_arguments=False)
        self.executor_of_all, self.controller = executor, ControllerNode()
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.clock = self.create_publisher(Clock, ros.CLOCK, 10) if clock_hz else None
        self.clock_step_ns = round(rate / clock_hz * NANOSECONDS) if clock_hz else 0
        self.commands: list[JointState] = []
        self.reports: list[str] = []
        self.create_subscription(JointState, ros.STEERING_COMMAND, self.commands.append, 10)
        self.create_subscription(DiagnosticArray, ros.DIAGNOSTICS, self.on_report, 10)
        add(executor, self, self.controller)
        connect(executor, self, self.controller)

    def on_report(self, message: DiagnosticArray) -> None:
        """Store the message of a report."""
        self.reports += [status.message for status in message.status]

    def play(self, begin: float, end: float) -> None:
        """Play from one time of the recording to another [s]."""
        if begin == 0.0:
            self.paths.publish(ros.path_message(ROAD, START_NS))
            spin_until(self.executor_of_all, lambda: self.controller.supervisor.path is not None)
        clock_ns = 0
        for time_ns in range(round(begin * NANOSECONDS), round(end * NANOSECONDS), ODOM_NS):
            if self.clock and (START_NS + time_ns - clock_ns >= self.clock_step_ns):
                clock_ns = START_NS + time_ns
                self.set_clock(clock_ns)
            self.publish_state(time_ns)

    def set_clock(self, now_ns: int) -> None:
        """Publish a time, and wait until the controller has it."""
        assert self.clock
        self.clock.publish(Clock(clock=ros.time_message(now_ns)))
        spin_until(self.executor_of_all, lambda: self.controller.now_ns == now_ns)

    def publish_state(self, time_ns: int) -> None:
        """Publish a state, and wait until the controller has taken or rejected it."""
        supervisor, stamp_ns = self.controller.supervisor, START_NS + time_ns
        x = 9.0 * time_ns / NANOSECONDS
        rejected = sum(supervisor.rejected.values())
        state = VehicleState(stamp_ns, x, 0.2, 0.0, 9.0, 0.0, 0.0)
        self.odom.publish(ros.odometry_message(state))
        spin_until(
            self.executor_of_all,
            lambda: (
                supervisor.newest_ns == stamp_ns or sum(supervisor.rejected.values()) > rejected
            ),
        )

    def wait_for(self, *words: str) -> None:
        """Wait until the newest report contains all words."""
        spin_until(
            self.executor_of_all,
            lambda: bool(self.reports) and all(each in self.reports[-1] for each in words),
        )


@contextmanager
def player(
    clock_hz: float = 1000.0, rate: float = 1.0, simulated: str = "true"
) -> Iterator[Player]:
    """Create player and controller in a context of their own."""
    parameters: dict[str, Any] = {"use_sim_time": simulated, "static_path": "true"}
    with ros_context(controller="pure_pursuit", **parameters) as executor:
        yield Player(executor, clock_hz, rate)


@pytest.mark.parametrize("rate", [1.0, 5.0, 20.0])
def test_with_a_fine_clock_any_rate_gives_commands(rate: float) -> None:
    with player(rate=rate) as each:
        each.play(0.0, 0.5)
        each.reports.clear()  # before the clock had started
        each.play(0.5, 3.0)
        assert len(each.commands) >= 25
        assert not each.controller.supervisor.stop_requested
        assert not [text for text in each.reports if "--clock" in text]


def test_a_coarse_clock_is_named_with_the_remedy(capfd: pytest.CaptureFixture[str]) -> None:
    with player(clock_hz=40.0, rate=5.0) as each:
        each.play(0.0, 3.0)
        assert len(each.commands) >= 15
        each.play(3.0, 3.2)
        each.controller.on_diagnostics()
        each.wait_for("steps are too large", "--clock 1000")
    assert capfd.readouterr().err.count("steps are too large") == 1


def test_old_stamps_on_a_clock_of_today_are_named_with_the_remedy(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with player(clock_hz=0.0, simulated="false") as each:
        each.play(0.0, 0.5)
        each.wait_for("a stop is requested", "use_sim_time:=true", "--clock 1000")
        each.play(0.5, 1.0)
        each.controller.on_diagnostics()
    assert capfd.readouterr().err.count("use_sim_time:=true") == 1


def test_a_path_that_the_start_offset_left_out_is_named_and_may_come_later(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(playback, "PATH_PATIENCE", 0.0)
    with player() as each:
        each.play(1.0, 2.0)
        each.controller.on_diagnostics()
        each.wait_for("reference_path is missing", "--start-offset", "transient local")
        assert not each.commands
        each.paths.publish(ros.path_message(ROAD, START_NS))
        spin_until(each.executor_of_all, lambda: each.controller.supervisor.path is not None)
        each.play(2.0, 3.0)
        assert len(each.commands) >= 8
    assert capfd.readouterr().err.count("--start-offset") == 1


def test_a_loop_resets_the_controller_and_goes_on(capfd: pytest.CaptureFixture[str]) -> None:
    with player() as each:
        each.play(0.0, 2.0)
        first = len(each.commands)
        each.play(0.0, 2.0)
        assert len(each.commands) - first >= 15
        assert not each.controller.supervisor.stop_requested
    assert capfd.readouterr().err.count("time went backwards") == 1


def test_simulated_time_without_a_clock_names_the_option() -> None:
    with player(clock_hz=0.0) as each:
        each.controller.clock_check.limit = 0.0
        each.play(0.0, 0.5)
        each.controller.on_diagnostics()
        each.wait_for("/clock has no publisher", "--clock 1000")
        assert not each.commands
