"""Memory of a supervisor as bytes, from which a replay continues in the middle of a drive.

A recorder that joins a drive has not seen the earlier ticks, and what they left in the estimators
never fades completely. So the controller publishes its memory every 2 s.
"""

import io
import pickle
import zlib
from typing import Any, BinaryIO

import numpy as np

from ampc_ros.configuration import Configuration
from ampc_ros.mpc.small_matrices import Scratch, make_scratch
from ampc_ros.supervision.supervisor import Supervisor

CHECKSUM_SIZE = 4
"""Length of the checksum in front of the content [bytes]."""
PACKAGES = (
    *("ampc_ros.supervision.", "ampc_ros.estimation.", "ampc_ros.preview.", "ampc_ros.paper."),
    *("ampc_ros.mpc.", "ampc_msgs_config.paths."),
)
MODULES = (
    *("ampc_ros.assumed_car", "ampc_ros.configuration", "ampc_ros.pure_pursuit"),
    *("ampc_msgs_config.parameters", "ampc_msgs_config.types"),
)
ARRAY: Any = np.empty(0)
NUMBER: Any = np.float64(0.0)
FUNCTIONS: tuple[Any, ...] = (
    make_scratch,
    ARRAY.__reduce__()[0],
    ARRAY.__reduce_ex__(pickle.HIGHEST_PROTOCOL)[0],
    NUMBER.__reduce__()[0],
)
"""Functions that rebuild arrays and numbers."""
VARIABLE = ("angles",)
"""Attributes whose size changes during a drive."""


class Pickler(pickle.Pickler):
    """Writes a supervisor without the contents of its scratch arrays."""

    def reducer_override(self, obj: Any) -> Any:
        """Replace scratch arrays by new ones."""
        if isinstance(obj, Scratch):
            return make_scratch, (len(obj.numbers),)
        return NotImplemented


class Unpickler(pickle.Unpickler):
    """Reads a supervisor; other classes and functions than those of a controller are refused."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a class that a memory may contain.

        Raises:
            ValueError: It may not.
        """
        if (module, name) in (("collections", "deque"), ("numpy", "dtype"), ("numpy", "ndarray")):
            return super().find_class(module, name)
        for each in FUNCTIONS:
            if (each.__module__, each.__qualname__) == (module, name):
                return each
        if module.startswith(PACKAGES) or module in MODULES:
            found = super().find_class(module, name)
            if isinstance(found, type) and found.__module__ == module:
                return found
        raise ValueError(f"a memory must not contain {module}.{name}")


def store(supervisor: Supervisor) -> bytes:
    """Return the memory of a supervisor after a tick; empty: the controller is that of a user."""
    if supervisor.controller.formulation == "custom":
        return b""
    stream = io.BytesIO()
    Pickler(stream, pickle.HIGHEST_PROTOCOL).dump(supervisor)
    content = stream.getvalue()
    return zlib.crc32(content).to_bytes(CHECKSUM_SIZE, "little") + content


def restore(data: bytes, config: Configuration) -> Supervisor:
    """Return the supervisor with a stored memory.

    Args:
        data: Result of `store`.
        config: Configuration whose supervisor has the same structure.

    Raises:
        ValueError: The data are damaged, or those of another version or configuration.
    """
    checksum, content = data[:CHECKSUM_SIZE], data[CHECKSUM_SIZE:]
    if zlib.crc32(content).to_bytes(CHECKSUM_SIZE, "little") != checksum:
        raise ValueError("the memory of the controller is damaged")
    try:
        stream: BinaryIO = io.BytesIO(content)
        found = Unpickler(stream).load()
    except Exception as error:
        raise ValueError(f"the memory of the controller cannot be read: {error}") from error
    if not has_structure_of(Supervisor(config), found):
        raise ValueError("the memory of the controller is that of another version")
    return found  # type: ignore[no-any-return]


def has_structure_of(expected: Any, found: Any) -> bool:
    """Return whether an object has the attributes and array shapes of another one."""
    if expected is None or found is None:
        return True
    if type(expected) is not type(found):
        return False
    if isinstance(expected, np.ndarray):
        return (expected.dtype, expected.shape) == (found.dtype, found.shape)
    if not hasattr(expected, "__dict__"):
        return True
    a, b = vars(expected), vars(found)
    if a.keys() != b.keys():
        return False
    return all(has_structure_of(a[name], b[name]) for name in a if name not in VARIABLE)
