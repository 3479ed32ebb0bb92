"""Messages of other cars on the topics that all nodes of a graph share."""

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log, ParameterEvent
from rclpy.serialization import deserialize_message

from ampc_msgs_config.topics import DIAGNOSTICS, PARAMETER_EVENTS, ROSOUT

SENDERS: dict[str, tuple[type, Callable[[Any], list[str]]]] = {
    DIAGNOSTICS: (DiagnosticArray, lambda message: [each.name for each in message.status]),
    PARAMETER_EVENTS: (ParameterEvent, lambda message: [message.node]),
    ROSOUT: (Log, lambda message: ["/" + message.name.replace(".", "/")]),
}
"""Type of each shared topic, and the full names of the nodes that a message is about."""


def is_of_another_car(topic: str, data: bytes, namespace: str) -> bool:
    """Return whether a message on a shared topic is only about nodes of another namespace.

    Args:
        topic: Full name of the topic.
        data: The serialised message.
        namespace: Namespace of this car; `/` accepts every message.

    Returns:
        False also for names outside any namespace, such as those of hardware in /diagnostics.
    """
    if topic not in SENDERS or namespace == "/":
        return False
    message_type, senders = SENDERS[topic]
    names = senders(deserialize_message(data, message_type))
    own = namespace + "/"
    return bool(names) and all(
        name.startswith("/") and name.count("/") > 1 and not name.startswith(own) for name in names
    )
