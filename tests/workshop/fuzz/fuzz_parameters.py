"""Fuzzing of the parameter and life-cycle services of every node that has them, without DDS.

Each request goes to the callback that the executor would call. A node must survive it, keep what
cannot change at run time, and steer on; the recorder has no parameter services.
"""

import inspect
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rclpy.logging import LoggingSeverity, set_logger_level

from ampc_msgs_config import ros
from ampc_msgs_config.config import shipped
from ampc_msgs_config.nodes.base_node import BaseNode
from ampc_msgs_config.nodes.marker_node import MarkerNode
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from sim_vehicle.nodes.simulator_node import SimulatorNode
from tests.workshop.fuzz.fuzz_guard import Violation

NODES: list[Callable[[], BaseNode]] = [ControllerNode, PlannerNode, SimulatorNode, MarkerNode]
AT_RUN_TIME = {"settings", "gain_table", "guard", "static_path", "qp_fault"}
"""Parameters of the controller that may change."""
HUGE = "9" * 401
FILES = {
    "huge.yaml": f"max_angle: {HUGE}\n",
    "huge_row.yaml": f"speed: [0.0, {HUGE}]\nmax_angle: [{HUGE}, 1]\n",
    "digits.yaml": f"max_angle: {'9' * 5000}\n",
    "nested.yaml": "[" * 3000,
    "maps.yaml": "{a: " * 1000,
    "long.yaml": "- 1\n" * 2000,
    "keys.yaml": "max_angle: 1\nmax_angle: 2\n",
    "empty.yaml": "",
    "null.yaml": "\0",
    "tag.yaml": "!!python/object/apply:os.getcwd []\n",
    "careful.yaml": "max_angle: 0.4\nmax_increment: 0.2\n",
    "large.yaml": "#" * 6_000_000,
}
"""Files by name; the last but one is valid."""
NAMES = (
    *("x" * 300, "a/" * 3000, "", ".", "..", "/", "/dev/null", "/dev/zero", "/proc/self/mem"),
    *("\0", "a\0b", "\udc80", "\n", "~", "loop.yaml", "nowhere.yaml", "folder", "'" * 260),
    *("road", "track", "preview", "preview_ordinary", "default", *FILES),
)
ORDINARY = {"start_type_description_service", "lock_step", "vehicle", "not_declared"}
WORDS = (*NAMES[:12], *sorted(ORDINARY), "use_sim_time", "a.b.c", "Ä", "x" * 10_000)


class Requests:
    """Random requests for the services of a node."""

    def __init__(self, seed: list[int], names: list[str]) -> None:
        """Choose the seed and the names of the node's parameters."""
        self.rng, self.names = np.random.default_rng(seed), [*names, *sorted(AT_RUN_TIME)]

    def pick(self, values: Any) -> Any:
        """Return one of the values."""
        return values[int(self.rng.integers(len(values)))]

    def text(self) -> str:
        """Return a name of a file, or a word."""
        return str(self.pick(NAMES if self.rng.random() < 0.8 else WORDS))

    def name(self) -> str:
        """Return a name of a parameter, mostly of one that exists."""
        return str(self.pick(self.names if self.rng.random() < 0.85 else WORDS))

    def value(self) -> ParameterValue:
        """Return a value of any type and size."""
        rng, size = self.rng, int(self.pick([0, 1, 3, 1000]))
        number = float(self.pick([0.0, -1.0, 0.5, np.nan, np.inf, -np.inf, 1e308, 5e-324]))
        whole = int(self.pick([0, 1, -1, 2**63 - 1, -(2**63), 99]))
        texts = [self.text() for _ in range(min(size, 3))]
        return ParameterValue(
            type=int(self.pick([*range(10), 1, 4, 4, 4, 10, 99, 255])),
            bool_value=bool(rng.random() < 0.5),
            integer_value=whole,
            double_value=number,
            string_value=encodable(self.text()),
            byte_array_value=[b"\xff"] * size,
            bool_array_value=[True] * size,
            integer_array_value=[whole] * size,
            double_array_value=[number] * size,
            string_array_value=[encodable(text) for text in texts],
        )

    def fill(self, service: Any) -> Any:
        """Return a request for a service."""
        request = service.srv_type.Request()
        count = int(self.pick([0, 1, 1, 1, 2, 5]))
        if hasattr(request, "parameters"):
            request.parameters = [
                ParameterMessage(name=encodable(self.name()), value=self.value())
                for _ in range(count)
            ]
        elif hasattr(request, "names"):
            request.names = [encodable(self.name()) for _ in range(count)]
        elif hasattr(request, "prefixes"):
            request.prefixes = [encodable(self.name()) for _ in range(count)]
            request.depth = int(self.pick([0, 1, 2**63, 2**64 - 1]))
        elif hasattr(request, "type_name"):
            digits = str(self.pick(["0", "f"])) * 64  # others print lines of the C library
            request.type_name, request.type_hash = encodable(self.name()), f"RIHS01_{digits}"
        return request


