"""Starts simulator, planner, controller and markers, and a recording on request.

``ros2 launch ampc_ros ampc.launch.py scenario:=sc2 output:=runs/sc2`` drives a scenario in
lock-step. On a real car, ``simulate:=false lock_step:=false`` leaves the simulator out. Topics
stay on this machine; ``ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET ros2 launch ...`` shares them.
"""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import (
    EnvironmentVariable,
    LaunchConfiguration,
    NotEqualsSubstitution,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from ampc_msgs_config.config import shipped


def file_or(folder: str) -> str:
    """The words for an argument that takes a shipped name or a file."""
    return f"YAML file, or one of {', '.join(shipped(folder))}"


ARGUMENTS = {
    "scenario": ("sc1", file_or("scenarios")),
    "path": ("", "CSV of x_m,y_m[,v_mps] or t_s,x_m,y_m to drive instead of a scenario"),
    "speed": ("-1.0", "constant speed instead of the given one [m/s]; -1: as given"),
    "lateral_acceleration": ("-1.0", "largest along the CSV's path [m/s2]; -1: as given"),
    "laps": ("1", "of a CSV's closed path"),
    "vehicle": ("paper", file_or("vehicles")),
    "controller": ("preview", "who steers"),
    "settings": ("table3", f"limits of the controller: {file_or('controllers')}"),
    "gain_table": ("", f"gains: {file_or('gains')}; empty: the controller's own"),
    "guard": ("road", f"limits of every command: {file_or('guards')}"),
    "static_path": ("true", "the path is published once, as the planner does, and does not age"),
    "base_link_to_cg": ("-1.0", "from odom to the centre of gravity [m]; -1: rear axle"),
    "friction": ("-1.0", "of the road; -1: that of the tyres"),
    "noise": ("", f"of the measurement: {file_or('noise')}; empty: none"),
    "seed": ("0", "of the noise"),
    "lock_step": ("true", "simulated time advances only when every state is answered"),
    "time_out": ("10.0", "longest wait for a node's answer [s]"),
    "start_time_out": ("180.0", "longest wait for all nodes, also while they compile [s]"),
    "namespace": ("", "of the nodes and of their topics"),
    "simulate": ("true", "start the simulator; false where a real car drives"),
    "output": ("", "new folder for a recording; empty: none"),
}
CHOICES = {"controller": ["preview", "paper", "classic", "pure_pursuit"]}
FLOATS = (
    "speed",
    "lateral_acceleration",
    "base_link_to_cg",
    "friction",
    "time_out",
    "start_time_out",
)
SWITCHES = ("lock_step", "static_path")
TYPES = dict.fromkeys(FLOATS, float) | {"seed": int, "laps": int} | dict.fromkeys(SWITCHES, bool)

ROUTE = ("vehicle", "scenario", "path", "speed", "lateral_acceleration", "laps")
PLANT = ("friction", "noise", "seed", "time_out", "start_time_out")
CONTROL = (
    "vehicle",
    "controller",
    "settings",
    "gain_table",
    "guard",
    "static_path",
    "base_link_to_cg",
)


def generate_launch_description() -> LaunchDescription:
    """Declares the arguments and starts the nodes; when one ends, but for markers, all end."""
    arguments = [
        DeclareLaunchArgument(
            name, default_value=value, description=text, choices=CHOICES.get(name)
        )
        for name, (value, text) in ARGUMENTS.items()
    ]
    simulated = IfCondition(LaunchConfiguration("simulate"))
    recorded = NotEqualsSubstitution(LaunchConfiguration("output"), "")
    mode = parameters("lock_step") | {
        "wait_for_recorder": ParameterValue(recorded, value_type=bool)
    }
    record = parameters("output") | {"use_sim_time": parameter("lock_step")}
    nodes = [
        node("sim_vehicle", "simulator", mode | parameters(*ROUTE, *PLANT), simulated),
        node("ampc_ros", "planner", mode | parameters(*ROUTE)),
        node("ampc_ros", "controller", mode | parameters(*CONTROL)),
        node("ampc_msgs_config", "recorder", record, IfCondition(recorded)),
    ]
    together = [
        RegisterEventHandler(OnProcessExit(target_action=each, on_exit=EmitEvent(event=Shutdown())))
        for each in nodes
    ]
    look = parameters("lock_step", "vehicle", "base_link_to_cg")
    markers = node("ampc_msgs_config", "markers", look)
    return LaunchDescription([*arguments, local_discovery(), *together, *nodes, markers])


def local_discovery() -> SetEnvironmentVariable:
    """Topics stay on this machine, unless the shell says otherwise."""
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    return SetEnvironmentVariable(name, EnvironmentVariable(name, default_value="LOCALHOST"))


def parameter(argument: str) -> ParameterValue:
    """A launch argument as the value of a node's parameter."""
    return ParameterValue(LaunchConfiguration(argument), value_type=TYPES.get(argument, str))


def parameters(*names: str) -> dict[str, ParameterValue]:
    """Launch arguments as parameters of the same names."""
    return {name: parameter(name) for name in names}


def node(
    package: str,
    executable: str,
    values: dict[str, ParameterValue],
    condition: IfCondition | None = None,
) -> Node:
    """A node in the chosen namespace, its log on the screen."""
    return Node(
        package=package,
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[values],
        condition=condition,
        output="screen",
    )
