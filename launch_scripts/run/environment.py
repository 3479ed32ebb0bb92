"""The environment of ROS processes, in a sourced shell and without one."""

import os
from pathlib import Path

PROFILES = Path(__file__).with_name("fastdds.xml")


def ros_environment() -> dict[str, str]:
    """Gives this process's environment, completed for the nodes that it starts.

    Topics stay on this computer, unless the environment says otherwise. The ROS wheels
    bring one middleware only, and get settings of it that suit one computer; where ROS 2 itself is
    sourced, its middleware stays as it is.
    """
    environment = dict(os.environ)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if "ROS_DISTRO" not in environment:
        environment["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
        environment.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILES))
    return environment
