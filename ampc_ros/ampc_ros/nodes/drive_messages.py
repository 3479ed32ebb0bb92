"""The complete command of the gate in the message types of several stacks.

The parameter `output` of the gate selects the type of `drive_command`. Angles are road-wheel angles
of the single-track model, positive to the left; only CARLA's is a share, positive to the right.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time

from ampc_msgs_config import topics
from ampc_ros.nodes.message_packages import import_message

SPEED_TIME = 0.5
"""Time constant with which a commanded acceleration approaches the commanded speed [s]."""
LARGEST_ACCELERATION = 3.0
"""Largest commanded acceleration [m/s^2]."""
HOLD_DECELERATION = 1.0
"""Deceleration that is commanded while the car stands and is to stand [m/s^2]."""
STANDING = 0.1
"""Commanded speed below which the car is to stand [m/s]."""
PEDAL_GAIN, PEDAL_TIME = 0.25, 2.0
"""CARLA's pedals: share for each m/s of speed error, and time of the integral [s]."""
PEDAL_STEP = 0.1
"""Longest time that one command adds to the integral [s]."""


class DriveCommand(NamedTuple):
    """What the car is to do, and what it does."""

    stamp: Time
    angle: float
    """Road-wheel angle [rad]."""
    rate: float
    """Its rate [rad/s]."""
    speed: float
    """Commanded speed [m/s]."""
    yaw_rate: float
    """Speed times tan(angle) / wheelbase [rad/s]."""
    measured_speed: float
    """Speed of the car [m/s]."""
    deceleration: float
    """Largest deceleration to reach the speed [m/s^2]."""
    max_angle: float
    """Largest road-wheel angle of the car [rad]."""
    now: float
    """Steady time [s]."""

    @property
    def acceleration(self) -> float:
        """Acceleration that approaches the commanded speed; it holds a car that stands [m/s^2]."""
        if self.speed < STANDING and abs(self.measured_speed) < STANDING:
            return -HOLD_DECELERATION
        wanted = (self.speed - self.measured_speed) / SPEED_TIME
        return min(max(wanted, -self.deceleration), LARGEST_ACCELERATION)


def fill_twist(message: Any, command: DriveCommand) -> None:
    """Fill a geometry_msgs/Twist: speed and yaw rate."""
    message.linear.x, message.angular.z = command.speed, command.yaw_rate


def fill_twist_stamped(message: Any, command: DriveCommand) -> None:
    """Fill a geometry_msgs/TwistStamped: speed and yaw rate of the kinematic model."""
    message.header.stamp, message.header.frame_id = command.stamp, topics.BASE_LINK
    fill_twist(message.twist, command)


def fill_ackermann(message: Any, command: DriveCommand) -> None:
    """Fill an ackermann_msgs/AckermannDrive; its other fields, 0, mean: as fast as possible."""
    message.steering_angle, message.speed = command.angle, command.speed


def fill_ackermann_stamped(message: Any, command: DriveCommand) -> None:
    """Fill an ackermann_msgs/AckermannDriveStamped."""
    message.header.stamp, message.header.frame_id = command.stamp, topics.BASE_LINK
    fill_ackermann(message.drive, command)


def fill_autoware(message: Any, command: DriveCommand) -> None:
    """Fill an autoware_control_msgs/Control."""
    lateral, longitudinal = message.lateral, message.longitudinal
    for part in (message, lateral, longitudinal):
        part.stamp = part.control_time = command.stamp
    lateral.steering_tire_angle = command.angle
    lateral.steering_tire_rotation_rate = command.rate
    lateral.is_defined_steering_tire_rotation_rate = True
    longitudinal.velocity, longitudinal.acceleration = command.speed, command.acceleration
    longitudinal.is_defined_acceleration = True


class Pedals:
    """Throttle and brake for a speed: proportional and integral part, without wind-up."""

    def __init__(self) -> None:
        """Start with released pedals."""
        self.integral = 0.0
        self.at = math.inf

    def fill(self, message: Any, command: DriveCommand) -> None:
        """Fill a carla_msgs/CarlaEgoVehicleControl."""
        message.header.stamp, message.header.frame_id = command.stamp, topics.BASE_LINK
        share = -command.angle / command.max_angle if command.max_angle > 0.0 else 0.0
        message.steer = min(max(share, -1.0), 1.0)
        pedal = self.step(command)
        message.throttle, message.brake = max(pedal, 0.0), max(-pedal, 0.0)

    def step(self, command: DriveCommand) -> float:
        """Return the throttle, negative: the brake, as a share in [-1, 1]."""
        elapsed = min(max(command.now - self.at, 0.0), PEDAL_STEP)
        self.at = command.now
        if command.speed < STANDING:
            self.integral = 0.0
            if abs(command.measured_speed) < 10 * STANDING:
                return -1.0
        error = command.speed - command.measured_speed
        grown = self.integral + PEDAL_GAIN / PEDAL_TIME * error * elapsed
        pedal = PEDAL_GAIN * error + grown
        if -1.0 < pedal < 1.0:
            self.integral = grown
        return min(max(PEDAL_GAIN * error + self.integral, -1.0), 1.0)


class DriveMessage(NamedTuple):
    """Type of `drive_command`."""

    package: str
    name: str
    make_fill: Callable[[], Callable[[Any, DriveCommand], None]]
    """Returns the function that fills a message of one gate."""


OUTPUTS = {
    "twist": DriveMessage("geometry_msgs", "Twist", lambda: fill_twist),
    "twist_stamped": DriveMessage("geometry_msgs", "TwistStamped", lambda: fill_twist_stamped),
    "ackermann": DriveMessage("ackermann_msgs", "AckermannDrive", lambda: fill_ackermann),
    "ackermann_stamped": DriveMessage(
        "ackermann_msgs", "AckermannDriveStamped", lambda: fill_ackermann_stamped
    ),
    "autoware": DriveMessage("autoware_control_msgs", "Control", lambda: fill_autoware),
    "carla": DriveMessage("carla_msgs", "CarlaEgoVehicleControl", lambda: Pedals().fill),
}
"""Values of the parameter `output`."""
OUTPUT = "twist_stamped"
"""Default of the parameter."""


def load_output(name: str) -> tuple[Any, Callable[[Any, DriveCommand], None]]:
    """Return message class and function that fills a message of an output.

    Raises:
        ValueError: The package of the message is missing.
    """
    chosen = OUTPUTS[name]
    kind = import_message(chosen.package, chosen.name, f"output = {name}")
    return kind, chosen.make_fill()
