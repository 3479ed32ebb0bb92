"""Message definitions of other stacks, field by field, and their published type hashes.

Names, order and types of the fields are those of the public repositories:

* ros-drivers/ackermann_msgs, branch ros2, commit f61ddd8
* autowarefoundation/autoware_msgs 1.12.0, commit 7025d8f
* carla-simulator/ros-carla-msgs, commit 081fdcd
* ros2/geometry2, tf2_msgs
"""

PACKAGES = {
    "ackermann_msgs": {
        "AckermannDrive": """
            float32 steering_angle
            float32 steering_angle_velocity
            float32 speed
            float32 acceleration
            float32 jerk
        """,
        "AckermannDriveStamped": """
            std_msgs/Header header
            AckermannDrive drive
        """,
    },
    "autoware_control_msgs": {
        "Lateral": """
            builtin_interfaces/Time stamp
            builtin_interfaces/Time control_time
            float32 steering_tire_angle
            float32 steering_tire_rotation_rate
            bool is_defined_steering_tire_rotation_rate
        """,
        "Longitudinal": """
            builtin_interfaces/Time stamp
            builtin_interfaces/Time control_time
            float32 velocity
            float32 acceleration
            float32 jerk
            bool is_defined_acceleration
            bool is_defined_jerk
        """,
        "Control": """
            builtin_interfaces/Time stamp
            builtin_interfaces/Time control_time
            Lateral lateral
            Longitudinal longitudinal
        """,
    },
    "autoware_planning_msgs": {
        "TrajectoryPoint": """
            builtin_interfaces/Duration time_from_start
            geometry_msgs/Pose pose
            float32 longitudinal_velocity_mps
            float32 lateral_velocity_mps
            float32 acceleration_mps2
            float32 heading_rate_rps
            float32 front_wheel_angle_rad
            float32 rear_wheel_angle_rad
        """,
        "Trajectory": """
            std_msgs/Header header
            autoware_planning_msgs/TrajectoryPoint[] points
        """,
    },
    "autoware_vehicle_msgs": {
        "SteeringReport": """
            builtin_interfaces/Time stamp
            float32 steering_tire_angle
        """,
        "VelocityReport": """
            std_msgs/Header header
            float32 longitudinal_velocity
            float32 lateral_velocity
            float32 heading_rate
        """,
    },
    "carla_msgs": {
        "CarlaEgoVehicleControl": """
            std_msgs/Header header
            float32 throttle
            float32 steer
            float32 brake
            bool hand_brake
            bool reverse
            int32 gear
            bool manual_gear_shift
        """,
        "CarlaEgoVehicleStatus": """
            std_msgs/Header header
            float32 velocity
            geometry_msgs/Accel acceleration
            geometry_msgs/Quaternion orientation
            CarlaEgoVehicleControl control
        """,
        "CarlaEgoVehicleInfoWheel": """
            float32 tire_friction
            float32 damping_rate
            float32 max_steer_angle
            float32 radius
            float32 max_brake_torque
            float32 max_handbrake_torque
            geometry_msgs/Vector3 position
        """,
        "CarlaEgoVehicleInfo": """
            uint32 id
            string type
            string rolename
            CarlaEgoVehicleInfoWheel[] wheels
            float32 max_rpm
            float32 moi
            float32 damping_rate_full_throttle
            float32 damping_rate_zero_throttle_clutch_engaged
            float32 damping_rate_zero_throttle_clutch_disengaged
            bool use_gear_autobox
            float32 gear_switch_time
            float32 clutch_strength
            float32 mass
            float32 drag_coefficient
            geometry_msgs/Vector3 center_of_mass
        """,
    },
    "tf2_msgs": {
        "TFMessage": """
            geometry_msgs/TransformStamped[] transforms
        """,
    },
}
"""`.msg` text of each message by package and name; messages inside a message come before it."""

PUBLISHED_HASHES = {
    "ackermann_msgs/msg/AckermannDrive": (
        "RIHS01_acf287a224a947dd1b0b87d6d76cdb73f497b0237b8fc73be2173b2ebbb82c99"
    ),
    "ackermann_msgs/msg/AckermannDriveStamped": (
        "RIHS01_48ca7612a08d3bb72744fd98b71b7cf2ea24c6ad50fa4e1aa0bbad963c90d8cf"
    ),
    "autoware_control_msgs/msg/Control": (
        "RIHS01_7818be59aa790ebb777db06e55a2c15e3756de4cc35c80b1e8271afc5bab2e9d"
    ),
    "autoware_vehicle_msgs/msg/SteeringReport": (
        "RIHS01_aa3acc9ca95ebc4daf9dec0ecf87911ad9c196392857c3026bfead589db65a94"
    ),
    "autoware_vehicle_msgs/msg/VelocityReport": (
        "RIHS01_9052adda949c32f4a98500abc1fb5bd23f2560e321eebdfbb25318d6108d4ce4"
    ),
    "carla_msgs/msg/CarlaEgoVehicleControl": (
        "RIHS01_4f251fa2a554e8ed996f77eb1d5b65515af1369eceb04d5122cb5761f7801be3"
    ),
    "carla_msgs/msg/CarlaEgoVehicleInfo": (
        "RIHS01_b8dc3866014924ce7fe57e0cff05a5448ec18f27156656b3b1b69f4da558e956"
    ),
    "carla_msgs/msg/CarlaEgoVehicleInfoWheel": (
        "RIHS01_63caae9f2637752b93a616b10e00d21be15ca32cac533efd3596349a5cf4d4fe"
    ),
    "carla_msgs/msg/CarlaEgoVehicleStatus": (
        "RIHS01_3565cc74470f5c37eb316a36426effd811ac1baf835df3fc2bb7a88574bb3e07"
    ),
    "tf2_msgs/msg/TFMessage": (
        "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    ),
}
"""Type hashes of the real packages, read in files that their builds have generated:

* ackermann_msgs, tf2_msgs: `*__description.c` of public workspaces
* autoware_*_msgs: table of type hashes of a public DDS driver that talks to Autoware
* carla_msgs: `install/carla_msgs/share/carla_msgs/msg/*.json` of wijekim/CARLA-simulator
"""


def type_names() -> list[str]:
    """Return the names of all message types, such as `tf2_msgs/msg/TFMessage`."""
    return [f"{package}/msg/{name}" for package, texts in PACKAGES.items() for name in texts]
