"""Parameters with which planner and simulator select a drive."""

from rclpy.node import Node

from ampc_msgs_config.config import find, shipped_or_file
from ampc_msgs_config.nodes.base_node import declare
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.path_file import Route, choose_scenario
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.vehicle_file import load_section

CSV = "a CSV file of x_m,y_m[,v_mps] or t_s,x_m,y_m; empty: none"
COLUMN_NUMBERS = "numbers such as x=3,y=4; empty: by the header"


def declare_scenario(node: Node) -> Scenario:
    """Declare the parameters that select a drive, and load it.

    Raises:
        ValueError: File, key or line, value and bound.
    """
    vehicle = declare(node, "vehicle", "paper", "car", shipped_or_file("vehicles"))
    default = Route()
    route = Route(
        declare(node, "scenario", default.scenario, "drive", shipped_or_file("scenarios")),
        declare(node, "path", default.path, "path instead of a scenario", CSV),
        declare(node, "speed", default.speed, "constant speed [m/s]; -1: as given", (-1, 100)),
        declare(
            node,
            "lateral_acceleration",
            default.lateral_acceleration,
            "largest along the CSV's path [m/s^2]; -1: speed as given",
            (-1, 20),
        ),
        declare(node, "laps", default.laps, "of a CSV's closed path", (1, 1000)),
        declare(node, "columns", default.columns, "columns of the CSV", COLUMN_NUMBERS),
    )
    size = load_section(SizeParameters, find("vehicles", vehicle), "size", f"the {node.get_name()}")
    scenario = choose_scenario(route, size)
    if scenario.note:
        node.get_logger().info(f"{route.path}: {scenario.note}")
    return scenario
