"""Memory of a supervisor as data, from which a replay continues in the middle of a drive.

A recorder that joins a drive has not seen the earlier ticks, and what they left in the estimators
never fades completely. So the controller publishes its memory every 2 s: JSON with a checksum,
which is written into a new supervisor of the same configuration. It can hold numbers, arrays and
objects of CLASSES, but no code.
"""

import base64
import json
import zlib
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from ampc_msgs_config.paths.path import Path, Progress
from ampc_msgs_config.types import Diagnosis, Plan, VehicleState
from ampc_ros.assumed_car import AssumedCar, SteeringResponse
from ampc_ros.configuration import Configuration
from ampc_ros.estimation.command_history import SentCommand
from ampc_ros.mpc.small_matrices import Scratch
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Supervisor

CHECKSUM_SIZE = 4
"""Length of the checksum in front of the content [bytes]."""
CLASSES = {
    each.__name__: each
    for each in (
        *(AssumedCar, Diagnosis, Path, Plan, Progress, Received, SentCommand, SteeringResponse),
        VehicleState,
    )
}
"""Classes of values that a new supervisor does not have yet."""
NOT_STORED = ("_config", "_filter", "odometry", "_plan_start", "schedule")
"""Attributes of a supervisor that no replayed tick reads, as accepted states are in the recording,
and the learned schedule, which is in the configuration."""
MOST_SAMPLES = 20_000
"""Number of samples of the largest path that is stored; 5 km."""
VARIABLE = ("angles", "prediction", "_points")
"""Arrays whose size changes during a drive."""
KEEP = {"keep": True}
"""Stands for what a new supervisor has from its configuration."""


def store(supervisor: Supervisor) -> bytes:
    """Return the memory of a supervisor after a tick.

    Empty: the controller is that of a user, or the path is so large that this would delay a tick.
    """
    is_large = supervisor.path is not None and len(supervisor.path.value.x) > MOST_SAMPLES
    if is_large or supervisor.controller.formulation == "custom":
        return b""
    content = json.dumps([supervisor.number, to_data(supervisor, {})]).encode()
    return zlib.crc32(content).to_bytes(CHECKSUM_SIZE, "little") + content


def restore(data: bytes, config: Mapping[int, Configuration]) -> Supervisor:
    """Return a supervisor with a stored memory.

    Args:
        data: Result of `store`.
        config: Configurations by number.

    Raises:
        ValueError: The data are damaged, or those of another version or configuration.
    """
    checksum, content = data[:CHECKSUM_SIZE], data[CHECKSUM_SIZE:]
    if zlib.crc32(content).to_bytes(CHECKSUM_SIZE, "little") != checksum:
        raise ValueError("the memory of the controller is damaged")
    try:
        number, memory = json.loads(content)
        supervisor = Supervisor(config[number], number=number)
        from_data(memory, supervisor, "", [])
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise ValueError(f"the memory of the controller is of another version: {error}") from error
    return supervisor


def to_data(value: Any, seen: dict[int, int]) -> Any:
    """Return a value as data of JSON.

    Args:
        value: Number, array, collection or object.
        seen: Number of each object that has been converted, by its identity.
    """
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {"dict": [[key, to_data(item, seen)] for key, item in value.items()]}
    is_record = isinstance(value, tuple) and hasattr(value, "_fields")
    if isinstance(value, tuple) and not is_record:
        return {"tuple": [to_data(item, seen) for item in value]}
    if id(value) in seen:
        return {"same": seen[id(value)]}
    if isinstance(value, np.ndarray):
        seen[id(value)] = len(seen)
        text = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {"array": text, "type": value.dtype.str, "shape": value.shape}
    if isinstance(value, list | deque):
        seen[id(value)] = len(seen)
        items = [to_data(item, seen) for item in value]
        return {"list": items, "longest": getattr(value, "maxlen", -1)}
    fields = value._asdict() if is_record else getattr(value, "__dict__", {})
    if isinstance(value, Scratch) or hasattr(value, "__dataclass_fields__") or not fields:
        return KEEP
    seen[id(value)] = len(seen)
    stored = {name: to_data(each, seen) for name, each in fields.items() if name not in NOT_STORED}
    return {"object": type(value).__name__, "fields": stored}


def from_data(data: Any, like: Any, name: str, seen: list[Any]) -> Any:
    """Return a value from its data; objects of a new supervisor are changed in place.

    Args:
        data: Result of `to_data`.
        like: What a new supervisor has at this place; None: nothing.
        name: Name of the attribute.
        seen: Receives each object, in the order of `to_data`.

    Raises:
        ValueError: The data do not fit to the new supervisor.
    """
    if not isinstance(data, dict):
        return data
    if data == KEEP and like is not None:
        return like
    if "same" in data:
        return seen[data["same"]]
    if "tuple" in data:
        return tuple(from_data(item, None, name, seen) for item in data["tuple"])
    if "dict" in data:
        content = {key: from_data(item, None, name, seen) for key, item in data["dict"]}
        if isinstance(like, dict):  # several objects may refer to it
            like.clear()
            like.update(content)
            return like
        return content
    place = len(seen)
    seen.append(None)
    if "array" in data:
        seen[place] = array_of(data, like, name)
    elif "list" in data:
        items = [from_data(item, None, name, seen) for item in data["list"]]
        longest = data["longest"]
        seen[place] = items if longest == -1 else deque(items, longest)
    else:
        seen[place] = object_of(data, like, place, seen)
    return seen[place]


def array_of(data: Mapping[str, Any], like: Any, name: str) -> Any:
    """Return an array from its data.

    Raises:
        ValueError: Its type or shape is not that of the new supervisor.
    """
    shape = tuple(data["shape"])
    if data["type"] not in ("<f8", "<i8", "|b1"):
        raise ValueError(f"{name} has the type {data['type']}")
    array = np.frombuffer(base64.b64decode(data["array"]), data["type"]).reshape(shape).copy()
    is_fixed = isinstance(like, np.ndarray) and name not in VARIABLE
    if is_fixed and (like.dtype, like.shape) != (array.dtype, shape):
        raise ValueError(f"{name} has the shape {shape}, not {like.shape}")
    return array


def object_of(data: Mapping[str, Any], like: Any, place: int, seen: list[Any]) -> Any:
    """Return an object from its data: that of the new supervisor, or one of CLASSES.

    Raises:
        ValueError: Its class or its attributes are not those of the new supervisor.
    """
    kind, fields = data["object"], data["fields"]
    cls: Any = type(like) if type(like).__name__ == kind else CLASSES[kind]
    if not isinstance(like, cls):
        like = None
    if issubclass(cls, tuple):
        parts = {
            name: from_data(fields[name], getattr(like, name, None), name, seen)
            for name in cls._fields
        }
        return cls(**parts)
    target = cls.__new__(cls) if like is None else like
    if missing := vars(target).keys() - fields.keys() - set(NOT_STORED):
        raise ValueError(f"{kind} has no {', '.join(sorted(missing))}")
    seen[place] = target
    for name, item in fields.items():
        setattr(target, name, from_data(item, getattr(like, name, None), name, seen))
    return target
