"""Kill nodes at random moments of a drive in real time and start them again.

`python -m tests.workshop.proofs.prove_restarts --moments 100 --seed 1` kills (SIGKILL) one, two or
all of simulator, planner and controller at each moment, all combinations in turn, and starts them
again up to 2 s later. After that the car must drive along its circle or stand. Then all stop
requests are taken back, and it must drive. At each moment all nodes must run, without a traceback
in their logs. Exit code 0: all moments passed.
"""

import argparse
import math
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rich.console import Console
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from launch_scripts.run.processes import Processes, ros_environment

RADIUS, SPEED, LAPS = 60.0, 8.0, 1000
"""Of the circle [m], [m/s]."""
MODULES = {
    "planner": "ampc_ros.nodes.planner_node",
    "controller": "ampc_ros.nodes.controller_node",
    "simulator": "sim_vehicle.nodes.simulator_node",
}
WITH_GATE = {"gate": "ampc_ros.nodes.gate_node", **MODULES}
VICTIMS = [names for size in (1, 2, 3) for names in combinations(MODULES, size)]
"""Nodes that are killed together, in turn."""
BEHIND_GATE = {ros.STEERING_COMMAND: ros.GATE_STEERING, ros.TARGET_SPEED: ros.GATE_SPEED}
"""Topics of a simulated car that obeys the gate."""
LONGEST_PAUSE = 2.0
"""Longest time from the kill to the start of the nodes [s]."""
LARGEST_ERROR = 1.0
"""Largest distance of a driving car from the circle [m]."""
DRIVING, STANDING = 1.0, 0.1
"""Speeds above and below which a car drives or stands [m/s]."""
SETTLED = 2.0
"""Time for which a car must drive or stand [s]."""
COMPILATION = 300.0
"""Longest time of the first start, with compilation [s]."""
RESET_PERIOD = 2.0
"""Time between two requests to take back all stops [s]."""


class CarWatch(Node):
    """Follows the car, and takes stop requests back."""

    def __init__(self) -> None:
        """Subscribe, and create the clients."""
        super().__init__("watch")
        self.state, self.since, self.arrived = "", math.inf, -math.inf
        self.create_subscription(Odometry, ros.ODOM, self.on_odometry, ros.NEWEST)
        names = ("controller/reset_stop", "planner/reset_stop", "gate/reset")
        self.resets = [self.create_client(Trigger, name) for name in names]

    def on_odometry(self, message: Odometry) -> None:
        """Store what the car does, and since when."""
        state, before, self.arrived = ros.vehicle_state(message), self.state, time.monotonic()
        error = abs(math.hypot(state.x, state.y - RADIUS) - RADIUS)
        drives = state.v_x > DRIVING and error < LARGEST_ERROR
        self.state = "drives" if drives else "stands" if state.v_x < STANDING else "neither"
        if self.state != before:
            self.since = self.arrived

    def settled(self, after: float) -> str:
        """Return what the car has done for SETTLED since a time; empty: not yet."""
        now = time.monotonic()
        is_fresh = now - self.arrived < SETTLED / 2
        lasted = now - max(self.since, after) > SETTLED
        return self.state if is_fresh and lasted and self.state != "neither" else ""

    def reset(self) -> None:
        """Take back all stop requests, without waiting for an answer."""
        for client in self.resets:
            if client.service_is_ready():
                client.call_async(Trigger.Request())


