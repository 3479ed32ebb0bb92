"""Measure the report of a synthetic bag of an hour: wall time, memory, size of the page.

`python -m tests.workshop.bench.bench_report_page --minutes 60` writes the bag and the page into a
new folder. Formulas define the drive, so its peaks are known exactly.
"""

import argparse
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rclpy.serialization import serialize_message
from rich.console import Console
from rich.progress import track
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from ampc_msgs_config import ros
from ampc_msgs_config.config import find, read
from ampc_msgs_config.recording.bag_writer import Recording
from ampc_msgs_config.recording.message_types import type_name_of
from ampc_msgs_config.types import NANOSECONDS, Diagnosis, Plan, VehicleState

PERIOD_NS = NANOSECONDS // 10
ODOM_NS = NANOSECONDS // 50
SPEED, RADIUS = 15.0, 800.0
"""Speed [m/s] and radius [m] of the circle."""
PREDICTED = 45
"""Number of points of a prediction."""
SUPERVISOR = (
    *("steering", "planned_steering", "rung", "reason", "clipped", "state_age", "path_age"),
    *("measured_steering", "stop_requested", "configuration", "qp_fault", "rejected_inputs"),
    "missed_ticks",
)
NAMES = (*ros.DEBUG_QUANTITIES, *SUPERVISOR)


def state_at(stamp_ns: int) -> VehicleState:
    """Return the state on the circle with an oscillation of 5 cm and a peak of 40 cm in 10 min."""
    t = stamp_ns / NANOSECONDS
    swing = 0.05 * math.sin(0.7 * t) + 0.4 * math.exp(-(((t % 600.0) - 300.0) ** 2))
    angle, radius = SPEED * t / RADIUS, RADIUS - swing
    x, y = radius * math.sin(angle), RADIUS - radius * math.cos(angle)
    return VehicleState(stamp_ns, x, y, math.remainder(angle, math.tau), SPEED, 0.0, SPEED / RADIUS)


def steering_at(t: float) -> float:
    """Return the command [rad]."""
    return 0.0034 + 0.004 * math.sin(0.7 * t) + 0.001 * math.sin(31.0 * t)


def tick_message(stamp_ns: int, rng: np.random.Generator) -> JointState:
    """Return the tick message."""
    t, steering = stamp_ns / NANOSECONDS, steering_at(stamp_ns / NANOSECONDS)
    faulty = t % 600.0 > 595.0
    diagnosis = Diagnosis(
        cross_track_error=0.05 * math.sin(0.7 * t),
        prediction_horizon=20.0 + t // 300 % 3,
        control_horizon=12.0,
        laguerre_terms=5.0,
        laguerre_pole=0.3,
        output_weight=0.5,
        increment_weight=10.0 + math.sin(t / 60.0),
        active_constraints=float(faulty),
    )
    values = {
        **diagnosis._asdict(),
        "solve_time": 4e-5 + 1e-5 * float(rng.exponential()),
        "timer_lateness": 1e-4 * float(rng.exponential()),
        **dict.fromkeys(SUPERVISOR, 0.0),
        "steering": steering,
        "planned_steering": steering,
        "rung": 2.0 * faulty,
        "reason": 2.0 * faulty,
        "measured_steering": steering,
    }
    message = JointState(name=list(NAMES), position=[values[name] for name in NAMES])
    message.header.stamp = ros.time_message(stamp_ns)
    return message


def configurations() -> dict[str, dict[str, Any]]:
    """Return the configurations of the nodes."""
    vehicle = read(find("vehicles", "ordinary"))
    settings = read(find("controllers", "table3"))
    sections = {key: vehicle[key] for key in ("chassis", "steering")}
    control = {"controller": "preview", **sections, "settings": settings, "base_link_to_cg": 1.5}
    common = {"version": "0.1.0", "number": 1}
    return {"controller": common | control, "simulator": common | {"vehicle": vehicle, "seed": 0}}


