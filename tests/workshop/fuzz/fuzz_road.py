"""Random inputs of a car on a road, mostly plausible, so that the controller really drives.

The car follows its steering along roads that start at its position and are sent repeatedly. They
are mixed with impossible states, paths, angles and times.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ampc_msgs_config.types import NANOSECONDS, VehicleState
from tests.workshop.fuzz.fuzz_guard import Inputs

JUMPS = 0.003
"""Share of the inputs at which the clock jumps."""
CALM = 2.0
"""Duration of plausible inputs after which the controller must use its optimal plan [s]."""
SPEEDS = (0.0, -0.0, 5e-324, 1e-300, 1e-9, 0.049, 0.1, -0.01, -1.0, -50.0, 60.0, 99.9, 100.0)
PLACES = (0.0, 5e-324, 1e4, -1e6, 9.99e7, 1e8)
STAMPS = (0, -1, -(2**31) * NANOSECONDS, 2**31 * NANOSECONDS + 2**32 - 1 - NANOSECONDS)
"""Extreme stamps that a message can carry [ns]."""


class Road(Inputs):
    """Inputs of a car that follows its steering."""

    def __init__(self, seed: Sequence[int]) -> None:
        """Start a drive."""
        super().__init__(seed, JUMPS)
        self.points: list[tuple[float, float]] = []

    def steer(self, angle: float, wheelbase: float) -> None:
        """Set the yaw rate from a steering angle [rad] and the wheelbase [m]."""
        turn = self.state.v_x * angle / wheelbase
        self.state = self.state._replace(yaw_rate=min(max(turn, -2.0), 2.0))

    def odom(self) -> VehicleState:
        """Return the next state, rarely an impossible one or one at another position."""
        chance = self.rng.random()
        if chance < 0.01:
            self.move()
        speed, turn = self.state.v_x, self.state.yaw_rate
        reported = self.next_state()
        keeps = chance < 0.01 or not 0.0 <= speed <= 40.0
        v_x = speed if keeps else self.state.v_x
        self.state = self.state._replace(v_x=v_x, yaw_rate=turn)
        if chance < 0.1:
            return reported
        if chance < 0.11:
            return self.state._replace(stamp_ns=int(self.rng.choice(np.array(STAMPS))))
        return self.state

    def move(self) -> None:
        """Change position or speed of the car abruptly."""
        if self.rng.random() < 0.7:
            speed = float(self.rng.choice(SPEEDS)) if self.rng.random() < 0.5 else 9.0
            self.state = self.state._replace(v_x=speed)
            return
        x, y = (float(each) for each in self.rng.choice(PLACES, 2))
        if self.rng.random() < 0.8:
            x, y = (each + float(self.rng.normal(0.0, 10.0)) for each in self.state[1:3])
        yaw = float(self.rng.uniform(-math.pi, math.pi))
        self.state = self.state._replace(x=x, y=y, yaw=yaw)

    def road(self) -> list[tuple[float, float]]:
        """Return a path: mostly the previous one, or one that starts at the car."""
        if self.points and self.rng.random() < 0.5:
            return self.points
        points = self.path() if self.rng.random() < 0.6 else self.odd_path()
        if self.rng.random() < 0.9:
            points = self.placed(points)
        self.points = points
        return points

    def odd_path(self) -> list[tuple[float, float]]:
        """Return a closed, crossing, tiny, short or distant path."""
        phase = np.linspace(0.0, math.tau, 80)
        size = 10.0 ** float(self.rng.uniform(-12.0, 2.5))
        far = float(self.rng.choice([0.0, 1e3, 1e6, 1e9, 1e15]))
        shapes = (
            (20.0 * np.sin(phase), 20.0 - 20.0 * np.cos(phase)),
            (60.0 * np.sin(phase), 25.0 * np.sin(2 * phase)),
            (size * np.arange(4.0), np.zeros(4)),
            (np.array([0.0, size]), np.zeros(2)),
            (far + 2.0 * np.arange(40.0), np.full(40, far)),
        )
        x, y = shapes[int(self.rng.integers(len(shapes)))]
        return [(float(a), float(b)) for a, b in zip(x, y, strict=True)]

    def placed(self, points: list[tuple[float, float]]) -> list[tuple[float, float]]:
        """Transform points that start at the origin to the pose of the car."""
        _, x, y, yaw, *_ = self.state
        cos, sin = math.cos(yaw), math.sin(yaw)
        return [(x + a * cos - b * sin, y + a * sin + b * cos) for a, b in points]

    def calm(self, period: float) -> Iterator[tuple[VehicleState, list[tuple[float, float]]]]:
        """Yield states of a straight drive for CALM seconds, each with the path, at each tick."""
        v = float(self.rng.uniform(3.0, 15.0))
        self.state = VehicleState(self.now_ns, 0.0, 0.0, 0.0, v, 0.0, 0.0)
        self.points = [(5.0 * i - 20.0, 0.0) for i in range(60)]
        for _ in range(round(CALM / period)):
            self.now_ns += round(period * NANOSECONDS)
            x = self.state.x + v * period
            self.state = self.state._replace(stamp_ns=self.now_ns, x=x, yaw_rate=0.0)
            yield self.state, self.points
