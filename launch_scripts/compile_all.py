"""Compile controllers and simulated car in advance, so that the first run need not wait."""

import argparse
import sys
from functools import partial

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

WHAT = "control tick and simulated car"


def main() -> int:
    """Compile everything that a drive needs; the machine code is stored in the user's cache."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    from ampc_msgs_config.compilation import log_compilation

    with log_compilation(WHAT, partial(print, flush=True)):
        compile_everything()
    return 0


def compile_everything() -> None:
    """Drive a moment with every controller."""
    from ampc_msgs_config.config import find
    from ampc_msgs_config.scenarios.scenario import load_scenario
    from ampc_ros.configuration import CONTROLLERS, Choices, configuration
    from ampc_ros.controller import make_controller
    from ampc_ros.supervision.warm_up import warm_up
    from sim_vehicle.closed_loop import Simulation, drive
    from sim_vehicle.parameters import load_vehicle_file

    vehicle = load_vehicle_file(find("vehicles", Choices().vehicle))
    scenario = load_scenario("sc1", vehicle.size)._replace(duration=0.2)
    for name in CONTROLLERS:
        choices = Choices(controller=name)
        warm_up(configuration(choices))
        drive(Simulation(vehicle, scenario), make_controller(choices))


if __name__ == "__main__":
    sys.exit(main())
