"""Start simulator, planner, controller, gate and markers, and a recorder on request.

``ros2 launch ampc_ros ampc.launch.py scenario:=sc2 output:=runs/sc2`` drives a scenario in
lock-step. On a real car, use ``simulate:=false lock_step:=false``. Topics stay on this machine
unless the environment variable is set: ``ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET ros2 launch ...``.
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
    IfElseSubstitution,
    LaunchConfiguration,
    NotEqualsSubstitution,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from ampc_msgs_config import topics
from ampc_msgs_config.config import shipped


def file_or(folder: str) -> str:
    """Return the description of an argument that takes a shipped name or a file."""
    return f"YAML file, or one of {', '.join(shipped(folder))}"


ARGUMENTS = {
    "scenario": ("sc1", file_or("scenarios")),
    "path": ("", "CSV of x_m,y_m[,v_mps] or t_s,x_m,y_m instead of a scenario"),
    "speed": ("-1.0", "constant speed [m/s]; -1: that of scenario or CSV"),
    "lateral_acceleration": (
        "-1.0",
        "largest one along the CSV's path [m/s2]; -1: speed of the CSV",
    ),
    "laps": ("1", "number of laps of a CSV's closed path"),
    "columns": ("", "columns of the CSV, such as x=3,y=4; empty: by its header"),
    "vehicle": ("paper", file_or("vehicles")),
    "controller": ("preview", "preview, paper, classic, pure_pursuit, or FILE.py:CLASS"),
    "settings": ("table3", f"limits and solver: {file_or('controllers')}"),
    "gain_table": ("", f"gains: {file_or('gains')}; empty: the controller's own"),
    "guard": ("road", f"limits of every command: {file_or('guards')}"),
    "static_path": ("true", "the path is published once and does not grow old"),
    "base_link_to_cg": ("-1.0", "distance from odom to the centre of gravity [m]; -1: rear axle"),
    "fixed_frame": ("", "frame of path and odom; empty: that of the first odom"),
    "require_certificate": ("false", "reject a gain table without a valid certificate"),
    "friction": ("-1.0", "friction of the road; -1: that of the tyres"),
    "noise": ("", f"noise of the measurement: {file_or('noise')}; empty: none"),
    "seed": ("0", "seed of the noise"),
    "store_estimates": ("true", "start with the car's estimates of the last drive, in real time"),
    "follow": ("none", "path of another planner: path, timed_path or autoware; none: our own"),
    "drive_output": (
        "twist_stamped",
        "type of drive_command: twist, twist_stamped, ackermann, ackermann_stamped, autoware or "
        "carla",
    ),
    "feedback": (
        "none",
        "type of steering_report: joint_state, autoware, ackermann, ackermann_stamped; none: the "
        "car publishes steering_state, or measures nothing",
    ),
    "feedback_joints": ("", "joints of steering_report whose mean is the angle; empty: the only"),
    "lock_step": ("true", "simulated time advances only when every state is answered"),
    "time_out": ("10.0", "timeout for a node's answer [s]"),
    "start_time_out": ("180.0", "timeout for the start of all nodes, with compilation [s]"),
    "namespace": ("", "namespace of nodes and topics"),
    "frame_prefix": ("", "prefix of the car's frames, such as car1/; empty: the namespace"),
    "simulate": ("true", "start the simulator; false for a real car"),
    "gate": ("true", "start the gate, the last station before the car; false: without it"),
    "output": ("", "new folder for a recording; empty: none"),
}
FLOATS = (
    "speed",
    "lateral_acceleration",
    "base_link_to_cg",
    "friction",
    "time_out",
    "start_time_out",
)
SWITCHES = ("lock_step", "static_path", "require_certificate", "store_estimates")
TYPES = dict.fromkeys(FLOATS, float) | {"seed": int, "laps": int} | dict.fromkeys(SWITCHES, bool)

ROUTE = ("vehicle", "scenario", "path", "speed", "lateral_acceleration", "laps", "columns")
PLANT = ("friction", "noise", "seed", "time_out", "start_time_out")
PICTURE = ("vehicle", "base_link_to_cg", "frame_prefix")
GATE = ("vehicle", "guard", "settings", "feedback", "feedback_joints")
CONTROL = (
    "vehicle",
    "controller",
    "settings",
    "gain_table",
    "guard",
    "static_path",
    "base_link_to_cg",
    "fixed_frame",
    "require_certificate",
    "store_estimates",
)


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the nodes; the end of one, except markers, ends all."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    ]
    simulated = IfCondition(LaunchConfiguration("simulate"))
    recorded = NotEqualsSubstitution(LaunchConfiguration("output"), "")
    mode = parameters("lock_step") | {
        "wait_for_recorder": ParameterValue(recorded, value_type=bool)
    }
    record = parameters("output", *PICTURE) | {"use_sim_time": parameter("lock_step")}
    gated = LaunchConfiguration("gate")
    drive = {"output": parameter("drive_output")}
    renamed = [
        (topic, IfElseSubstitution(gated, new, topic))
        for topic, new in (
            (topics.STEERING_COMMAND, topics.GATE_STEERING),
            (topics.TARGET_SPEED, topics.GATE_SPEED),
        )
    ]
    nodes = [
        node("sim_vehicle", "simulator", mode | parameters(*ROUTE, *PLANT), simulated, renamed),
        node("ampc_ros", "planner", mode | parameters(*ROUTE, "fixed_frame", "follow")),
        node("ampc_ros", "controller", mode | parameters(*CONTROL)),
        node("ampc_ros", "gate", mode | parameters(*GATE) | drive, IfCondition(gated)),
        node("ampc_msgs_config", "recorder", record, IfCondition(recorded)),
    ]
    together = [
        RegisterEventHandler(OnProcessExit(target_action=each, on_exit=EmitEvent(event=Shutdown())))
        for each in nodes
    ]
    look = parameters("lock_step", *PICTURE)
    markers = node("ampc_msgs_config", "markers", look)
    return LaunchDescription([*arguments, local_discovery(), *together, *nodes, markers])


def local_discovery() -> SetEnvironmentVariable:
    """Keep topics on this machine unless the environment variable is set."""
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    return SetEnvironmentVariable(name, EnvironmentVariable(name, default_value="LOCALHOST"))


def parameter(argument: str) -> ParameterValue:
    """Return a launch argument as the value of a node's parameter."""
    return ParameterValue(LaunchConfiguration(argument), value_type=TYPES.get(argument, str))


def parameters(*names: str) -> dict[str, ParameterValue]:
    """Return launch arguments as parameters of the same names."""
    return {name: parameter(name) for name in names}


def node(
    package: str,
    executable: str,
    values: dict[str, ParameterValue],
    condition: IfCondition | None = None,
    renamed: list[tuple[str, IfElseSubstitution]] | None = None,
) -> Node:
    """Return a node in the chosen namespace with its log on the screen; lock-step has its clock."""
    clock = IfElseSubstitution(LaunchConfiguration("lock_step"), "clock", topics.CLOCK)
    return Node(
        package=package,
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[values],
        condition=condition,
        remappings=[*(renamed or []), (topics.CLOCK, clock)],
        output="screen",
    )
