"""Messages of packages that are imported only when a parameter selects them."""

import importlib
from typing import Any


def import_message(package: str, name: str, needed_by: str) -> Any:
    """Return the class of a message.

    Args:
        package: Package, such as ackermann_msgs.
        name: Message, such as AckermannDrive.
        needed_by: Parameter and value that need it, such as "output = ackermann".

    Raises:
        ValueError: The package is not installed, or has no such message; with the remedy.
    """
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ModuleNotFoundError:
        apt = f"sudo apt install ros-jazzy-{package.replace('_', '-')}"
        raise ValueError(
            f"{needed_by} needs the package {package}, which is not installed: {apt}, or build it "
            "from source and source its workspace"
        ) from None
    except AttributeError:
        raise ValueError(f"{needed_by} needs {package}/{name}, which {package} lacks") from None
