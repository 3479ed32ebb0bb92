"""Starts simulator, planner and controller, and a recording on request.

``ros2 launch ampc_ros ampc.launch.py scenario:=sc2 output:=runs/sc2`` drives a scenario in
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
    "output": ("", "new folder for a recording; empty for none"),
}
TYPES = {"speed": float, "time_out": float, "lock_step": bool}
DRIVE = ("vehicle", "scenario", "path", "speed", "lock_step")


def generate_launch_description() -> LaunchDescription:
    """Declares the arguments and starts the nodes; when one node ends, all end."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=description)
        for name, (value, description) in ARGUMENTS.items()
    ]
    simulate = IfCondition(LaunchConfiguration("simulate"))
    record = UnlessCondition(EqualsSubstitution(LaunchConfiguration("output"), ""))
    nodes = [
        node("sim_vehicle", "simulator", (*DRIVE, "time_out"), simulate),
        node("ampc_ros", "planner", DRIVE),
        node("ampc_ros", "controller", ("vehicle", "controller", "gain_table", "lock_step")),
        node("ampc_msgs_config", "recorder", ("output",), record),
    ]
    together = [
        RegisterEventHandler(OnProcessExit(target_action=each, on_exit=EmitEvent(event=Shutdown())))
        for each in nodes
    ]
    return LaunchDescription([*arguments, *together, *nodes])


def node(
    package: str,
    executable: str,
    names: tuple[str, ...],
    condition: IfCondition | UnlessCondition | None = None,
) -> Node:
    """A node whose parameters are the launch arguments of these names; lock-step simulates time."""
    parameters = {name: argument(name) for name in names}
    parameters["use_sim_time"] = argument("lock_step")
    return Node(
        package=package,
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[parameters],
        condition=condition,
        output="screen",
    )


def argument(name: str) -> ParameterValue:
    """A launch argument as the value of a parameter."""
    return ParameterValue(LaunchConfiguration(name), value_type=TYPES.get(name, str))
