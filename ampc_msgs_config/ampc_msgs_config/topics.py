"""Names of topics, frames and published quantities; needs neither ROS nor compiled code."""

from ampc_msgs_config.types import RECORD_QUANTITIES, Diagnosis

ODOM = "odom"
REFERENCE_PATH = "reference_path"
TARGET_SPEED = "target_speed"
STEERING_COMMAND = "steering_command"
STEERING_STATE = "steering_state"
STEERING_REPORT = "steering_report"
"""Measured angle in the message type of a car; the gate publishes it as `steering_state`."""
TRAJECTORY = "trajectory"
"""Path with speeds in the message type of another stack; the planner publishes both."""
STEERING_PLAN = "steering_plan"
"""How to steer until the car stands, one trajectory_msgs/JointTrajectory with PLAN_JOINTS."""
PREDICTED_PATH = "predicted_path"
WIND = "wind"
STOP_REQUEST = "stop_request"
"""Latched std_msgs/Bool: request of controller or gate that the car stops."""
TICK = "controller/tick"
"""Inputs and decisions of a tick by name, one sensor_msgs/JointState with the command's stamp."""
DRIVE_COMMAND = "drive_command"
"""What the car receives from the gate: speed and yaw rate, one geometry_msgs/TwistStamped."""
GATE_STEERING, GATE_SPEED = "gate/steering_command", "gate/target_speed"
"""The same as steering angle and speed, for a car that reads them separately."""
GATE_STATE = "gate/state"
"""Latched std_msgs/String: state of the gate in one word."""
GATE_HEARTBEAT = "gate/heartbeat"
"""std_msgs/UInt64: number of rounds of the gate, in each round."""
MEMORY = "controller/memory"
"""Latched std_msgs/UInt8MultiArray: all that the controller remembers, every 2 s."""
CONFIGURATION = "configuration"
"""Below each node: latched std_msgs/String, YAML document from which the run can be repeated."""
MARKERS = "markers"
FAULTED = (ODOM, STEERING_STATE, REFERENCE_PATH)
"""Topics that the controller receives from the injector during fault injection."""
FAULTY = "faulty/"
"""Prefix of inputs that the fault injector has passed on to the controller."""
CLOCK = "/clock"
DIAGNOSTICS = "/diagnostics"
PARAMETER_EVENTS = "/parameter_events"
ROSOUT = "/rosout"
TF = "/tf"
TF_STATIC = "/tf_static"
DEBUG_QUANTITIES = (*Diagnosis._fields, "solve_time", "timer_lateness")
"""Topics below `~/debug/` of the controller, one std_msgs/Float64 each."""
ACCOUNT = ("rejected_inputs", "missed_ticks", "commands")
"""Counters since the controller was configured."""
TICK_QUANTITIES = (*DEBUG_QUANTITIES, *RECORD_QUANTITIES, *ACCOUNT)
"""Names in `controller/tick`."""
QUANTITIES = tuple(f"controller/debug/{name}" for name in DEBUG_QUANTITIES)
CONFIGURATIONS = tuple(f"{name}/{CONFIGURATION}" for name in ("controller", "simulator", "planner"))

MAP = "map"
BASE_LINK = "base_link"
STEERING_JOINT = "front_steering"
PLAN_JOINTS = (STEERING_JOINT, "distance", "x", "y")
"""Joints of `steering_plan`: angle as in `steering_command`; distance driven [m], with speed and
acceleration; place of `base_link` on the path [m]."""
