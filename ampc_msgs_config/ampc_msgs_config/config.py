"""YAML <-> dataclass. Every complaint names the file, the key, the value and the bound."""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import yaml

from ampc_msgs_config.parameters import Checked

T = TypeVar("T", bound=Checked)
MAX_BYTES = 5_000_000
"""Of a YAML file."""
MAX_NODES = 5_000_000
"""Values of a YAML file, where each alias counts as all that it stands for."""


def shipped(folder: str) -> dict[str, Path]:
    """Give the YAML files that come with the package, by the name that a user types."""
    root = Path(str(resources.files("ampc_msgs_config"))) / "config" / folder
    return {file.stem: file for file in sorted(root.glob("*.yaml"))}


def find(folder: str, name: str) -> Path:
    """Give the file of a shipped name, or of the path that a user wrote.

    Raises:
        ValueError: There is neither; the message lists the shipped names.
    """
    known = shipped(folder)
    if name in known:
        return known[name]
    if Path(name).is_file():
        return Path(name)
    names = ", ".join(known)
    raise ValueError(f"{name!r} is neither a file nor one of the shipped {folder}: {names}")


def read(file: Path) -> dict[str, Any]:
    """Read a YAML mapping safely.

    Raises:
        ValueError: It cannot be read, is too large, also with its aliases replaced, or no mapping.
    """
    return parsed(read_text(file), str(file))


def parsed(text: str, where: str) -> dict[str, Any]:
    """Parse a YAML mapping safely.

    Raises:
        ValueError: The text is no YAML, too large, also with its aliases replaced, or no mapping;
            `where` it comes from is named.
    """
    try:
        loader = yaml.SafeLoader(text)  # libyaml's own crashes on deep nesting
        node: Any = loader.get_single_node()
        count_nodes(node, {})
        content = loader.construct_document(node) if node else None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ValueError(f"{where}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{where}: must hold a mapping of keys, not {type(content).__name__}")
    return content


def read_text(file: Path, most: int = MAX_BYTES) -> str:
    """Read a text file of at most so many bytes.

    Raises:
        ValueError: It cannot be read, is no regular file, or is larger.
    """
    try:
        if file.exists() and not file.is_file():
            raise ValueError(f"{file}: cannot be read: no regular file")
        if file.stat().st_size > most:
            raise ValueError(f"{file}: {file.stat().st_size} bytes are more than {most}")
        return file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{file}: cannot be read: {error}") from error


def count_nodes(node: Any, known: dict[int, int]) -> int:
    """Count what a YAML node stands for, with every alias replaced by what it names.

    Args:
        node: Composed node, or a part of one, or None.
        known: Counts of nodes that were seen, by id; 0 while they are counted.

    Raises:
        ValueError: There are more than MAX_NODES, or a node holds itself.
    """
    if id(node) in known:
        if not known[id(node)]:
            raise ValueError("an alias names what it is part of")
        return known[id(node)]
    known[id(node)] = 0
    inner = node.value if isinstance(node, yaml.CollectionNode) else []
    parts = (part for each in inner for part in (each if isinstance(each, tuple) else (each,)))
    known[id(node)] = total = 1 + sum(count_nodes(part, known) for part in parts)
    if total > MAX_NODES:
        raise ValueError(f"more than {MAX_NODES} values, with aliases replaced")
    return total


def build(cls: type[T], content: Any, where: str) -> T:
    """Make a parameter object of a mapping.

    Args:
        cls: A `Checked` dataclass.
        content: Mapping of exactly its fields; those with a default may be missing.
        where: File and section, for the message.

    Raises:
        ValueError: Unknown or missing key, wrong type, or a value outside its range.
    """
    if not isinstance(content, Mapping):
        raise ValueError(f"{where}: must be a mapping of keys, not {content!r}")
    known = {item.name: item for item in fields(cls)}
    for key in content:
        if key not in known:
            raise ValueError(f"{where}: unknown key {key!r}; known are {', '.join(known)}")
    for key, item in known.items():
        if key not in content and item.default is MISSING:
            raise ValueError(f"{where}: missing key {key!r}")
    try:
        return cls(**{key: _as_float(value) for key, value in content.items()})
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{where}: {error}") from error


def load(cls: type[T], file: Path, section: str = "") -> T:
    """Load one section of a YAML file, or the whole file, as a parameter object."""
    content = read(file)
    if not section:
        return build(cls, content, str(file))
    if section not in content:
        raise ValueError(f"{file}: missing section {section!r}")
    return build(cls, content[section], f"{file}: {section}")


def _as_float(value: Any) -> Any:
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value
