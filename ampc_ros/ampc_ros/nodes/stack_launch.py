"""Launch description of a stack: what the files `with_<stack>.launch.py` return."""

from importlib import import_module
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
    launch, actions = import_module("launch"), import_module("launch.actions")
    sources = import_module("launch.launch_description_sources")
    remap = import_module("launch_ros.actions").SetRemap
    declare = actions.DeclareLaunchArgument
    stack = load_stack(name)
    arguments = {RENAMED.get(key, key): each for key, each in as_text(stack.parameters).items()}
    return launch.LaunchDescription(
        [
            *(declare(key, description=f"{name} needs it") for key in stack.required),
            *(
                declare(key, default_value=each, description=f"as {name} needs it")
                for key, each in (REAL | arguments).items()
            ),
            *(remap(src=ours, dst=theirs) for ours, theirs in stack.remappings.items()),
            actions.IncludeLaunchDescription(
                sources.PythonLaunchDescriptionSource(str(folder / "ampc.launch.py"))
            ),
        ]
    )
