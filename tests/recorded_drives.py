"""Bags of drives without ROS, with the messages that the nodes would have recorded."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from ampc_msgs_config import ros
from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.recording.bag_writer import Recording
from ampc_msgs_config.recording.message_types import type_name_of
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedPlanner, load_scenario
from ampc_msgs_config.types import NANOSECONDS, TickRecord, VehicleState
from ampc_ros.configuration import Choices, configuration, to_yaml
from ampc_ros.supervision.memory import store
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import load_vehicle_file

VEHICLE = load_vehicle_file(find("vehicles", "paper"))
STEP_NS = NANOSECONDS // 50
MEMORY_TICKS = 10
"""Ticks between two memories of the controller."""
Disturb = Callable[[Supervisor, int], None]


class Bag:
    """A bag to which messages are appended; a context manager."""

    def __init__(self, folder: Path) -> None:
        """Open a new bag."""
        self.recording = Recording(folder)
        self.now_ns = 0

    def __enter__(self) -> "Bag":
        """Return the open bag."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the bag."""
        self.recording.close()

    def add(self, topic: str, message: Any) -> None:
        """Append a message, with a later log time than all others."""
        self.now_ns += 1000
        if topic not in self.recording.topics:
            self.recording.add_topic(topic, type_name_of(type(message)))
        self.recording.write(topic, serialize_message(message), self.now_ns, self.now_ns)

    def configuration(self, supervisor: Supervisor) -> None:
        """Append the configuration of a controller."""
        text = to_yaml(supervisor.config, supervisor.number)
        self.add(f"/controller/{ros.CONFIGURATION}", String(data=text))

    def path(self, points: Any, stamp_ns: int) -> None:
        """Append a reference path."""
        self.add(f"/{ros.REFERENCE_PATH}", ros.path_message(points, stamp_ns))

    def state(self, state: VehicleState) -> VehicleState:
        """Append a measured state; return it as a subscriber receives it."""
        message = ros.odometry_message(state)
        self.add(f"/{ros.ODOM}", message)
        return ros.vehicle_state(message)

    def memory(self, supervisor: Supervisor, commands: int) -> None:
        """Append what a controller remembers after so many commands."""
        self.add(f"/{ros.MEMORY}", ros.memory_message(store(supervisor), commands))

    def decision(
        self,
        record: TickRecord,
        commands: int,
        *,
        tick: bool = True,
        steering: SteeringParameters = ros.ROAD_WHEEL,
    ) -> None:
        """Write a command and its tick record."""
        command = record.command
        self.add(f"/{ros.STEERING_COMMAND}", ros.steering_message(command, steering))
        values = (*command.diagnosis, 0.001, 0.0, *record.quantities, 0, 0, commands)
        if tick:
            self.add(f"/{ros.TICK}", ros.tick_message(command.stamp_ns, values))


def scenario_of(name: str, duration: float = 6.0) -> Scenario:
    """Return the beginning of a scenario."""
    return load_scenario(name, VEHICLE.size)._replace(duration=duration)


def drive_in_real_time(
    folder: Path, disturb: Disturb, seed: int = 0, jitter_ns: int = 0
) -> list[int]:
    """Record a drive with its own clock, late states and whatever else; return the rungs.

    Args:
        folder: New folder of the bag.
        disturb: Is called with the supervisor and the number of each step.
        seed: Seed of delays and losses.
        jitter_ns: Bound of the delay of a tick [ns].
    """
    rng, scenario = np.random.default_rng(seed), scenario_of("sc2", 8.0)
    supervisor = Supervisor(configuration(Choices(static_path=True)))
    simulation, planner = Simulation(VEHICLE, scenario), SpeedPlanner(scenario)
    rungs, steering, commands, number = [], 0.0, 0, 0
    with Bag(folder) as bag:
        for step in range(400):
            now_ns = NANOSECONDS + step * STEP_NS
            measured = simulation.car.measure(now_ns - int(rng.integers(0, 5_000_000)))
            if step == 0:
                bag.path(scenario.points, now_ns)
                supervisor.take_path(scenario.points, now_ns, now_ns + 3)
            state = bag.state(measured)
            if not 200 < step < 240 or step % 20 == 0:  # else it is lost on its way
                supervisor.take_state(state, now_ns)
            if rng.random() < 0.5:
                supervisor.take_steering(simulation.car.steering)
            disturb(supervisor, step)
            if supervisor.number != number:
                number = supervisor.number
                bag.configuration(supervisor)
            late_ns = int(rng.integers(0, jitter_ns)) if jitter_ns else 0
            decision = supervisor.tick(now_ns + 77 + late_ns) if step % 5 == 4 else None
            if decision:
                commands, steering = commands + 1, decision.command.steering
                bag.decision(decision, commands)
                if commands % MEMORY_TICKS == 1:
                    bag.memory(supervisor, commands)
                rungs.append(decision.command.rung)
            simulation.advance(steering, planner.target_speed(state), STEP_NS)
    return rungs
