"""The environment of ROS processes, in a sourced shell and without one."""

import os
from pathlib import Path

PROFILES = Path(__file__).with_name("fastdds.xml")


def ros_environment() -> dict[str, str]:
    """Gives this process's environment, completed for the nodes that it starts.

    The ROS wheels bring one middleware only, share one computer by default, and get settings of
    that middleware that suit it. Where ROS 2 itself is sourced, its settings stay as they are.
    """
    environment = dict(os.environ)
    if "ROS_DISTRO" not in environment:
        environment["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
        environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        environment.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILES))
    return environment
