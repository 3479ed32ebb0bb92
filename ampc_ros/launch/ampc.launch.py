"""Starts simulator, planner and controller, and the recorder on request.

``ros2 launch ampc_ros ampc.launch.py scenario:=sc1 vehicle:=ordinary record:=true`` drives a
scenario. On a real car, ``simulate:=false lock_step:=false`` leaves the simulator out.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "scenario": ("sc1", "name of a shipped scenario, or a YAML file"),
    "path": ("", "CSV file of a path to drive instead of the scenario's; empty for none"),
    "vehicle": ("paper", "name of a shipped vehicle, or a YAML file"),
    "controller": ("paper", "paper, classic or pure_pursuit"),
    "gain_table": ("table3", "name of a shipped gain table, or a YAML file"),
    "lock_step": ("true", "simulated time advances only when all commands have arrived"),
    "namespace": ("", "namespace of the nodes and of their topics"),
    "simulate": ("true", "start the simulator; false where a real car drives"),
    "record": ("false", "record the run"),
}
LOCK_STEP = ParameterValue(LaunchConfiguration("lock_step"), value_type=bool)


def generate_launch_description() -> LaunchDescription:
    """Declares the arguments and starts the nodes; when one ends, all end."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=description)
        for name, (value, description) in ARGUMENTS.items()
    ]
    nodes = [
        node("sim_vehicle", "simulator", "scenario", only_if="simulate"),
        node("ampc_ros", "planner", "scenario", "path", use_sim_time=LOCK_STEP),
        node("ampc_ros", "controller", "controller", "gain_table", use_sim_time=LOCK_STEP),
        node("ampc_msgs_config", "recorder", use_sim_time=LOCK_STEP, only_if="record"),
    ]
    together = [
        RegisterEventHandler(OnProcessExit(target_action=each, on_exit=EmitEvent(event=Shutdown())))
        for each in nodes
    ]
    return LaunchDescription([*arguments, *together, *nodes])


def node(
    package: str,
    executable: str,
    *names: str,
    use_sim_time: ParameterValue | bool = False,
    only_if: str | None = None,
) -> Node:
    """A node whose parameters ``names`` come from the launch arguments of the same names."""
    parameters = {
        name: ParameterValue(LaunchConfiguration(name), value_type=str)
        for name in ("vehicle", *names)
    }
    return Node(
        package=package,
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[parameters, {"lock_step": LOCK_STEP, "use_sim_time": use_sim_time}],
        condition=IfCondition(LaunchConfiguration(only_if)) if only_if else None,
        output="screen",
    )