def once(stamp_ns: int) -> dict[str, Any]:
    """Return the latched messages."""
    angle = np.linspace(0.0, math.tau, 1000)
    circle = RADIUS * np.column_stack((np.sin(angle), 1.0 - np.cos(angle)))
    texts = {f"{node}/configuration": yaml.safe_dump(c) for node, c in configurations().items()}
    messages: dict[str, Any] = {name: String(data=text) for name, text in texts.items()}
    return messages | {ros.REFERENCE_PATH: ros.path_message(circle, stamp_ns)}


def measured(stamp_ns: int) -> dict[str, Any]:
    """Return the messages of 50 Hz."""
    return {
        ros.ODOM: ros.odometry_message(state_at(stamp_ns)),
        ros.STEERING_STATE: ros.joint_message(stamp_ns, steering_at(stamp_ns / NANOSECONDS), 0.0),
        ros.WIND: ros.wind_message(stamp_ns, (3.0 * math.sin(stamp_ns / 3e9), -1.0)),
    }


def ticked(stamp_ns: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return the messages of every tick."""
    steering = steering_at(stamp_ns / NANOSECONDS)
    return {
        ros.TARGET_SPEED: ros.speed_message(ros.Stamped(stamp_ns, SPEED)),
        ros.STEERING_COMMAND: ros.steering_message(Plan(stamp_ns, steering, 0.0, Diagnosis())),
        ros.TICK: tick_message(stamp_ns, rng),
        **{f"controller/debug/{name}": Float64() for name in ros.DEBUG_QUANTITIES},
    }


def prediction(stamp_ns: int) -> Any:
    """Return the predicted path, straight ahead."""
    state = state_at(stamp_ns)
    step = 0.1 * SPEED * np.arange(1, PREDICTED + 1)
    x, y = state.x + step * math.cos(state.yaw), state.y + step * math.sin(state.yaw)
    return ros.path_message(np.column_stack((x, y)), stamp_ns)


def make_bag(folder: Path, minutes: float, start: float = 1.0) -> Path:
    """Write the bag of a drive: odometry at 50 Hz, a tick at 10 Hz, all topics of the contract.

    Args:
        folder: Folder of the bag.
        minutes: Duration of the drive.
        start: First stamp [s]; the last 5 s of each ten minutes are faulty.
    """
    rng, begin = np.random.default_rng(0), round(start * NANOSECONDS)
    with Recording(folder) as recording:

        def write(messages: dict[str, Any], stamp_ns: int) -> None:
            for name, message in messages.items():
                if f"/{name}" not in recording.topics:
                    recording.add_topic(f"/{name}", type_name_of(type(message)))
                recording.write(f"/{name}", serialize_message(message), stamp_ns, stamp_ns)

        write(once(begin), begin)
        steps = range(begin, begin + round(minutes * 60 * NANOSECONDS), ODOM_NS)
        for stamp_ns in track(steps, "writing the bag"):
            write(measured(stamp_ns), stamp_ns)
            if (stamp_ns - begin) % PERIOD_NS == 0:
                write(ticked(stamp_ns, rng), stamp_ns)
                write({ros.PREDICTED_PATH: prediction(stamp_ns)}, stamp_ns)
    return folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the bag, report it in a separate process, and print time and memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="duration of the drive")
    parser.add_argument("--output", type=Path, help="new folder; default: a temporary one")
    chosen, console = parser.parse_args(arguments), Console(highlight=False)
    folder = chosen.output or Path(tempfile.mkdtemp())
    bag = folder / "bag" if (folder / "bag").exists() else make_bag(folder / "bag", chosen.minutes)
    page, begin = folder / "report.html", time.monotonic()
    command = [sys.executable, "-m", "launch_scripts.report", str(bag), "--output", str(page)]
    code = subprocess.call(command, cwd=Path(__file__).parents[3])
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    memory, cpu = used.ru_maxrss / 1024, used.ru_utime + used.ru_stime
    size = sum(file.stat().st_size for file in bag.glob("*.mcap")) / 1e6
    took = time.monotonic() - begin
    console.print(f"{chosen.minutes:g} minutes, bag of {size:.0f} MB: reported in {took:.1f} s,")
    console.print(f"{cpu:.1f} s of processor time, at most {memory:.0f} MB, exit code {code};")
    console.print(f"page of {page.stat().st_size / 1e6:.2f} MB: {page}")
    return code


if __name__ == "__main__":
    sys.exit(main())
