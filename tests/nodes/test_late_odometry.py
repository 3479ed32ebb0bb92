"""Odometry that is late or missing, from a car that belongs to the tests, over a real ROS graph."""

import math
from collections import deque
from collections.abc import Iterator

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor

from ampc_msgs_config import ros
from ampc_msgs_config.config import find
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.nodes.controller_node import ControllerNode
from sim_vehicle.parameters import load_vehicle_file
from tests.nodes.test_foreign_publishers import PERIOD, SPEED, Foreign
from tests.ros_nodes import ros_context

pytestmark = pytest.mark.usefixtures("own_domain")

RADIUS = 25.0
"""Of the circle that the car drives [m]."""
CHASSIS = load_vehicle_file(find("vehicles", "paper")).chassis
STEP = 0.001
"""Step of the integration [s]."""


class Bicycle(Foreign):
    """A single-track car with linear tyres whose odometry may be late or silent."""

    late = 0.0
    """Time from the stamp of a state to its message [s]."""
    is_silent = False
    v_y = yaw_rate = 0.0
    """Of the centre of gravity, which is at x and y [m/s, rad/s]."""

    def on_drive(self) -> None:
        """Move the car by the time that has passed, and publish what is due."""
        for _ in range(round(self.pass_time() / STEP)):
            self.integrate()
        self.track.append((self.x, self.y))
        centre = (self.x, self.y, self.yaw, SPEED, self.v_y, self.yaw_rate)
        state = at_distance(VehicleState(self.now_ns, *centre), -CHASSIS.cg_to_rear_axle)
        self.queue.append(state)
        while self.queue and self.now_ns - self.queue[0].stamp_ns >= self.late * NANOSECONDS:
            state = self.queue.popleft()
            if not self.is_silent:
                self.odom.publish(ros.odometry_message(state, self.frame))

    def integrate(self) -> None:
        """Integrate Eqs. (1) to (3) with linear tyres over a step."""
        l_f, l_r = CHASSIS.cg_to_front_axle, CHASSIS.cg_to_rear_axle
        front = self.steering - (self.v_y + l_f * self.yaw_rate) / SPEED
        rear = (l_r * self.yaw_rate - self.v_y) / SPEED
        F_f = 2 * CHASSIS.front_cornering_stiffness * front
        F_r = 2 * CHASSIS.rear_cornering_stiffness * rear
        self.v_y += STEP * ((F_f + F_r) / CHASSIS.mass - SPEED * self.yaw_rate)
        self.yaw_rate += STEP * (l_f * F_f - l_r * F_r) / CHASSIS.yaw_inertia
        self.x += STEP * (SPEED * math.cos(self.yaw) - self.v_y * math.sin(self.yaw))
        self.y += STEP * (SPEED * math.sin(self.yaw) + self.v_y * math.cos(self.yaw))
        self.yaw += STEP * self.yaw_rate

    def begin(self) -> None:
        """Begin to drive, for the rest of the test."""
        self.queue: deque[VehicleState] = deque()
        self.create_timer(PERIOD, self.on_drive, clock=self.wall)

    def drive_on(self, commands: int) -> None:
        """Drive until so many further commands have arrived."""
        known = self.commands
        self.spin_until(lambda: self.commands >= known + commands)

    def largest_error(self) -> float:
        """Return the largest distance from the circle [m]."""
        return max(abs(math.hypot(x, y - RADIUS) - RADIUS) for x, y in self.track)

    @property
    def age(self) -> float:
        """Age of the newest state [s]."""
        state = self.controller.supervisor.state
        assert state
        return state.ages(self.now_ns).age


@pytest.fixture
def world() -> Iterator[Bicycle]:
    """A car and a controller that has its path."""
    arguments = {"gain_table": "preview_paper", "static_path": "true", "guard": "track"}
    with ros_context(**arguments, use_sim_time="true") as executor:
        yield on_a_circle(executor)


def on_a_circle(executor: SingleThreadedExecutor) -> Bicycle:
    """Return a car at the start of a circle."""
    car = Bicycle(executor, ControllerNode(), ros.LATCHED)
    angles = np.linspace(0.0, math.tau, 158)
    circle = RADIUS * np.column_stack((np.sin(angles), 1.0 - np.cos(angles)))
    circle[-1] = circle[0]
    car.publish_path(circle)
    car.spin_until(lambda: car.controller.supervisor.path is not None)
    return car


def test_odometry_that_is_100_ms_late_is_followed(world: Bicycle) -> None:
    world.late = 0.1
    world.begin()
    world.drive_on(80)
    supervisor = world.controller.supervisor
    assert world.age > 0.09
    assert world.largest_error() < 0.5
    assert not supervisor.stop_requested


def test_a_bend_is_driven_for_one_and_a_half_seconds_without_odometry(world: Bicycle) -> None:
    said: list[str] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        said.extend(status.message for status in message.status)

    world.create_subscription(DiagnosticArray, ros.DIAGNOSTICS, on_diagnostics, 100)
    world.begin()
    world.drive_on(40)
    before, world.is_silent = world.commands, True
    world.spin_until(lambda: any("reason: state_late" in each for each in said))
    world.spin_until(lambda: world.age > 0.6)
    assert "s old: a stop is requested" in world.report()
    assert world.controller.supervisor.stop_requested
    world.spin_until(lambda: world.age > 1.5)
    assert world.commands - before > 10
    world.is_silent = False
    world.spin_until(lambda: world.age < 0.2)
    world.drive_on(10)
    assert world.largest_error() < 0.8
    assert "a stop is requested; the service ~/reset_stop takes it back" in world.report()
