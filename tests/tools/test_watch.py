"""Watch: picture and lines of a running drive, over ROS and without."""

import math
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rich.console import Console
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ampc_msgs_config import ros
from ampc_msgs_config.types import VehicleState
from launch_scripts import watch
from launch_scripts.reporting.pages import duration_text, length_text
from launch_scripts.watching.live_drive import (
    LiveDrive,
    TopicState,
    line_of_drive,
    picture_of_drive,
    sparkline,
)
from tests.ros_nodes import add, ros_context
from tests.waiting import TIMEOUT

VALUES = {
    "cross_track_error": 0.00457,
    "heading_error": -0.01,
    "steering": 0.1,
    "rung": 0.0,
    "reason": 0.0,
    "solve_time": 4.2e-5,
    "speed": 8.996,
    "target_speed": 9.0,
}
DRIVE = LiveDrive("/", VALUES, "driving", False, [TopicState("/odom", 1, 50.0, 0.02)], {}, [])


def text_of(drive: LiveDrive) -> str:
    """Return the picture of a drive as text."""
    console = Console(width=120, record=True, file=open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
    console.print(picture_of_drive(drive))
    return console.export_text()


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.00457, "4.6 mm"), (-0.0456, "-45.6 mm"), (0.0996, "0.10 m"), (1.234, "1.2 m"),
     (-1e-9, "0.00 mm"), (250.0, "250 m"), (math.nan, "\u2013")],
)  # fmt: skip
def test_lengths_have_readable_digits_and_units(value: float, text: str) -> None:
    assert length_text(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(4.2e-5, "42.0 \u00b5s"), (0.0042, "4.2 ms"), (3.0, "3.0 s")]
)
def test_times_have_readable_digits_and_units(value: float, text: str) -> None:
    assert duration_text(value) == text


@pytest.mark.parametrize("show", [line_of_drive, text_of])
def test_every_quantity_is_shown(show: Any) -> None:
    shown = show(DRIVE)
    for part in ("+4.6 mm", "-0.57 deg", "+5.73 deg", "9.00 of 9.00 m/s", "optimal", "driving"):
        assert part in shown
    assert "42.0 \u00b5s" in shown
    assert "50 Hz" in shown


@pytest.mark.parametrize("show", [line_of_drive, text_of])
def test_fallback_stop_and_foreign_publishers_are_stated(show: Any) -> None:
    values = {**VALUES, "rung": 4.0, "reason": 7.0}
    shown = show(DRIVE._replace(values=values, stop=True, mismatches=["odom: none arrive"]))
    for part in ("stop (off path)", "STOP REQUESTED", "odom: none arrive"):
        assert part in shown


@pytest.mark.parametrize("show", [line_of_drive, text_of])
def test_before_a_drive_the_missing_topics_are_named(show: Any) -> None:
    topics = [TopicState("/car1/odom", 0, math.nan, math.nan),
              TopicState("/car1/controller/tick", 1, math.nan, math.nan)]  # fmt: skip
    shown = " ".join(show(DRIVE._replace(values={}, namespace="/car1", topics=topics)).split())
    assert "waiting for a drive in /car1: no publisher of /car1/odom" in shown
    assert "no message yet on /car1/controller/tick" in shown


def test_unknown_values_are_dashes_and_unknown_indices_numbers() -> None:
    shown = line_of_drive(DRIVE._replace(values={"speed": 1.0, "rung": 77.0}, gate="", stop=None))
    assert "cross-track error \u2013" in shown
    assert "fallback 77" in shown


def test_a_sparkline_spans_the_range_of_its_values() -> None:
    assert sparkline([0.0, 1.0, 0.5]) == "\u2581\u2588\u2585"
    assert sparkline([3.0, 3.0]) == "\u2581\u2581"
    assert sparkline([]) == ""


def test_a_wrong_namespace_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert watch.main(["--namespace", "car 1"]) == 2
    assert "'car 1' must consist of letters" in capsys.readouterr().err


class Drive(Node):
    """Publishes a drive in a namespace."""

    def __init__(self) -> None:
        """Create the publishers."""
        super().__init__("drive", namespace="car9")
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.target = self.create_publisher(TwistStamped, ros.TARGET_SPEED, ros.RELIABLE)
        self.tick = self.create_publisher(JointState, ros.TICK, ros.RELIABLE)
        self.gate = self.create_publisher(String, ros.GATE_STATE, ros.LATCHED)
        self.gate.publish(String(data="driving"))

    def publish(self) -> None:
        """Publish a state and its answers."""
        self.odom.publish(ros.odometry_message(VehicleState(1, 0.0, 0.0, 0.0, 7.5, 0.0, 0.0)))
        self.target.publish(ros.speed_message(ros.Stamped(1, 8.0)))
        names = ["cross_track_error", "steering", "rung", "reason"]
        self.tick.publish(JointState(name=names, position=[-0.0123, 0.1, 1.0, 1.0]))


def start_watch(**streams: Any) -> subprocess.Popen[Any]:
    """Start the command."""
    command = [sys.executable, watch.__file__, "--namespace", "car9"]
    return subprocess.Popen(
        command, env={**os.environ, "TERM": "xterm", "COLUMNS": "120"}, **streams
    )


def output(descriptor: int) -> Iterator[str]:
    """Return all text so far, each time that a pipe or terminal has more."""
    text, limit = "", time.monotonic() + TIMEOUT
    os.set_blocking(descriptor, False)
    while time.monotonic() < limit:
        try:
            text += os.read(descriptor, 65536).decode(errors="replace")
        except BlockingIOError:
            time.sleep(0.05)
        yield re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text)
    raise AssertionError(f"not shown within {TIMEOUT:g} s: {text}")


@pytest.mark.parametrize("is_terminal", [False, True])
def test_a_drive_over_ros_is_shown_and_ctrl_c_ends_it(is_terminal: bool) -> None:
    ours, theirs = pty.openpty() if is_terminal else os.pipe()
    process = start_watch(stdout=theirs, stderr=theirs, stdin=subprocess.DEVNULL)
    os.close(theirs)
    try:
        shown = output(ours)
        assert any("waiting for a drive in /car9: no publisher" in text for text in shown)
        with ros_context() as executor:
            drive = Drive()
            add(executor, drive)
            for text in shown:
                drive.publish()
                if "driving" in text and "-12.3 mm" in text and "7.50 of 8.00 m/s" in text:
                    break
            assert "slack (slack in use)" in text
            process.send_signal(signal.SIGINT)
            assert process.wait(TIMEOUT) == 0
        assert "Traceback" not in text
    finally:
        process.kill()
        process.wait()
        os.close(ours)
