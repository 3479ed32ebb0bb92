"""A recorder that is killed while a car is played to it."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS, Diagnosis, VehicleState

RATE = 100
"""Of the car that is played [Hz]."""
PATIENCE = 30.0
"""Wall time for the recorder to start [s]."""


class Car:
    """Publishes what a control loop says, each message with its number as the stamp."""

    def __init__(self, node: Any) -> None:
        """Make the publishers."""
        self.clock = node.create_publisher(Clock, ros.CLOCK, ros.RELIABLE)
        self.odom = node.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.command = node.create_publisher(JointState, ros.STEERING_COMMAND, ros.RELIABLE)
        self.tick = node.create_publisher(JointState, ros.TICK, ros.RELIABLE)
        self.names = list(Diagnosis._fields)
        self.number = 0
        self.publish(with_clock=False)  # compiles

    def is_heard(self) -> bool:
        """Whether the recorder listens to everything."""
        publishers = self.clock, self.odom, self.command, self.tick
        return all(publisher.get_subscription_count() for publisher in publishers)

    def publish(self, *, with_clock: bool) -> None:
        """Send one message on each topic."""
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


@contextmanager
def car() -> Iterator[Car]:
    """Gives a car that publishes."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node: Any = rclpy.create_node("car", context=context)
    yield Car(node)
    node.destroy_node()
    context.try_shutdown()


@contextmanager
def recorder(bag: Path, simulated: bool) -> Iterator[subprocess.Popen[bytes]]:
    """Gives a recorder that records; it is killed in the end."""
    command = [sys.executable, "-m", "ampc_msgs_config.nodes.recorder_node", "--ros-args"]
    command += ["-p", f"output:={bag}", "-p", f"use_sim_time:={str(simulated).lower()}"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until((bag / "metadata.yaml").exists)
        yield process
    finally:
        process.kill()
        process.wait()


def wait_until(condition: Callable[[], bool]) -> None:
    """Waits until a condition holds.

    Raises:
        TimeoutError: It does not.
    """
    until = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > until:
            raise TimeoutError(f"waited in vain for {PATIENCE:.0f} s")
        time.sleep(0.01)


def drive(played: Car, duration: float, clock_starts: float) -> int:
    """Publishes in real time; gives the wall time of the last message [ns]."""
    start = due = time.monotonic()
    last_ns = time.time_ns()
    while time.monotonic() < start + duration:
        played.publish(with_clock=time.monotonic() > start + clock_starts)
        last_ns = time.time_ns()
        due += 1 / RATE
        time.sleep(max(0.0, min(due, start + duration) - time.monotonic()))
    return last_ns
