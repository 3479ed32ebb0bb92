"""A recorder process that is killed, and a car that publishes to it."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS, Diagnosis, VehicleState
from tests.waiting import wait_for

RATE = 100
"""Messages of each topic per second [Hz]."""


class Car:
    """Publishes the topics of a control loop, each message with its number as the stamp."""

    def __init__(self, node: Any) -> None:
        """Create the publishers."""
        self.clock = node.create_publisher(Clock, ros.CLOCK, ros.RELIABLE)
        self.odom = node.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.command = node.create_publisher(JointState, ros.STEERING_COMMAND, ros.RELIABLE)
        self.tick = node.create_publisher(JointState, ros.TICK, ros.RELIABLE)
        self.names = list(Diagnosis._fields)
        self.number = 0
        self.publish(with_clock=False)  # compiles

    def is_matched(self) -> bool:
        """Check whether the recorder subscribes to everything."""
        publishers = self.clock, self.odom, self.command, self.tick
        return all(publisher.get_subscription_count() for publisher in publishers)

    def publish(self, *, with_clock: bool) -> None:
        """Publish one message on each topic."""
        self.number += 1
        stamp_ns = self.number * NANOSECONDS // RATE
        if with_clock:
            self.clock.publish(Clock(clock=ros.time_message(stamp_ns)))
        state = VehicleState(stamp_ns, 0.1 * self.number, 0.0, 0.0, 10.0, 0.0, 0.0)
        self.odom.publish(ros.odometry_message(state))
        self.command.publish(ros.joint_message(stamp_ns, 0.1, 0.0))
        tick = ros.joint_message(stamp_ns, 0.0, 0.0)
        tick.name, tick.position, tick.velocity = self.names, [0.1] * len(self.names), []
        self.tick.publish(tick)

    def publish_for(self, duration: float, clock_starts: float) -> int:
        """Publish in real time; return the wall time of the last message [ns]."""
        start = due = time.monotonic()
        last_ns = time.time_ns()
        while time.monotonic() < start + duration:
            self.publish(with_clock=time.monotonic() > start + clock_starts)
            last_ns = time.time_ns()
            due += 1 / RATE
            time.sleep(max(0.0, min(due, start + duration) - time.monotonic()))
        return last_ns


@contextmanager
def running_car() -> Iterator[Car]:
    """Create a car in a ROS context of its own."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node: Any = rclpy.create_node("car", context=context)
    yield Car(node)
    node.destroy_node()
    context.try_shutdown()


@contextmanager
def running_recorder(bag: Path, simulated: bool) -> Iterator[subprocess.Popen[bytes]]:
    """Start a recorder, wait until it records, and kill it at the end."""
    command = [sys.executable, "-m", "ampc_msgs_config.nodes.recorder_node", "--ros-args"]
    command += ["-p", f"output:={bag}", "-p", f"use_sim_time:={str(simulated).lower()}"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_for((bag / "metadata.yaml").exists)
        yield process
    finally:
        process.kill()
        process.wait()
