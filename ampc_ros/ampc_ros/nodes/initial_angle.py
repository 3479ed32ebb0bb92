"""The angle from which a controller starts to steer, in real time.

The wheel of a car has an angle when a controller is started in a bend, or activated after a driver
has steered. The first of these is used: the measured angle, if it is fresh; the last command of
another controller, heard while this one did not steer; the own last command. Without any of them
the start waits for START_WAIT, and then begins at zero.
"""

import math
import time
from typing import NamedTuple

from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.parameters import SteeringParameters

START_WAIT = 0.5
"""Longest wall time for which a start waits for a measured angle or a command [s]."""
FRESH = 0.5
"""Wall time for which a measured angle is used for a start [s]."""


class Start(NamedTuple):
    """Angle of a start, and its origin."""

    angle: float
    """Road-wheel angle [rad]; nan: that in force."""
    origin: str


class InitialAngle:
    """Listens while the controller does not steer, and chooses the angle of its start."""

    def __init__(self, node: Node) -> None:
        """Create without an angle.

        Args:
            node: Owner of the subscription.
        """
        self.node, self.steering = node, ros.ROAD_WHEEL
        self.is_pending = False
        """Whether a start waits for its angle."""
        self.measured = self.heard = self.own = math.nan
        self.measured_at = -math.inf
        self.since: float | None = None
        self.subscription: Subscription | None = None

    def listen(self, steering: SteeringParameters) -> None:
        """Listen to the commands of other controllers; those of before are forgotten.

        Args:
            steering: Ratio and offset of the topic.
        """
        self.close()
        self.steering, self.heard = steering, math.nan
        self.subscription = self.node.create_subscription(
            JointState, ros.STEERING_COMMAND, self.on_command, ros.NEWEST
        )

    def close(self) -> None:
        """End the subscription; its messages cost time while the controller steers."""
        if self.subscription:
            self.node.destroy_subscription(self.subscription)
        self.subscription = None

    def on_command(self, message: JointState) -> None:
        """Store a command; an invalid one is no angle to start from."""
        try:
            self.heard = ros.steering_angle(message, self.steering).value
        except ValueError:
            return

    def on_measured(self, angle: float) -> None:
        """Store a measured road-wheel angle [rad]."""
        self.measured, self.measured_at = angle, time.monotonic()

    def begin(self, own: float) -> None:
        """Begin a start.

        Args:
            own: Angle commanded last by this controller; nan: there was no command [rad].
        """
        self.own, self.since, self.is_pending = own, None, True

    def choose(self) -> Start | None:
        """Return the angle of the start; None: wait for it. The wait begins with the first call."""
        now = time.monotonic()
        self.since = now if self.since is None else self.since
        measured = self.measured if now - self.measured_at <= FRESH else math.nan
        start = None
        for angle, origin in (
            (measured, f"measured on {ros.STEERING_STATE}"),
            (self.heard, f"of the last {ros.STEERING_COMMAND}"),
            (self.own, "of its own last command"),
        ):
            if start is None and not math.isnan(angle):
                start = Start(angle, f"steering starts from the angle {origin}: {angle:.3f} rad")
        if start is None and now - self.since >= START_WAIT:
            missing = f"no {ros.STEERING_STATE} and no {ros.STEERING_COMMAND}"
            start = Start(math.nan, f"{missing} within {START_WAIT:g} s: steering starts from zero")
        if start:
            self.is_pending = False
            self.close()
        return start