def encodable(text: str) -> str:
    """Return a text as it arrives over DDS: without a null character or a lone surrogate."""
    return text.encode("utf-8", "replace").decode().partition("\0")[0]


def parameter_drive(seed: int, drive: int, count: int) -> Counter[str]:
    """Send random requests to all nodes.

    Raises:
        Violation: A node has changed what cannot change, or does not steer on.
    """
    with hostile_folder(), ros_context_of_fuzz():
        done: Counter[str] = Counter()
        for index, make_node in enumerate(NODES):
            node = make_node()
            names = sorted(node.get_parameters_by_prefix("") or ORDINARY)
            requests = Requests([seed, drive, index], names)
            share = count // len(NODES) + (index < count % len(NODES))
            done += send_all(node, requests, share)
            node.destroy_node()  # type: ignore[no-untyped-call]
    return done


def send_all(node: BaseNode, requests: Requests, count: int) -> Counter[str]:
    """Send requests to one node.

    Raises:
        Violation: The node has changed what cannot change, or does not steer on.
    """
    done: Counter[str] = Counter()
    services: list[Any] = [each for each in node.services if each.srv_type is not ChangeState]
    fixed = fixed_values(node)
    car = Car(node) if isinstance(node, ControllerNode) else None
    for i in range(count):
        service = requests.pick(services)
        kind, request = service.srv_name.rpartition("/")[2], requests.fill(service)
        done[f"request {kind}"] += 1
        try:
            response = finish(service.callback(request, service.srv_type.Response()))
            done["answered"] += response is not None
        except Exception as error:
            node.failed.store(error)
            done[f"failed {type(error).__name__}"] += 1
        if fixed_values(node) != fixed:
            raise Violation(f"request {i}, {kind}: changed {fixed_values(node)} from {fixed}")
        if car and i % 10 == 0:
            car.drive(f"request {i}, {kind}")
    return done


def finish(answer: Any) -> Any:
    """Return the answer of a callback; a coroutine is run to its end."""
    if not inspect.iscoroutine(answer):
        return answer
    while True:
        try:
            answer.send(None)
        except StopIteration as end:
            return end.value


def fixed_values(node: BaseNode) -> str:
    """Return the parameters that cannot change, as text, in which nan equals itself."""
    parameters: Any = node.get_parameters_by_prefix("")
    changing = AT_RUN_TIME if isinstance(node, ControllerNode) else set()
    # rclpy 7.1.6 lets a request declare a parameter without a name
    fixed = {name for name in parameters if name} - changing
    return repr({name: parameters[name].value for name in sorted(fixed)})


class Car:
    """A car on a straight road, which a controller in lock-step steers."""

    def __init__(self, node: ControllerNode) -> None:
        """Publish the path."""
        self.node, self.ticks = node, 0
        node.on_path(ros.path_message(np.array([(5.0 * i, 0.0) for i in range(400)]), 1))

    def drive(self, what: str) -> None:
        """Publish the next state.

        Raises:
            Violation: No finite command within the largest angle answers it.
        """
        self.ticks += 1
        now_ns = self.ticks * NANOSECONDS // 10
        x = 9.0 * self.ticks / 10 % 1500.0
        if x < 0.9:  # a new drive
            self.node.supervisor.forget()
            self.node.on_path(ros.path_message(np.array([(5.0 * i, 0.0) for i in range(400)]), 1))
        known = self.node.commands
        state = VehicleState(now_ns, x, 0.2, 0.0, 9.0, 0.0, 0.0)
        self.node.on_odometry(ros.odometry_message(state))
        newest = self.node.outputs.newest
        if self.node.commands != known + 1 or newest is None:
            raise Violation(f"{what}: no command follows")
        if not abs(newest.position[0]) <= max(self.node.supervisor.config.guard.max_angle):
            raise Violation(f"{what}: the angle {newest.position[0]} is outside its limit")


@contextmanager
def hostile_folder() -> Iterator[None]:
    """Work in a temporary folder with hostile files."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for name, text in FILES.items():
                Path(name).write_text(text, encoding="utf-8")
            Path("loop.yaml").symlink_to("loop.yaml")
            Path("folder").mkdir()
            Path("gains.yaml").write_text(shipped("gains")["preview"].read_text("utf-8"), "utf-8")
            yield
        finally:
            os.chdir(before)


@contextmanager
def ros_context_of_fuzz() -> Iterator[None]:
    """Join ROS with nodes in lock-step, which load files in their own process."""
    parameters = {"lock_step": "true", "controller": "preview", "static_path": "true"}
    texts = [text for key, value in parameters.items() for text in ("-p", f"{key}:={value}")]
    rclpy.init(args=["--ros-args", "--log-level", "fatal", *texts])
    try:
        yield
    finally:
        rclpy.shutdown()
        set_logger_level("", LoggingSeverity.INFO)  # it outlives the context
