"""Process that publishes one filled message of each type and hears it: type hash, bytes, values.

`python -m tests.echo_of_messages TYPE ...` prints a JSON object by type name.
"""

import importlib
import json
import re
import sys
import time
from itertools import count
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.serialization import serialize_message

PATIENCE = 120.0
"""Wall time to wait for a message [s]."""
NUMBERS = count(1)


def message_type(name: str) -> Any:
    """Return the class of a message type such as `std_msgs/msg/Bool`."""
    package, _, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), message)


def filled(name: str) -> Any:
    """Return a message whose fields all have different values, and lists two elements."""
    message = message_type(name)()
    for field, kind in message.get_fields_and_field_types().items():
        element = re.sub(r"^sequence<(.*)>$", r"\1", kind)
        value = value_of(element)
        setattr(message, field, [value, value_of(element)] if element != kind else value)
    return message


def value_of(kind: str) -> Any:
    """Return a value of a field type, exact in single precision, different from all before."""
    number = next(NUMBERS)
    if "/" in kind:
        return filled(kind.replace("/", "/msg/"))
    if kind == "boolean":
        return True
    if kind == "string":
        return f"text {number}"
    return number + 0.5 if kind in ("float", "double") else number


def plain(value: Any) -> Any:
    """Return a message, or a part of it, as numbers, texts, lists and dictionaries."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    return [plain(each) for each in value] if isinstance(value, list) else value


def echo(node: Node, name: str) -> dict[str, Any]:
    """Publish a message until it is heard; return what was sent and heard.

    Raises:
        TimeoutError: Nothing is heard.
    """
    topic, sent = name.replace("/", "_").lower(), filled(name)
    heard: list[Any] = []
    publisher = node.create_publisher(message_type(name), topic, 1)
    node.create_subscription(message_type(name), topic, heard.append, 1)
    until = time.monotonic() + PATIENCE
    while not heard:
        if time.monotonic() > until:
            raise TimeoutError(f"{name} is not heard")
        publisher.publish(sent)
        rclpy.spin_once(node, timeout_sec=0.1)
    (info, *_) = node.get_publishers_info_by_topic(topic)
    return {
        "type_hash": str(info.topic_type_hash),
        "bytes": serialize_message(sent).hex(),
        "sent": plain(sent),
        "heard": plain(heard[0]),
    }


if __name__ == "__main__":
    rclpy.init()
    only_node = Node("echo_of_messages")
    json.dump({name: echo(only_node, name) for name in sys.argv[1:]}, sys.stdout)
    rclpy.shutdown()
