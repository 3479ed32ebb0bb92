"""A small stand-in for another stack: a car that obeys its message, and a planner like its own.

`python -m tests.workshop.acceptance.stack_world nav2 --vehicle ordinary --output DIR` starts
`connect.py`, drives a lane change with the car of our simulator, and prints a JSON object: largest
error of the true centre of gravity [m], distance driven [m], largest speed [m/s]. Time stands
still while the machine has no time for the nodes. The world `own` has our own types and planner.
"""

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros, topics
from ampc_msgs_config.config import find
from ampc_msgs_config.paths.path import NOT_CAUGHT, advance, cross_track_error, point_at
from ampc_msgs_config.paths.path import Path as Curve
from ampc_msgs_config.paths.path_fitting import cached_path
from ampc_msgs_config.stack_file import load_stack
from ampc_msgs_config.types import NANOSECONDS, Array
from ampc_ros.nodes.message_packages import import_message
from launch_scripts import connect
from sim_vehicle.car import Car
from sim_vehicle.parameters import load_vehicle_file
from sim_vehicle.vehicle import CAR_V_X

STEP_NS = 20_000_000
"""Simulated time between two states of the car [ns]."""
PERIOD_NS = 100_000_000
"""Period of the controller [ns]."""
PATIENCE = 0.15
"""Longest wall time for which a state waits for the command that is due [s]."""
START_PATIENCE = 120.0
"""The same for the first command [s]."""
RUN_IN, LENGTH = 20.0, 130.0
"""Distance from which errors count, as the car starts from rest; end of the drive [m]."""
DRIVER_TIME = 0.5
"""Time constant of the simulated driver, which turns CARLA's pull into a target speed [s]."""


@dataclass
class Drive:
    """What the car of a stack receives."""

    steering: float = 0.0
    """Road-wheel angle [rad]."""
    speed: float = 0.0
    """Target speed [m/s]."""
    commands: int = 0


def lane_change(scale: float) -> Array:
    """Return points (n, 2) of a straight, a lane change of 3.5 m and a straight, scaled [m]."""
    x = np.arange(0.0, 160.0, 0.5)
    share = np.clip((x - 50.0) / 30.0, 0.0, 1.0)
    y = 3.5 * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return scale * np.column_stack((x, y))


def obey_twist(wheelbase: float, twist: Twist, drive: Drive) -> None:
    """Steer as a car does that receives speed and yaw rate."""
    drive.speed, rate = twist.linear.x, twist.angular.z
    if abs(drive.speed) > 0.01:
        drive.steering = math.atan(rate * wheelbase / drive.speed)


