"""Warm-up: run everything that a supervised tick can need once before the first tick."""

import math
from contextlib import suppress

from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.configuration import Configuration
from ampc_ros.estimation.adaptation import Adaptation
from ampc_ros.estimation.command_history import CommandHistory
from ampc_ros.supervision.fallback import PLAN_TIME
from ampc_ros.supervision.supervisor import Supervisor

STRAIGHT = [(0.0, 0.0), (200.0, 0.0)]
CIRCLE = [(30.0 * math.sin(0.1 * i), 30.0 - 30.0 * math.cos(0.1 * i)) for i in range(63)]
WARM_UP_STATES = (
    (0.0, 0.1, 0.0, 9.0, 0.0, 0.0),
    (1.0, 0.1, 0.0, 9.0, 0.1, 0.01),
    (2.0, -6.0, 0.3, 35.0, -0.5, -0.2),
    (3.0, 6.0, -0.3, 2.0, 0.5, 0.2),
    (260.0, 0.1, 0.0, 9.0, 0.0, 0.0),
    (0.0, 500.0, 0.0, 9.0, 0.0, 0.0),
    (0.0, 0.1, math.pi, 9.0, 0.0, 0.0),
    (0.0, 0.1, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.1, 0.0, -1.0, 0.0, 0.0),
)
"""x, y [m], yaw [rad], v_x, v_y [m/s], yaw rate [rad/s]."""


def warm_up(config: Configuration) -> None:
    """Step a controller and its fallbacks through all their branches.

    A configuration is warmed up with a supervisor of its own, so that no running one changes. What
    numba compiles follows from the types of the arguments, which every branch here has; the values
    select the rest: active bounds, closed path, end of the path, car off the path, at standstill,
    driving backwards or the wrong way.

    Raises:
        ValueError: The gains make the controller's problem numerically singular.
    """
    supervisor = Supervisor(config)
    controller = supervisor.controller
    period_ns = round(controller.period * NANOSECONDS)
    for path in (make_path(STRAIGHT), make_path(CIRCLE)):
        controller.reset()
        for tick in range(2 * len(WARM_UP_STATES)):
            state = VehicleState(tick * period_ns, *WARM_UP_STATES[tick % len(WARM_UP_STATES)])
            with suppress(ValueError):  # the paper's formulation refuses to leave the path's end
                controller.step(state, path)
            controller.observe_steering(controller.steering)
    supervisor.restart(0.0)
    path = make_path(STRAIGHT)
    for tick in range(round(PLAN_TIME / supervisor.period) + 2):  # until the plan is used up
        x = 9.0 * tick * supervisor.period
        supervisor.take_steering(0.0)
        supervisor.step(VehicleState(tick * period_ns, x, 0.1, 0.0, 9.0, 0.0, 0.0), path)
        supervisor.inject_qp_fault(True)
    supervisor.tick(supervisor.newest_ns + period_ns)  # the state has to be predicted
    adaptation, commands = Adaptation(config), CommandHistory(0.0, NANOSECONDS)
    for tick in range(2):
        state = VehicleState(tick * NANOSECONDS // 10, 0.0, 0.0, 0.0, 9.0, 0.1, 0.1 * tick)
        adaptation.observe(state, commands)
