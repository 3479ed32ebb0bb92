"""Ready when activated: nothing is compiled after the warm-up, and no tick loads a module.

Every measurement runs in a fresh process: what an earlier test has compiled or loaded would hide
what is missing.
"""

import math
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config import ros
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import MODES, NANOSECONDS, VehicleState
from ampc_ros.configuration import CONTROLLERS, Choices, configuration
from ampc_ros.controller import make_controller
from ampc_ros.supervision import warm_up
from tests.fresh_process import compiled_signatures, in_a_fresh_process
from tests.ros_nodes import ros_context

PATHS: dict[str, list[tuple[float, float]]] = {
    "two points": [(0.0, 0.0), (300.0, 1.0)],
    "bends": [(float(x), 2.0 * math.sin(x / 12.0)) for x in range(0, 200, 2)],
    "closed": [(40.0 * math.sin(0.05 * i), 40.0 - 40.0 * math.cos(0.05 * i)) for i in range(126)],
}
SETTINGS = {
    "default": "max_angle: 0.5\n",
    "output rows": "max_output_error: 0.3\n",
    "hildreth": "solver: hildreth\nhildreth_sweeps: 5\n",
    "whole numbers": "max_angle: 1\nmax_increment: 1\nslack_weight: 10000\nmax_output_error: 1\n",
    "100 Hz": "sample_time: 0.01\n",
}


def compiled_after_warm_up(name: str, settings: Path) -> dict[str, int]:
    """Return the functions that random drives compile after the warm-up."""
    rng = np.random.default_rng(7)
    choices = Choices(controller=name, settings=str(settings))
    controller = make_controller(choices)
    warm_up.warm_up(configuration(choices))
    before = compiled_signatures()
    for points in PATHS.values():
        path = make_path(points)
        for tick in range(60):
            x, y = points[tick % len(points)]
            values = rng.normal((x, y, 0.0, 9.0, 0.0, 0.0), (3.0, 3.0, 1.0, 12.0, 0.5, 0.3))
            state = VehicleState(tick * NANOSECONDS // 10, *values.tolist())
            with suppress(ValueError):
                controller.step(state, path)
    after = compiled_signatures()
    return {key: after[key] - before.get(key, 0) for key in after if after[key] != before.get(key)}


@pytest.mark.parametrize("settings", SETTINGS)
@pytest.mark.parametrize("name", CONTROLLERS)
def test_no_function_is_compiled_after_the_warm_up(
    name: str, settings: str, tmp_path: Path
) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text(SETTINGS[settings], encoding="utf-8")
    assert in_a_fresh_process(compiled_after_warm_up, name, file) == {}


def test_the_warm_up_meets_every_mode_active_rows_and_both_kinds_of_path() -> None:
    controller, met = make_controller(Choices()), set()
    for points in (warm_up.STRAIGHT, warm_up.CIRCLE):
        path = make_path(points)
        controller.reset()
        for tick, values in enumerate(warm_up.WARM_UP_STATES):
            state = VehicleState(tick * NANOSECONDS // 10, *values)
            diagnosis = controller.step(state, path).diagnosis
            met |= {MODES[int(diagnosis.mode)], ("closed", path.closed)}
            met |= {("active", diagnosis.active_constraints > 0)}
            met |= {("outside", bool(diagnosis.outside_table))}
    flags = {(what, flag) for what in ("closed", "active", "outside") for flag in (False, True)}
    assert met == set(MODES) | flags


def late_work_of_node() -> list[str]:
    """Return the modules and functions that the first ticks of a node load or compile."""
    from ampc_ros.nodes.controller_node import ControllerNode

    chosen = {"settings": "100hz", "gain_table": "preview_100hz", "use_sim_time": "true"}
    with ros_context(**chosen) as executor:
        node = ControllerNode()
        node.initial.is_pending = False  # no wait for the angle of the wheel
        executor.add_node(node)
        node.on_path(ros.path_message(np.array(PATHS["bends"]), 0))
        messages = []
        for tick in range(150):
            stamp_ns = NANOSECONDS + tick * NANOSECONDS // 100
            state = VehicleState(stamp_ns, 0.09 * tick, 0.2, 0.01, 9.0, 0.0, 0.0)
            messages.append(ros.odometry_message(state))
        modules, functions = {*sys.modules}, compiled_signatures()
        for message in messages:
            node.on_odometry(message)
            node.on_timer()
            assert node.policy.is_answered
        late = {key for key, count in compiled_signatures().items() if count != functions.get(key)}
        return sorted({*sys.modules} - modules | late)


def test_no_tick_of_a_node_loads_or_compiles_anything() -> None:
    assert in_a_fresh_process(late_work_of_node) == []


@pytest.mark.parametrize("package", ["ampc_msgs_config", "ampc_ros", "sim_vehicle"])
def test_a_package_imports_numpy_and_scipy_with_one_thread_whatever_the_number_of_cores(
    package: str,
) -> None:
    environment = {key: text for key, text in os.environ.items() if "_NUM_THREADS" not in key}
    count = "print(len(os.listdir('/proc/self/task')))"
    command = [sys.executable, "-c", f"import os, {package}, numpy, scipy.linalg; {count}"]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "1"
