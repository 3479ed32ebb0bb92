"""Start simulator, planner, controller, gate and markers, and a recorder on request.

``ros2 launch ampc_ros ampc.launch.py scenario:=sc2 output:=runs/sc2`` drives a scenario in
lock-step. On a real car, use ``simulate:=false lock_step:=false``. Topics stay on this machine
unless the environment variable is set: ``ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET ros2 launch ...``.
"""

from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from ampc_msgs_config import topics
from ampc_msgs_config.config import shipped_or_file

RECORDER_TIMEOUT = "15"
"""Wall time that the recorder has to close its bag, before launch sends SIGTERM [s]."""
ARGUMENTS = {
    "scenario": ("sc1", shipped_or_file("scenarios")),
    "path": ("", "CSV of x_m,y_m[,v_mps] or t_s,x_m,y_m instead of a scenario"),
    "speed": ("-1.0", "constant speed [m/s]; -1: that of scenario or CSV"),
    "lateral_acceleration": (
        "-1.0",
        "largest one along the CSV's path [m/s2]; -1: speed of the CSV",
    ),
    "laps": ("1", "number of laps of a CSV's closed path"),
    "columns": ("", "columns of the CSV, such as x=3,y=4; empty: by its header"),
    "vehicle": ("paper", shipped_or_file("vehicles")),
    "controller": ("preview", "preview, paper, classic, pure_pursuit, or FILE.py:CLASS"),
    "settings": ("table3", f"limits and solver: {shipped_or_file('controllers')}"),
    "gain_table": ("", f"gains: {shipped_or_file('gains')}; empty: the controller's own"),
    "guard": ("road", f"limits of every command: {shipped_or_file('guards')}"),
    "static_path": ("true", "the path is published once and does not grow old"),
    "base_link_to_cg": ("-1.0", "distance from odom to the centre of gravity [m]; -1: rear axle"),
    "fixed_frame": ("", "frame of path and odom; empty: that of the first odom"),
    "require_certificate": ("false", "reject a gain table without a valid certificate"),
    "friction": ("-1.0", "friction of the road; -1: that of the tyres"),
    "noise": ("", f"noise of the measurement: {shipped_or_file('noise')}; empty: none"),
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
    "use_sim_time": ("false", "follow /clock, as beside another simulator or a played bag"),
    "params_file": (
        "",
        "YAML file of parameters, which hold instead of the arguments; empty: none",
    ),
    "simulate": ("true", "start the simulator; false for a real car"),
    "planner": ("true", "start the planner; false: another node publishes the path"),
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
SWITCHES = (
    "lock_step",
    "static_path",
    "require_certificate",
    "store_estimates",
    "use_sim_time",
    "simulate",
    "planner",
    "gate",
)
TYPES = dict.fromkeys(FLOATS, float) | {"seed": int, "laps": int} | dict.fromkeys(SWITCHES, bool)
TYPE_NAMES = {float: "a number", int: "a whole number", bool: "true or false"}
TRUTH = {"true": True, "1": True, "false": False, "0": False}

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
    return LaunchDescription([*arguments, local_discovery(), OpaqueFunction(function=start)])


def local_discovery() -> SetEnvironmentVariable:
    """Keep topics on this machine unless the environment variable is set."""
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    return SetEnvironmentVariable(name, EnvironmentVariable(name, default_value="LOCALHOST"))


def start(context: LaunchContext) -> list[Any]:
    """Return the nodes for the arguments of a launch, and what ends them together.

    Raises:
        ValueError: An argument has a wrong value; the message names it.
    """
    texts = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    nodes = nodes_for({name: parsed(name, text) for name, text in texts.items()})
    together = [
        RegisterEventHandler(OnProcessExit(target_action=each, on_exit=EmitEvent(event=Shutdown())))
        for name, each in nodes.items()
        if name != "markers"
    ]
    return [*together, *nodes.values()]


def parsed(argument: str, text: str) -> Any:
    """Return the value of a launch argument.

    Raises:
        ValueError: The text is not of its type, or names a file that does not exist.
    """
    kind = TYPES.get(argument, str)
    try:
        value = TRUTH[text.lower()] if kind is bool else kind(text)
    except (KeyError, ValueError):
        message = f"launch argument {argument}:={text} must be {TYPE_NAMES[kind]}"
        raise ValueError(message) from None
    if argument == "params_file" and text and not Path(text).is_file():
        raise ValueError(f"launch argument {argument}:={text} must be a file")
    return value


def nodes_for(values: dict[str, Any]) -> dict[str, Node]:
    """Return the nodes for the values of all arguments, by their names."""

    def chosen(*names: str, **further: Any) -> dict[str, Any]:
        return {name: values[name] for name in names} | further

    def node(
        package: str, name: str, parameters: dict[str, Any], renamed: Any = (), **options: Any
    ) -> Node:
        # a text that looks like a number stays a text
        typed = {
            key: ParameterValue(value, value_type=type(value)) for key, value in parameters.items()
        }
        return Node(
            package=package,
            executable=name,
            namespace=values["namespace"],
            parameters=[typed, *filter(None, [values["params_file"]])],
            remappings=[*renamed, *clock],
            output="screen",
            **options,
        )

    lock_step, simulated_time = values["lock_step"], values["use_sim_time"]
    clock = [(topics.CLOCK, "clock")] if lock_step else []  # each car has its own
    mode = chosen("lock_step", "use_sim_time", wait_for_recorder=bool(values["output"]))
    owner = mode | {"use_sim_time": simulated_time and not lock_step}
    record = chosen("output", *PICTURE, use_sim_time=simulated_time or lock_step)
    look = chosen("lock_step", "use_sim_time", *PICTURE)
    from_gate = [
        (topics.STEERING_COMMAND, topics.GATE_STEERING),
        (topics.TARGET_SPEED, topics.GATE_SPEED),
    ]
    nodes = {"controller": node("ampc_ros", "controller", mode | chosen(*CONTROL))}
    if values["simulate"]:
        renamed = from_gate if values["gate"] else []
        plant = owner | chosen(*ROUTE, *PLANT)
        nodes["simulator"] = node("sim_vehicle", "simulator", plant, renamed)
    if values["planner"]:
        nodes["planner"] = node(
            "ampc_ros", "planner", mode | chosen(*ROUTE, "fixed_frame", "follow")
        )
    if values["gate"]:
        passed_on = mode | chosen(*GATE, output=values["drive_output"])
        nodes["gate"] = node("ampc_ros", "gate", passed_on)
    if values["output"]:
        nodes["recorder"] = node(
            "ampc_msgs_config", "recorder", record, sigterm_timeout=RECORDER_TIMEOUT
        )
    nodes["markers"] = node("ampc_msgs_config", "markers", look)
    return nodes
