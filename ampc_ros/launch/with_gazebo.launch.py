"""Connect controller, planner and gate to the stack gazebo; see doc/stacks.md."""

from pathlib import Path

from launch import LaunchDescription

from ampc_ros.nodes.stack_launch import describe_stack


def generate_launch_description() -> LaunchDescription:
    """Start the nodes with the parameters and topics of the stack."""
    return describe_stack("gazebo", Path(__file__).parent)
