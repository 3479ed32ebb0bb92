"""Starts simulator, planner and controller, and a recording on request.

``ros2 launch ampc_ros ampc.launch.py scenario:=sc2 record:=runs/sc2`` drives a scenario in
lock-step. On a real car, ``simulate:=false lock_step:=false`` leaves the simulator out.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition, UnlessCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "vehicle": ("paper", "name of a shipped vehicle, or a YAML file"),
    "scenario": ("sc1", "name of a shipped scenario, or a YAML file"),
    "path": ("", "CSV file of a path to drive instead of the scenario's; empty for none"),
    "speed": ("-1.0", "constant speed instead of the given one [m/s]; -1 for as given"),
    "controller": ("paper", "paper, classic or pure_pursuit"),
    "gain_table": ("table3", "name of a shipped gain table, or a YAML file"),
    "lock_step": ("true", "simulated time advances only when all commands have arrived"),
    "time_out": ("60.0", "wait for a command in lock-step, also while nodes compile [s]"),
    "namespace": ("", "namespace of the nodes and of their topics"),
    "simulate": ("true", "start the simulator; false where a real car drives"),
    "record": ("", "new folder for a recording; empty for none"),
}
TYPES = {"speed": float, "time_out": float, "lock_step": bool}
DRIVE = ("vehicle", "scenario", "path", "speed", "lock_step")


def generate_launch_description() -> LaunchDescription:
    """Declares the arguments and starts the nodes; when one node ends, all end."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=description)
        for name, (value, description) in ARGUMENTS.items()
    ]
    follows_clock = {"use_sim_time": argument("lock_step")}
    simulate = IfCondition(LaunchConfiguration("simulate"))
    record = UnlessCondition(EqualsSubstitution(LaunchConfiguration("record"), ""))
    control = ("vehicle", "controller", "gain_table", "lock_step")
    nodes = [
        node(
            "sim_vehicle",
            "simulator",
            [arguments_of((*DRIVE, "time_out")), follows_clock],
            simulate,
        ),
        node("ampc_ros", "planner", [arguments_of(DRIVE), follows_clock]),
        node("ampc_ros", "controller", [arguments_of(control), follows_clock]),
        node(
            "ampc_msgs_config", "recorder", [{"output": argument("record")}, follows_clock], record
        ),
    ]
    together = [
        RegisterEventHandler(OnProcessExit(target_action=each, on_exit=EmitEvent(event=Shutdown())))
        for each in nodes
    ]
    return LaunchDescription([*arguments, *together, *nodes])


def argument(name: str) -> ParameterValue:
    """A launch argument as a node's parameter."""
    return ParameterValue(LaunchConfiguration(name), value_type=TYPES.get(name, str))


def arguments_of(names: tuple[str, ...]) -> dict[str, ParameterValue]:
    """Launch arguments as parameters of the same names."""
    return {name: argument(name) for name in names}


def node(
    package: str,
    executable: str,
    parameters: list[dict[str, ParameterValue]],
    condition: IfCondition | UnlessCondition | None = None,
) -> Node:
    """A node in the chosen namespace, its log on the screen."""
    return Node(
        package=package,
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=parameters,
        condition=condition,
        output="screen",
    )