class World(Node):
    """The car, and the planner of the stack."""

    def __init__(self, stack: str, vehicle: str, speed: float, scale: float) -> None:
        """Place the car at the start of the lane change.

        Args:
            stack: Shipped stack, or `own`.
            vehicle: Vehicle of the car.
            speed: Speed of the planner [m/s].
            scale: Size of the lane change.
        """
        super().__init__("world")
        self.stack, self.speed = stack, speed
        self.vehicle = load_vehicle_file(find("vehicles", vehicle))
        self.points = lane_change(scale)
        self.path: Curve = cached_path(self.points)
        self.car = Car(self.vehicle, (0.5 * scale, 0.0, 0.0))
        self.names = dict(load_stack(stack).remappings) if stack != "own" else {}
        self.parameters = load_stack(stack).parameters if stack != "own" else {}
        self.drive, self.index, self.now_ns = Drive(), NOT_CAUGHT, NANOSECONDS
        self.errors: list[tuple[float, float, float]] = []
        """Arc length [m], cross-track error [m] and speed [m/s] of the centre of gravity."""
        self.steering_commands = 0
        self.compile()
        self.clock = self.create_publisher(Clock, "/clock", 10)
        self.odom = self.create_publisher(Odometry, self.topic(topics.ODOM), 10)
        self.create_subscription(JointState, topics.STEERING_COMMAND, self.on_steering, 10)
        self.plan, self.publish_feedback = self.connect_stack()

    def compile(self) -> None:
        """Compile everything before a clock runs."""
        Car(self.vehicle).advance(0.0, 0.0, np.zeros((1, 2)))
        ros.odometry_message(self.car.measure(0))
        self.points_ahead(0.0, 1.0, 0.5)
        self.index = NOT_CAUGHT

    def topic(self, name: str) -> str:
        """Return the name of a topic in the stack."""
        return self.names.get(name, name)

    def on_steering(self, _: JointState) -> None:
        """Count the commands of the controller, which pace the simulated time."""
        self.steering_commands += 1

    def connect_stack(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Subscribe to the command; return what publishes the plan, and the steering feedback."""
        return {
            "own": self.connect_own,
            "nav2": self.connect_nav2,
            "autoware": self.connect_autoware,
            "f1tenth": self.connect_f1tenth,
            "carla": self.connect_carla,
            "ros2_control": self.connect_ros2_control,
            "gazebo": self.connect_gazebo,
        }[self.stack]()

    def listen(self, package: str, name: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to the complete command of the gate."""
        kind = import_message(package, name, "the test")
        self.create_subscription(kind, self.topic(topics.DRIVE_COMMAND), callback, 1)

    def obey(self, steering: float, speed: float) -> None:
        """Use an angle [rad] and a speed [m/s]."""
        self.drive.steering, self.drive.speed = steering, speed
        self.drive.commands += 1

    def on_twist(self, twist: Twist) -> None:
        """Use speed and yaw rate."""
        obey_twist(self.vehicle.chassis.wheelbase, twist, self.drive)
        self.drive.commands += 1

    # The stacks ----------------------------------------------------------------------------------

    def connect_own(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Angle and speed of the gate; our planner has the path."""
        state = self.create_publisher(JointState, topics.STEERING_STATE, 10)

        def on_angle(message: JointState) -> None:
            self.obey(message.position[0], self.drive.speed)

        def on_speed(message: TwistStamped) -> None:
            self.drive.speed = message.twist.linear.x

        self.create_subscription(JointState, topics.GATE_STEERING, on_angle, 1)
        self.create_subscription(TwistStamped, topics.GATE_SPEED, on_speed, 1)
        return nothing, lambda: state.publish(ros.joint_message(self.now_ns, self.car.steering, 0))

    def connect_nav2(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Plan from the car to the goal, once a second, volatile; Twist."""
        plans = self.create_publisher(PathMessage, self.topic(topics.REFERENCE_PATH), 1)
        self.listen("geometry_msgs", "Twist", self.on_twist)

        def plan() -> None:
            if self.now_ns % NANOSECONDS == 0:
                plans.publish(self.path_message(self.points_ahead(0.0, math.inf, 0.05)))

        return plan, nothing

    def connect_autoware(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Trajectory from 5 m behind to 100 m ahead at 10 Hz; Control; SteeringReport."""
        kind = import_message("autoware_planning_msgs", "Trajectory", "the test")
        point_kind = import_message("autoware_planning_msgs", "TrajectoryPoint", "the test")
        report_kind = import_message("autoware_vehicle_msgs", "SteeringReport", "the test")
        plans = self.create_publisher(kind, self.topic(topics.TRAJECTORY), 1)
        reports = self.create_publisher(report_kind, self.topic(topics.STEERING_REPORT), 1)

        def on_control(message: Any) -> None:
            self.obey(message.lateral.steering_tire_angle, message.longitudinal.velocity)

        self.listen("autoware_control_msgs", "Control", on_control)

        def plan() -> None:
            if self.now_ns % PERIOD_NS:
                return
            message = kind()
            message.header.stamp, message.header.frame_id = self.stamp, "map"
            for x, y in self.points_ahead(-5.0, 100.0, 1.0):
                point = point_kind()
                point.pose.position.x, point.pose.position.y = x, y
                point.longitudinal_velocity_mps = self.speed
                message.points.append(point)
            plans.publish(message)

        def feedback() -> None:
            reports.publish(report_kind(stamp=self.stamp, steering_tire_angle=self.car.steering))

        return plan, feedback

    def connect_f1tenth(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """AckermannDriveStamped; the raceline is a file."""

        def on_drive(message: Any) -> None:
            self.obey(message.drive.steering_angle, message.drive.speed)

        self.listen("ackermann_msgs", "AckermannDriveStamped", on_drive)
        return nothing, nothing

    def connect_carla(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """Waypoints, latched; throttle, brake and steering share."""
        plans = self.create_publisher(PathMessage, self.topic(topics.REFERENCE_PATH), ros.LATCHED)
        sent: list[bool] = []

        def on_control(message: Any) -> None:
            steering = -message.steer * self.vehicle.steering.max_angle
            pull = 4.0 * message.throttle - 8.0 * message.brake - 0.02 * self.v
            self.obey(steering, max(self.v + DRIVER_TIME * pull, 0.0))

        self.listen("carla_msgs", "CarlaEgoVehicleControl", on_control)

        def plan() -> None:
            if not sent:
                sent.append(True)
                plans.publish(self.path_message(self.points[::4]))

        return plan, nothing

    def connect_ros2_control(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """TwistStamped; joint states of several joints; a path that is sent once."""
        return self.connect_joints("virtual_front_wheel_joint")

    def connect_gazebo(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """The same with both front wheels, whose angles differ."""
        return self.connect_joints("left_wheel_steering_joint", "right_wheel_steering_joint")

    def connect_joints(self, *names: str) -> tuple[Callable[[], None], Callable[[], None]]:
        """Connect a car whose steering joints have these names, left before right."""
        plans = self.create_publisher(PathMessage, self.topic(topics.REFERENCE_PATH), ros.LATCHED)
        joints = self.create_publisher(JointState, self.topic(topics.STEERING_REPORT), 10)
        self.listen("geometry_msgs", "TwistStamped", lambda message: self.on_twist(message.twist))
        sent: list[bool] = []

        def plan() -> None:
            if not sent:
                sent.append(True)
                plans.publish(self.path_message(self.points, "odom"))

        def feedback() -> None:
            length, track = self.vehicle.chassis.wheelbase, self.vehicle.body.track
            curvature = math.tan(self.car.steering) / length
            sides = (-track / 2, track / 2) if len(names) > 1 else (0.0,)
            angles = [math.atan(length * curvature / (1.0 + side * curvature)) for side in sides]
            message = JointState(name=["wheel", *names], position=[1.0, *angles])
            message.header.stamp = self.stamp
            joints.publish(message)

        return plan, feedback

    # The car -------------------------------------------------------------------------------------

    @property
    def v(self) -> float:
        """Longitudinal speed [m/s]."""
        return float(self.car.state[CAR_V_X])

    @property
    def stamp(self) -> Any:
        """Time of now."""
        return ros.time_message(self.now_ns)

    @property
    def place(self) -> float:
        """Arc length of the centre of gravity on the path [m]."""
        x, y, yaw = self.car.state[:3].tolist()
        s, self.index = advance(self.path, self.index, x, y, yaw)
        return float(s)

    def points_ahead(self, begin: float, end: float, spacing: float) -> list[tuple[float, float]]:
        """Return points of the path from the place of the car plus begin to plus end [m]."""
        last = self.path.spacing * (len(self.path.x) - 1)
        s = self.place
        at = np.arange(max(s + begin, 0.0), min(s + end, last), spacing)
        return [point_at(self.path, float(each))[:2] for each in at]

    def path_message(self, points: Any, frame: str = "map") -> PathMessage:
        """Return a path without orientations."""
        message = PathMessage()
        message.header.stamp, message.header.frame_id = self.stamp, frame
        for x, y in points:
            pose = PoseStamped()
            pose.header = message.header
            pose.pose.position.x, pose.pose.position.y = float(x), float(y)
            message.poses.append(pose)
        return message

    def publish_state(self) -> None:
        """Publish clock, odometry, feedback and plan."""
        self.clock.publish(Clock(clock=self.stamp))
        frame = "odom" if self.stack in ("ros2_control", "gazebo") else "map"
        message = ros.odometry_message(self.car.measure(self.now_ns), frame)
        offset = self.parameters.get("base_link_to_cg")
        if offset == 0.0:  # odometry of the centre of gravity
            state = self.car.state
            message.pose.pose.position.x, message.pose.pose.position.y = map(float, state[:2])
            message.twist.twist.linear.y = float(state[CAR_V_X + 1])
        message.child_frame_id = {"f1tenth": "ego_racecar/base_link", "carla": "ego_vehicle"}.get(
            self.stack, "base_link"
        )
        self.odom.publish(message)
        self.publish_feedback()
        self.plan()

    def step(self) -> None:
        """Move the car, and publish its state."""
        steps = STEP_NS // 5_000_000
        self.car.advance(self.drive.steering, self.drive.speed, np.zeros((steps, 2)))
        self.now_ns += STEP_NS
        s = self.place
        x, y = self.car.state[:2].tolist()
        self.errors.append((s, cross_track_error(point_at(self.path, s), x, y), self.v))
        self.publish_state()


def nothing() -> None:
    """Publish nothing."""


def run(world: World, length: float) -> None:
    """Drive until the car has come so far [m], or does not move any more.

    Raises:
        TimeoutError: No command arrives.
    """
    limit = time.monotonic() + START_PATIENCE
    while not world.drive.commands:  # time advances: nodes wait for its beginning
        world.now_ns += STEP_NS
        world.publish_state()
        until = time.monotonic() + STEP_NS / NANOSECONDS
        while time.monotonic() < until:
            rclpy.spin_once(world, timeout_sec=0.005)
        if time.monotonic() > limit:
            raise TimeoutError("no command arrives")
    first_ns, first, begin = world.now_ns, world.steering_commands, time.monotonic()
    stands = 0
    while world.place < length and stands < 500:
        world.step()
        stands = stands + 1 if world.v < 0.01 else 0
        due = (world.now_ns - first_ns) // PERIOD_NS - 2
        simulated = (world.now_ns - first_ns) / NANOSECONDS
        patience = time.monotonic() + PATIENCE
        while time.monotonic() < patience:
            ahead = begin + simulated - time.monotonic()
            if world.steering_commands - first >= due and ahead <= 0.0:
                break
            rclpy.spin_once(world, timeout_sec=min(max(ahead, 0.001), 0.01))
        else:
            first = world.steering_commands - due
        begin = max(begin, time.monotonic() - simulated)


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive one stack, and print the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stack")
    parser.add_argument("--vehicle", default="ordinary")
    parser.add_argument("--speed", type=float, default=9.0)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--overwrite", action="store_true", help="delete an earlier result")
    chosen = parser.parse_args(arguments)
    if chosen.overwrite and chosen.output.exists():
        shutil.rmtree(chosen.output)
    rclpy.init()
    world = World(chosen.stack, chosen.vehicle, chosen.speed, chosen.scale)
    road = chosen.output / "line.csv"
    chosen.output.mkdir(parents=True, exist_ok=True)
    lines = [f"{x:.6f},{y:.6f},{chosen.speed}" for x, y in world.points.tolist()]
    road.write_text("\n".join(["x_m,y_m,v_mps", *lines]) + "\n", encoding="utf-8")
    words = [sys.executable, connect.__file__]
    if chosen.stack == "own":
        own = chosen.output / "own.yaml"
        own.write_text("about: own types\nparameters: {follow: none}\nremappings: {}\n", "utf-8")
        words += [str(own), "-p", f"path={road}", "-p", "static_path=true"]
    else:
        words += [chosen.stack]
    if chosen.stack == "f1tenth":
        words += ["-p", f"path={road}", "-p", "static_path=true"]
    elif chosen.stack not in ("own", "autoware"):
        words += ["-p", f"speed={chosen.speed}", "-p", "lateral_acceleration=4.0"]
    words += ["--vehicle", chosen.vehicle, "-p", "use_sim_time=true", "-p", "command_timeout=5.0"]
    words += ["-p", "store_estimates=false", "--log", str(chosen.output / "log")]
    words += ["--output", str(chosen.output / "bag")]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, env=dict(os.environ)) as nodes:
        try:
            run(world, LENGTH * chosen.scale)
        finally:
            nodes.terminate()
            nodes.wait(60.0)
    s, error, v = np.array(world.errors).T
    counted = np.abs(error[s > RUN_IN * chosen.scale])
    result = {
        "stack": chosen.stack,
        "vehicle": chosen.vehicle,
        "largest_error": float(counted.max()),
        "rms": float(np.sqrt(np.mean(counted**2))),
        "distance": float(s.max()),
        "largest_speed": float(v.max()),
        "commands": world.drive.commands,
    }
    print(json.dumps(result))
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
