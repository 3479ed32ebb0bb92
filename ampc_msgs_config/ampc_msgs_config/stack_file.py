"""Stacks: how controller, planner and gate are connected to another system."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from ampc_msgs_config.config import find, load
from ampc_msgs_config.validation import Checked, described

Scalar = bool | int | float | str


@dataclass(frozen=True, kw_only=True)
class Stack(Checked):
    """Content of a stack file."""

    about: Annotated[str, described("What the stack is, in one line.")]
    parameters: Annotated[
        dict[str, Scalar], described("Parameters of controller, planner and gate, by name.")
    ]
    required: Annotated[
        tuple[str, ...], described("Parameters that a user must give, such as path.")
    ] = ()
    remappings: Annotated[
        dict[str, str], described("Topic of the stack by the topic of this project.")
    ]


def load_stack(name: str) -> Stack:
    """Load a stack by shipped name or YAML file.

    Raises:
        ValueError: File, key and value.
    """
    return load(Stack, find("stacks", name))


def as_text(parameters: Mapping[str, Scalar]) -> dict[str, str]:
    """Return parameters as the text of launch arguments."""
    return {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in parameters.items()
    }
