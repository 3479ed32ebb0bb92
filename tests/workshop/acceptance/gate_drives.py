"""One stop of the gate: the controller fails at a moment of a drive, and the gate stops the car."""

import copy
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.parameters import GuardLimits
from ampc_msgs_config.paths.path import Progress, errors_at
from ampc_msgs_config.scenarios.scenario import (
    MIN_PREVIEW,
    SPEED_PREVIEW,
    load_scenario,
    speed_at,
)
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.configuration import Choices, configuration
from ampc_ros.gate.core import Gate
from ampc_ros.gate.following import MeasuredPose
from ampc_ros.gate.settings import STOPS, GateSettings
from ampc_ros.supervision.guard import bounds
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.car import Car
from sim_vehicle.parameters import load_vehicle_file
from tests.workshop.acceptance.real_drives import LONGITUDINAL, SLOW, SUDDEN, speed_profile
from tests.workshop.acceptance.real_roads import Road, road, road_through
from tests.workshop.fault_matrix.fault_loop import received_plan

STEP, CALM = 0.02, np.zeros((4, 2))
"""Period of gate and odometry [s], and the wind of one."""
LONGEST_STOP = 20.0
"""Time after which a car must stand [s]."""
STANDS = 0.05
"""Speed below which a car stands [m/s]."""
LENGTH = 900.0
"""Longest drive [m]."""
SPEEDS = {10: ("table3", "preview_{car}"), 50: ("50hz", "preview_50hz")}
"""Settings and gains by the rate of the controller [Hz]."""
FAULTS = (
    "silence",
    "silence without odometry",
    "not finite",
    "jump",
    "second publisher",
    "held angle",
)
"""What fails; the last one is a car whose steering holds the last angle instead of the gate."""


class StopCase(NamedTuple):
    """Drives whose controller fails."""

    car: str
    road: str
    speed: float
    """Largest speed; bends lower it [m/s]."""
    rate: int
    """Rate of the controller [Hz]."""

    def __str__(self) -> str:
        """Return the name in tables."""
        return f"{self.road}, {self.car} car, {self.speed:g} m/s, {self.rate} Hz"


class Stop(NamedTuple):
    """What happened after a fault."""

    speed: float
    """Speed at the fault [m/s]."""
    error: float
    """Largest distance of the centre of gravity from the path until standstill [m]."""
    reaction: float
    """Time from the last sound command to the stop [s]."""
    step: float
    """Largest change of the angle, relative to what the guard allows in that time."""
    stands: bool


def true_road(name: str, car: str) -> Road:
    """Return a road with its exact geometry."""
    if name == "20 m circle":
        angles: Array = np.arange(125, dtype=np.float64) * (math.tau / 125)
        points: Array = 20.0 * np.column_stack((np.sin(angles), 1.0 - np.cos(angles)))
        return road_through(points, closed=True)
    if name in ("sc1", "sc2"):
        size = load_vehicle_file(find("vehicles", car)).size
        return road_through(np.asarray(load_scenario(name, size).points)[::2])
    return road(name)


