"""Node `car`: CommonRoad vehicle 2 in wall time, in the place of a real car.

It has a delay and a lag that no file states, publishes odometry at 50 Hz with the noise `x1`, and
its measured road-wheel angle. It waits for a command, follows `target_speed`, and ends when it
stands after the drive.
"""

import math
import sys

import numpy as np
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from ampc_msgs_config import ros, topics
from ampc_msgs_config.nodes.base_node import BaseNode, declare, spin
from ampc_msgs_config.nodes.scenario_parameters import declare_scenario
from sim_vehicle.measurement import noisy
from tests.workshop.acceptance.adapted_drives import Change, ChangedCar
from tests.workshop.acceptance.state_drives import deviations

DELAY, LAG, OFFSET_DEG = 0.1, 0.05, 0.5
"""Delay and lag of its steering [s], and offset [deg]: what the user does not know."""
STEP_NS = 20_000_000
"""Period of the states [ns]."""
STANDS = 0.1
"""Speed below which the drive is over [m/s]."""
BRAKING = 2.0
"""Deceleration on a stop request [m/s^2]."""


class CarNode(BaseNode):
    """The car and its drivers for steering and speed."""

    def __init__(self) -> None:
        """Place the car at the start of a scenario or path, with its speed there."""
        super().__init__("car")
        change = Change(delay=DELAY, offset_deg=OFFSET_DEG)
        self.car = ChangedCar(declare_scenario(self), change, LAG)
        self.car.advance(0.0, 0.0, STEP_NS)  # compiles it
        self.car = ChangedCar(self.car.scenario, change, LAG)
        self.rng = np.random.default_rng(declare(self, "seed", 1, "seed of the noise", (0, 10**6)))
        self.angle, self.target, self.limit = math.nan, math.nan, math.inf
        self.has_driven = self.stops = False
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.steering = self.create_publisher(JointState, ros.STEERING_STATE, ros.RELIABLE)
        self.create_subscription(JointState, ros.STEERING_COMMAND, self.on_steering, ros.COMMAND)
        self.create_subscription(TwistStamped, ros.TARGET_SPEED, self.on_speed, ros.COMMAND)
        self.create_subscription(Bool, topics.STOP_REQUEST, self.on_stop, ros.LATCHED)
        self.wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(STEP_NS / 1e9, self.on_timer, clock=self.wall)

    def on_steering(self, message: JointState) -> None:
        """Use a command."""
        self.angle = ros.steering_angle(message, ros.ROAD_WHEEL).value

    def on_speed(self, message: TwistStamped) -> None:
        """Use a target speed."""
        self.target = ros.target_speed(message).value

    def on_stop(self, message: Bool) -> None:
        """Obey a stop request."""
        self.stops = message.data

    def on_timer(self) -> None:
        """Publish the state, and move the car once it is commanded."""
        state = self.car.measure(self.now_ns)
        normal = self.rng.standard_normal(6)
        self.odom.publish(ros.odometry_message(noisy(state, deviations(), normal)))
        wheel = float(self.car.state[2]) - self.car.offset
        self.steering.publish(ros.joint_message(state.stamp_ns, wheel, 0.0, ros.ROAD_WHEEL))
        if math.isnan(self.angle) or math.isnan(self.target):
            return
        speed = float(self.car.state[3])
        self.limit = min(self.limit, speed) - BRAKING * STEP_NS / 1e9 if self.stops else math.inf
        self.car.advance(self.angle, max(min(self.target, self.limit), 0.0), STEP_NS)
        self.has_driven |= speed > 1.0
        if self.has_driven and speed < STANDS:
            raise SystemExit(0)


if __name__ == "__main__":
    sys.exit(spin(CarNode))
