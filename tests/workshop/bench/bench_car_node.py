"""Node `bench_car`: drives in real time at a given rate and measures the answers."""

import json
import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ampc_msgs_config import ros
from ampc_msgs_config.config import find
from ampc_msgs_config.nodes.base_node import BaseNode, declare, spin
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import NANOSECONDS
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import load_vehicle_file

SETTLING = 2.0
"""Duration of the drive before the measurement [s]."""
SPEED = 9.0
"""Target speed [m/s]."""
SERIES = {"tick": "solve_time", "lateness": "timer_lateness"}
"""Measured series, and the debug topic of the controller that provides it."""


class BenchCarNode(BaseNode):
    """Publishes its state at the rate; ends the process after the measurement."""

    def __init__(self) -> None:
        """Compile the car, then start to drive."""
        super().__init__("bench_car")
        self.rate = declare(self, "rate", 100, "rate of the states [Hz]", (1, 200))
        self.seconds = declare(
            self, "seconds", 10.0, "duration of the measurement [s]", (0.1, 3600)
        )
        self.pid = declare(self, "pid", 0, "process number of the controller", (0, 2**31 - 1))
        self.result = Path(declare(self, "result", "row.json", "result file"))
        vehicle = load_vehicle_file(find("vehicles", "paper"))
        self.simulation = Simulation(vehicle, load_scenario("circle", vehicle.size))
        self.simulation.advance(0.0, SPEED, NANOSECONDS // self.rate)
        self.angle: float | None = None
        self.begin_ns, self.at_begin = 0, (0, 0.0)
        self.sent: dict[int, int] = {}
        self.series: dict[str, list[float]] = {name: [] for name in ("latency", *SERIES)}
        self._publish_and_subscribe()

    def _publish_and_subscribe(self) -> None:
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.steering = self.create_publisher(JointState, ros.STEERING_STATE, ros.RELIABLE)
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        self.paths.publish(ros.path_message(self.simulation.scenario.points, self.now_ns))
        self.create_subscription(JointState, ros.STEERING_COMMAND, self.on_command, ros.RELIABLE)
        self.create_subscription(DiagnosticArray, ros.DIAGNOSTICS, self.on_report, ros.RELIABLE)
        for name, quantity in SERIES.items():
            topic, append = f"controller/debug/{quantity}", self.series[name].append
            self.create_subscription(Float64, topic, partial(append_value, append), ros.RELIABLE)
        self.create_timer(1.0 / self.rate, self.on_timer)

    def on_timer(self) -> None:
        """Drive one period with the newest command, if any, and publish the state."""
        if self.angle is not None:
            self.simulation.advance(self.angle, SPEED, NANOSECONDS // self.rate)
        stamp_ns, car = self.now_ns, self.simulation.car
        self.steering.publish(ros.joint_message(stamp_ns, car.steering, 0.0))
        self.sent[stamp_ns] = self.now_ns
        self.odom.publish(ros.odometry_message(car.measure(stamp_ns)))

    def on_command(self, message: JointState) -> None:
        """Apply a command and append its latency."""
        command, now_ns = ros.steering_angle(message), self.now_ns
        self.angle = command.value
        sent_ns = self.sent.pop(command.stamp_ns, now_ns)
        self.series["latency"].append((now_ns - sent_ns) / NANOSECONDS)

    def on_report(self, message: DiagnosticArray) -> None:
        """Start and end the measurement at diagnostics of the controller, which hold counts."""
        values = {pair.key: pair.value for pair in message.status[0].values}
        if "missed_ticks" not in values:
            return
        missed, now_ns = int(values["missed_ticks"]), self.now_ns
        if not self.begin_ns:
            if len(self.series["latency"]) < SETTLING * self.rate:
                return
            self.begin_ns = now_ns
            self.at_begin = missed, processor_time(self.pid)
            self.sent.clear()
            for series in self.series.values():
                series.clear()
        elif now_ns - self.begin_ns >= self.seconds * NANOSECONDS:
            self.write(missed - self.at_begin[0], (now_ns - self.begin_ns) / NANOSECONDS)
            raise SystemExit(0)

    def write(self, missed: int, elapsed: float) -> None:
        """Write the results of a measurement of `elapsed` [s]."""
        before_ns = self.now_ns - 3 * NANOSECONDS // self.rate  # later ones may still be answered
        spreads = {name: spread(series) for name, series in self.series.items()}
        counts = {
            "ticks": len(self.series["latency"]),
            "missed": missed,
            "unanswered": sum(stamp_ns < before_ns for stamp_ns in self.sent),
            "load": (processor_time(self.pid) - self.at_begin[1]) / elapsed,
        }
        self.result.write_text(json.dumps(spreads | counts), encoding="utf-8")


def append_value(append: Callable[[float], None], message: Float64) -> None:
    """Append the number of a message."""
    append(message.data)


def spread(seconds: list[float]) -> list[float]:
    """Return median, 99th percentile and maximum of a series [ms]."""
    return [float(np.quantile(seconds, share)) * 1000.0 for share in (0.5, 0.99, 1.0)]


def processor_time(pid: int) -> float:
    """Return the processor time of all threads of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Run the node."""
    return spin(BenchCarNode)


if __name__ == "__main__":
    sys.exit(main())