class Restarts:
    """The nodes of a drive around a circle, which are killed and started again."""

    def __init__(
        self, nodes: Processes, patience: float, modules: Mapping[str, str] = MODULES
    ) -> None:
        """Write the road, and start all nodes.

        Args:
            nodes: Processes.
            patience: Wall time after which a moment has failed [s].
            modules: Python module of each node; with a gate, the car obeys it.
        """
        self.nodes, self.patience, self.modules = nodes, patience, modules
        self.road = nodes.logs / "circle.csv"
        angles = [2 * math.pi * k / 360 for k in range(360)]
        points = [(RADIUS * math.sin(a), RADIUS - RADIUS * math.cos(a)) for a in angles]
        rows = "".join(f"{x},{y},{SPEED}\n" for x, y in points)
        self.road.write_text("x_m,y_m,v_mps\n" + rows, encoding="utf-8")
        self.watch = CarWatch()
        self.start(tuple(modules))
        until = time.monotonic() + COMPILATION
        while not all(map(self.is_ready, modules)) and time.monotonic() < until:
            time.sleep(0.1)
        self.wait("the first start", lambda: self.watch.settled(-math.inf) == "drives")

    def start(self, names: Sequence[str]) -> None:
        """Start nodes."""
        for name in names:
            parameters: dict[str, object] = {"static_path": True, "store_estimates": False}
            if name != "controller":
                parameters = {"path": str(self.road), "laps": LAPS}
            if name == "simulator":
                parameters |= {"time_out": 600.0, "start_time_out": 600.0}
            renamed = BEHIND_GATE if name == "simulator" and "gate" in self.modules else {}
            self.nodes.start(
                name, self.modules[name], {} if name == "gate" else parameters, renamed
            )

    def moment(self, names: Sequence[str], pause: float) -> str:
        """Kill nodes and start them again; return whether the car drove on or stood.

        Raises:
            ValueError: A node crashed, or the car did neither.
        """
        for name in names:
            self.check_log(name)
            os.killpg(self.nodes.running[name].pid, signal.SIGKILL)
            self.nodes.running[name].wait()
        self.spin(pause)
        self.start(names)
        self.wait("start again", lambda: all(map(self.is_ready, names)))
        return self.settle()

    def freeze(self, name: str, pause: float) -> str:
        """Stop a process for a time and continue it; return whether the car drove on or stood.

        Raises:
            ValueError: A node crashed, or the car did neither.
        """
        os.killpg(self.nodes.running[name].pid, signal.SIGSTOP)
        self.spin(pause)
        os.killpg(self.nodes.running[name].pid, signal.SIGCONT)
        return self.settle()

    def settle(self) -> str:
        """Return whether the car drives on or stands; then take back all stops until it drives.

        Raises:
            ValueError: A node crashed, or the car did neither.
        """
        began = time.monotonic()
        self.wait("drive or stand", lambda: bool(self.watch.settled(began)))
        outcome, reset_at = self.watch.settled(began), -math.inf

        def drives() -> bool:
            nonlocal reset_at
            if time.monotonic() - reset_at > RESET_PERIOD:
                reset_at = time.monotonic()
                self.watch.reset()
            return self.watch.settled(began) == "drives"

        self.wait("drive again after a reset", drives)
        return outcome

    def wait(self, what: str, condition: Callable[[], bool]) -> None:
        """Wait for a condition, and check the nodes.

        Raises:
            ValueError: It does not hold within the patience, or a node crashed.
        """
        until = time.monotonic() + self.patience
        while not condition():
            rclpy.spin_once(self.watch, timeout_sec=0.05)
            if ended := self.nodes.ended():
                name = next(iter(ended))
                raise ValueError(f"{what}: {name} ended: {self.nodes.last_line(name)}")
            if time.monotonic() > until:
                raise ValueError(f"{what}: not within {self.patience:g} s: {self.watch.state}")
        for name in self.modules:
            self.check_log(name)

    def spin(self, seconds: float) -> None:
        """Follow the car for a time [s]."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            rclpy.spin_once(self.watch, timeout_sec=0.05)

    def is_ready(self, name: str) -> bool:
        """Return whether a node has logged that it is ready."""
        return any(line.startswith("ready") for line in self.nodes.lines(name))

    def check_log(self, name: str) -> None:
        """Raise a ValueError if the log of a node contains a traceback."""
        if any(line.startswith("Traceback") for line in self.nodes.lines(name)):
            raise ValueError(f"{name}: traceback: {self.nodes.last_line(name)}")


def restart_nodes(
    logs: Path, moments: int, seed: int, patience: float, console: Console
) -> Counter[str]:
    """Kill and restart nodes at random moments; return how often the car drove on, or stood.

    Raises:
        ValueError: A moment failed.
    """
    rng, outcomes = random.Random(seed), Counter[str]()
    os.environ.update(ros_environment())
    rclpy.init()
    try:
        with Processes(logs) as nodes:
            restarts = Restarts(nodes, patience)
            for number in range(moments):
                names = VICTIMS[number % len(VICTIMS)]
                restarts.spin(rng.uniform(0.0, LONGEST_PAUSE))
                outcome = restarts.moment(names, rng.uniform(0.0, LONGEST_PAUSE))
                outcomes[outcome] += 1
                console.print(f"{number + 1}: {' and '.join(names)} killed: the car {outcome}")
    finally:
        rclpy.shutdown()
    return outcomes


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the moments, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=100, help="number of moments")
    parser.add_argument("--seed", type=int, default=1, help="seed of the moments")
    parser.add_argument("--patience", type=float, default=120.0, help="limit of a moment [s]")
    parser.add_argument("--logs", type=Path, help="folder of the logs; default: a temporary one")
    options, console = parser.parse_args(arguments), Console(highlight=False, soft_wrap=True)
    logs = options.logs or Path(tempfile.mkdtemp())
    try:
        outcomes = restart_nodes(logs, options.moments, options.seed, options.patience, console)
    except ValueError as error:
        console.print(f"error: {error}; logs: {logs}", markup=False)
        return 1
    console.print(f"{options.moments} moments passed: {dict(outcomes)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
