"""Environment of ROS processes, with and without a sourced ROS 2."""

import os
from pathlib import Path

PROFILES = Path(__file__).with_name("fastdds.xml")


def ros_environment() -> dict[str, str]:
    """Return the environment of this process with the variables that its nodes need.

    Topics stay on this computer, unless the environment selects another discovery range. The ROS
    wheels contain only one middleware, which gets a profile for one computer; where ROS 2 itself
    is sourced, its middleware is not changed.
    """
    environment = dict(os.environ)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if "ROS_DISTRO" not in environment:
        environment["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
        environment.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILES))
    return environment
