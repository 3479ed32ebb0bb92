"""Compile controllers and simulated car in advance, so that the first run need not wait."""

import argparse
import multiprocessing
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

if TYPE_CHECKING:
    from sim_vehicle.closed_loop import Simulation

WHAT = "control tick, simulated car and fleet"


def main() -> int:
    """Compile everything that a drive needs; the machine code is stored in the user's cache."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    from ampc_msgs_config.compilation import log_compilation

    with log_compilation(WHAT, partial(print, flush=True)):
        compile_everything()
    return 0


def compile_everything() -> None:
    """Run all parts, two at a time in two processes."""
    spawn = multiprocessing.get_context("spawn")
    for here, elsewhere in PAIRS:
        other = spawn.Process(target=elsewhere, daemon=True)
        other.start()
        here()
        other.join()
        if other.exitcode:
            raise RuntimeError(f"a process that compiles ended with exit code {other.exitcode}")


def compile_controller(name: str) -> None:
    """Drive a moment with a controller."""
    from ampc_ros.configuration import Choices, configuration
    from ampc_ros.controller import make_controller
    from ampc_ros.supervision.warm_up import warm_up
    from sim_vehicle.closed_loop import drive

    choices = Choices(controller=name)
    warm_up(configuration(choices))
    drive(short_drive(), make_controller(choices))


def compile_car_and_solver() -> None:
    """Advance a car by a step, and solve a QP."""
    import numpy as np

    import ampc_msgs_config.compilation  # noqa: F401 - collects garbage rarely
    from ampc_ros.mpc.active_set import active_set, active_set_numbers
    from ampc_ros.mpc.qp import Qp
    from ampc_ros.mpc.small_matrices import make_scratch

    qp = Qp(np.eye(2), np.ones(2), np.eye(2), -np.ones(2), np.ones(2))
    active_set(qp, np.zeros(2), np.zeros(2), make_scratch(active_set_numbers(2, 2)))
    simulation = short_drive()
    simulation.advance(0.0, 0.0, simulation.step_ns)


def compile_fleet(name: str) -> None:
    """Drive a fleet of one car with a controller for a moment."""
    import numpy as np

    from ampc_ros.configuration import Choices
    from ampc_ros.controller import make_controller
    from launch_scripts.tuning.fleet import LOGGED
    from launch_scripts.tuning.fleet_rows import Entry, prepare_fleet, run_part

    controller: Any = make_controller(Choices(controller=name))
    fleet_run = prepare_fleet([Entry(short_drive(), controller)])
    run_part(fleet_run, slice(0, 1), np.full((1, fleet_run.fleet.ticks[0], LOGGED), np.nan))


def compile_paper() -> None:
    """Drive a moment with the paper's controller, then as a fleet."""
    compile_controller("paper")
    compile_fleet("paper")


PAIRS = (
    (partial(compile_controller, "preview"), compile_car_and_solver),
    (compile_paper, partial(compile_fleet, "preview")),
)
"""Pairs that run at the same time. A part uses what the pairs before it have compiled."""


def short_drive() -> "Simulation":
    """Return a simulation of the first moment of a scenario."""
    from ampc_msgs_config.config import find
    from ampc_msgs_config.scenarios.scenario import load_scenario
    from ampc_ros.configuration import Choices
    from sim_vehicle.closed_loop import Simulation
    from sim_vehicle.parameters import load_vehicle_file

    vehicle = load_vehicle_file(find("vehicles", Choices().vehicle))
    return Simulation(vehicle, load_scenario("sc1", vehicle.size)._replace(duration=0.2))


if __name__ == "__main__":
    sys.exit(main())
