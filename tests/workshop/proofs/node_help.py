"""Write the help texts of the nodes, which `--help` prints, from the nodes themselves.

`python -m tests.workshop.proofs.node_help` rewrites `<package>/nodes/help/<executable>.txt`. A test
compares these files with the nodes.
"""

import importlib
import inspect
import re
import sys
import tempfile
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rclpy.node import Node

from ampc_msgs_config import topics
from ampc_msgs_config.recording.message_types import type_name_of
from tests.entry_points import EXECUTABLES
from tests.ros_nodes import ros_context

NODES = sorted(name for name, module in EXECUTABLES.items() if ".nodes." in module)
"""Executables that are nodes, each as package/name."""
NAMESPACE = "/of_help"
OF_RCLPY = {topics.PARAMETER_EVENTS, topics.ROSOUT}
HIDDEN = ("qos_overrides", "start_type_description_service")
"""Beginnings of the names of parameters that rclpy declares by itself."""
MANY = 4
"""Topics of one type and beginning from which only the beginning is listed."""
KINDS = {
    ParameterType.PARAMETER_BOOL: "true or false",
    ParameterType.PARAMETER_INTEGER: "whole number",
    ParameterType.PARAMETER_DOUBLE: "number",
    ParameterType.PARAMETER_STRING: "text",
    ParameterType.PARAMETER_STRING_ARRAY: "list of texts",
}
WIDTH = 100


def help_text(executable: str) -> str:
    """Return what `--help` of a node prints.

    Args:
        executable: Package and name, such as `ampc_ros/controller`.
    """
    module = importlib.import_module(EXECUTABLES[executable])
    with tempfile.TemporaryDirectory() as folder:
        more = {"output": f"{folder}/bag"} if executable.endswith("/recorder") else {}
        with ros_context("-r", f"__ns:={NAMESPACE}", **more) as executor:
            node = node_class(module)()
            executor.add_node(node)
            if hasattr(node, "unsubscribe"):
                node.subscribe()  # the markers subscribe only while somebody looks
            paragraphs = [
                usage(executable, module),
                section("Subscribes to", topic_rows(node.subscriptions)),
                section("Publishes", topic_rows(node.publishers)),
                section("Services", service_rows(node)),
                section("Parameters (*: can be changed while the node runs)", parameter_rows(node)),
            ]
    return "\n\n".join(filter(None, paragraphs)) + "\n"


def node_class(module: Any) -> Any:
    """Return the class of nodes that a module defines."""
    classes = inspect.getmembers(module, inspect.isclass)
    (found,) = (
        each for _, each in classes if issubclass(each, Node) and each.__module__ == module.__name__
    )
    return found


def usage(executable: str, module: Any) -> str:
    """Return the purpose of a node, and how it is started."""
    package, name = executable.split("/")
    purpose = re.sub(r"^Node `\w+`: | `ros2 run [\w ]+`\.|``?", "", str(module.__doc__).strip())
    start = f"ros2 run {package} {name} [--ros-args -p PARAMETER:=VALUE -r TOPIC:=OTHER ...]"
    return f"{name}: {purpose}\n\nusage: {start}"


def section(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return a list of names and texts below a title; empty without a row."""
    rows = list(rows)
    if not rows:
        return ""
    width = max(len(name) for name, _ in rows) + 4
    lines = [
        textwrap.fill(
            f"  {name:<{width - 2}}{text}",
            WIDTH,
            subsequent_indent=" " * width,
            break_long_words=False,
            break_on_hyphens=False,
        )
        for name, text in rows
    ]
    return "\n".join([f"{title}:", *lines])


def relative(name: str) -> str:
    """Return a name as the source writes it: relative unless it is the same in any namespace."""
    return name.removeprefix(f"{NAMESPACE}/")


def topic_rows(endpoints: Iterable[Any]) -> list[tuple[str, str]]:
    """Return name and type of the topics of publishers or subscriptions, by name."""
    types = {
        relative(each.topic_name): type_name_of(each.msg_type)
        for each in endpoints
        if each.topic_name not in OF_RCLPY
    }
    groups: dict[tuple[str, str], list[str]] = {}
    for name, kind in types.items():
        groups.setdefault((name.rpartition("/")[0], kind), []).append(name)
    for (begin, kind), names in groups.items():
        if begin and len(names) >= MANY:
            types = {name: each for name, each in types.items() if name not in names}
            types[f"{begin}/<quantity>"] = kind
    return sorted(types.items())


def service_rows(node: Node) -> list[tuple[str, str]]:
    """Return name and type of the services of a node, without those that rclpy adds."""
    names: dict[str, Any] = {
        each.srv_name.rpartition("/")[2]: each.srv_type for each in node.services
    }
    return sorted(
        (f"~/{name}", f"std_srvs/srv/{kind.__name__}")
        for name, kind in names.items()
        if kind.__module__.startswith("std_srvs")
    )


def parameter_rows(node: Node) -> list[tuple[str, str]]:
    """Return the parameters of a node with type, default, meaning, and allowed values."""
    names = [name for name in node.get_parameters_by_prefix("") if not name.startswith(HIDDEN)]
    rows = []
    for name, each in zip(sorted(names), node.describe_parameters(sorted(names)), strict=True):
        value = "" if name == "output" else f", default {node.get_parameter(name).value!r}"
        text = f"{KINDS[each.type]}{value}: {each.description.rstrip('.')}{allowed(each)}"
        rows.append((name if each.read_only else f"{name} *", text))
    return rows


def allowed(descriptor: ParameterDescriptor) -> str:
    """Return the values that a parameter may have, for its line."""
    bounds = [*descriptor.floating_point_range, *descriptor.integer_range]
    if bounds:
        return f"; from {bounds[0].from_value:g} to {bounds[0].to_value:g}"
    constraints = descriptor.additional_constraints
    return f"; {constraints}" if constraints else ""


def help_file(executable: str) -> Path:
    """Return the file that `--help` prints."""
    module = importlib.import_module(EXECUTABLES[executable])
    name = executable.rpartition("/")[2]
    return Path(str(module.__file__)).parent / "help" / f"{name}.txt"


def main() -> int:
    """Write all files."""
    for executable in NODES:
        file = help_file(executable)
        file.parent.mkdir(exist_ok=True)
        file.write_text(help_text(executable), encoding="utf-8")
        print(file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
