"""Launch description of a stack: what the files `with_<stack>.launch.py` return."""

from pathlib import Path
from typing import Any

from ampc_msgs_config.stack_file import as_text, load_stack

RENAMED = {"output": "drive_output"}
"""Launch arguments of other names than the parameter: `output` is the folder of the recording."""
REAL = {"simulate": "false", "lock_step": "false"}


def describe_stack(name: str, folder: Path) -> Any:
    """Return ampc.launch.py with the arguments and remappings of a stack as defaults.

    Args:
        name: Shipped stack.
        folder: Folder of ampc.launch.py.

    Raises:
        ValueError: File, key and value.
    """
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
    from launch.launch_description_sources import PythonLaunchDescriptionSource
    from launch_ros.actions import SetRemap

    stack = load_stack(name)
    arguments = {RENAMED.get(key, key): each for key, each in as_text(stack.parameters).items()}
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(key, default_value=each, description=f"as {name} needs it")
                for key, each in (REAL | arguments).items()
            ),
            *(SetRemap(src=ours, dst=theirs) for ours, theirs in stack.remappings.items()),
            IncludeLaunchDescription(PythonLaunchDescriptionSource(str(folder / "ampc.launch.py"))),
        ]
    )
