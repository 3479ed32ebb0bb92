"""The environment of ROS processes, in a sourced shell and without one."""

import os


def ros_environment() -> dict[str, str]:
    """Gives this process's environment, completed for the nodes that it starts.

    The ROS wheels bring one middleware only and share one computer by default. Where ROS 2 itself
    is sourced, its settings stay as they are.
    """
    environment = dict(os.environ)
    if "ROS_DISTRO" not in environment:
        environment["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
        environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return environment