class GatedDrive:
    """A car, its controller, its planner and the gate between them; copied at each fault."""

    def __init__(self, case: StopCase) -> None:
        """Start at the beginning of the road."""
        self.case, self.road = case, true_road(case.road, case.car)
        settings, gains = SPEEDS[case.rate]
        choices = Choices("preview", case.car, static_path=True, settings=settings)
        choices = choices._replace(gain_table=gains.format(car=case.car))
        self.config = configuration(choices)
        self.supervisor = Supervisor(self.config)
        self.profile = speed_profile(self.road, case.speed)
        path = self.road.path
        self.start = float(self.profile.speed[0]) if abs(path.curvature[0]) < SUDDEN else SLOW
        vehicle = load_vehicle_file(find("vehicles", case.car))
        self.car, self.progress = Car(vehicle, self.road.start, self.start), Progress(path)
        self.gate = Gate(
            load(GuardLimits, find("guards", "road")),
            vehicle.chassis,
            GateSettings(self.supervisor.period),
        )
        s: Array = np.arange(0.0, path.length, 1.0, dtype=np.float64)
        points = self.road.curve(s)
        points = np.concatenate((points, points[:1])) if path.closed else points
        self.supervisor.take_path(points, NANOSECONDS, NANOSECONDS)
        self.round, self.s, self.error = 0, 0.0, 0.0
        self.angle = self.target = 0.0

    @property
    def now(self) -> float:
        """Time since the start [s]."""
        return self.round * STEP

    def measure(self) -> VehicleState:
        """Return the state of the car, and locate it on the true road."""
        state = as_received(self.car.measure(NANOSECONDS + round(self.now * NANOSECONDS)))
        centre = at_distance(state, self.config.base_link_to_cg)
        self.s = self.progress.advance(centre.x, centre.y, centre.yaw)
        self.error = errors_at(self.road.path, self.s, centre.x, centre.y, centre.yaw)[0]
        return state

    def take(self, state: VehicleState) -> None:
        """Let the gate hear odometry and target speed."""
        pose = MeasuredPose(state.x, state.y, state.yaw, state.v_x, state.v_y)
        self.gate.take_odometry(pose, self.now)

    def plan_speed(self) -> None:
        """Let the planner publish the target speed."""
        ahead = max(SPEED_PREVIEW * speed_at(self.profile, self.s), MIN_PREVIEW)
        most = self.start + LONGITUDINAL * self.now if self.start == SLOW else math.inf
        self.target = min(speed_at(self.profile, self.s + ahead), most)
        self.gate.take_speed(self.target, self.now)

    def tick(self, state: VehicleState) -> None:
        """Let the controller answer a state."""
        now_ns = state.stamp_ns
        self.supervisor.take_state(state, now_ns)
        record, plan = self.supervisor.tick(now_ns), self.supervisor.stopping_plan(now_ns)
        assert record
        assert plan
        self.gate.take_plan(received_plan(plan), self.now)
        problem = self.gate.take_command(
            record.command.steering, record.command.steering_rate, self.now
        )
        assert not problem, problem

    def move(self, angle: float, speed: float) -> None:
        """Let the car drive on until the next round."""
        self.angle = angle
        self.car.advance(angle, speed, CALM)
        self.round += 1

    def moments(self, every: int) -> Iterator["GatedDrive"]:
        """Drive the road; yield a copy just after every so many ticks."""
        period, ticks = round(self.supervisor.period / STEP), 0
        end = min(LENGTH, self.road.path.length - (0.0 if self.road.path.closed else 120.0))
        while True:
            state = self.measure()
            if self.s > end or self.now > 300.0:
                return
            self.take(state)
            self.plan_speed()
            is_tick = self.round % max(period, 1) == 0
            if is_tick:
                self.tick(state)
                ticks += 1
            output = self.gate.step(self.now)
            assert output
            if is_tick and ticks > 10 and ticks % every == 0:
                supervisor, self.supervisor = self.supervisor, None  # type: ignore[assignment]
                fork = copy.deepcopy(self)
                self.supervisor = supervisor
                yield fork
            self.move(output.angle, output.speed)


def stop(drive: GatedDrive, fault: str) -> Stop:
    """Drive on from a moment with a fault until the car stands."""
    gate, case = drive.gate, drive.case
    period = 1.0 / case.rate
    begin, state = drive.now, drive.measure()
    error, reaction, largest, stands = abs(drive.error), math.inf, 0.0, False
    speed, held = state.v_x, drive.angle
    last, commanded_at = gate.guard.steering, begin
    wrong = math.nan if fault == "not finite" else last + 0.3
    chassis, limits = gate.guard.chassis, gate.guard.limits
    next_command = begin + period
    while drive.now < begin + LONGEST_STOP:
        if fault != "silence without odometry":
            drive.take(state)
        drive.plan_speed()
        if fault in ("not finite", "jump", "second publisher") and drive.now >= next_command - 1e-9:
            gate.take_command(wrong, 0.0, drive.now)
            next_command += period
        gate.intruders = "two publishers" if fault == "second publisher" else ""
        output = gate.step(drive.now)
        assert output
        if gate.state in STOPS and reaction == math.inf:
            reaction = drive.now - begin
        bound = bounds(limits, chassis, gate.speed_at(drive.now))
        allowed = min(bound.rate, bound.jerk) * max(drive.now - commanded_at, STEP)
        largest = max(largest, abs(output.angle - last) / allowed)
        last, commanded_at = output.angle, drive.now
        drive.move(held if fault == "held angle" else output.angle, output.speed)
        state = drive.measure()
        error = max(error, abs(drive.error))
        if state.v_x < STANDS:
            stands = True
            break
    return Stop(speed, error, reaction, largest, stands)


def stops(case: StopCase, every: int) -> dict[str, list[Stop]]:
    """Return the stops of all faults at every so many ticks of a drive."""
    found: dict[str, list[Stop]] = {fault: [] for fault in FAULTS}
    for i, moment in enumerate(GatedDrive(case).moments(every)):
        for j, fault in enumerate(FAULTS):
            # Silence at every moment, the others in turn
            if j in (0, 1, 5) or (i + j) % 3 == 0:
                found[fault].append(stop(copy.deepcopy(moment), fault))
    return found
