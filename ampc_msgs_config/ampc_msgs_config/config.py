"""Load YAML configuration as declared types, and export the declarations as JSON Schema.

Every error is one line with file, dotted key, value and bound. The fields are declared with
`validation`, which uses msgspec. Measured before the choice, for import on its own: msgspec takes
24 ms and 5 MB, pydantic 98 ms and 21 MB; each node pays this once per start.
"""

import math
import os
from collections.abc import Mapping
from dataclasses import MISSING
from importlib import resources
from pathlib import Path
from typing import Any, cast

import msgspec
import yaml

from ampc_msgs_config.strict_yaml import Dumper, parse_yaml
from ampc_msgs_config.validation import T, convert, defaults, did_you_mean, hints

FOLDER = Path(str(resources.files("ampc_msgs_config"))) / "config"
"""Folder of the shipped files."""
MAX_YAML_BYTES = 5_000_000
"""Greatest size of a YAML file [bytes]."""
LONGEST_NAME = 300
"""Longest name of a file in a message [characters]."""
SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
"""Dialect of the exported schemas."""


def shipped(folder: str) -> dict[str, Path]:
    """Return the YAML files that come with the package, by the name that a user types."""
    return {file.stem: file for file in sorted((FOLDER / folder).glob("*.yaml"))}


def shipped_or_file(folder: str, what: str = "a YAML file") -> str:
    """Return which values a parameter takes that selects a file, for the user."""
    return f"{', '.join(shipped(folder))}, or {what}"


def shipped_schema(name: str) -> Path:
    """Return the file of a schema that comes with the package."""
    return FOLDER / "schemas" / f"{name}.json"


def is_regular_file(path: Path) -> bool:
    """Return whether a path is that of a file; False where the system refuses the question.

    It refuses a name that is too long, and a folder without permission.
    """
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def find(folder: str, name: str) -> Path:
    """Return the file of a shipped name, or the path that a user wrote.

    Raises:
        ValueError: There is neither; the message lists the shipped names.
    """
    known = shipped(folder)
    if name not in known and not is_regular_file(Path(name)):
        names = f"{', '.join(known)}{did_you_mean(name[:LONGEST_NAME], known)}"
        what = f"{name!r}" if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME]!r}..."
        raise ValueError(f"{what} is neither a file nor one of the shipped {folder}: {names}")
    return known.get(name, Path(name))


def read(file: Path) -> dict[str, Any]:
    """Read a YAML mapping safely.

    Raises:
        ValueError: It cannot be read, is too large, also with its aliases replaced, or no mapping.
    """
    return parse(read_text(file), str(file))


def parse(text: str, where: str) -> dict[str, Any]:
    """Parse a YAML mapping safely.

    Args:
        text: YAML.
        where: Source of the text, for the message.

    Raises:
        ValueError: The text is no YAML, has a key twice, is too large, also with its aliases
            replaced, or is no mapping.
    """
    try:
        content = parse_yaml(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(f"{where}: not YAML: {' '.join(str(error).split())}") from error
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{where}: must hold a mapping of keys, not {type(content).__name__}")
    return content


def dump(content: Any, **options: Any) -> str:
    """Write content as YAML that `parse` reads back value for value, keys in the given order."""
    return str(yaml.dump(content, Dumper=Dumper, sort_keys=False, **options))


def read_text(file: Path, most: int = MAX_YAML_BYTES) -> str:
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


def build(cls: type[T], content: Any, where: str, key: str = "") -> T:
    """Build an object of a record class from a mapping.

    Args:
        cls: Record class, see `validation`.
        content: Mapping of its fields; those with a default may be missing.
        where: File or topic, for the message.
        key: Dotted key of the mapping in it, for the message.

    Raises:
        ValueError: Unknown, renamed or missing key, wrong type, or a value outside its range.
    """
    try:
        return cast(T, convert(cls, content, key))
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def load(cls: type[T], file: Path) -> T:
    """Load a YAML file as an object of a record class; see `vehicle_file` for vehicles."""
    return build(cls, read(file), str(file))


def schema_line(schema_file: Path, file: Path) -> str:
    """Return the first line of a YAML file that names its schema for editors.

    Args:
        schema_file: JSON Schema of the kind of file.
        file: YAML file that is to be written.
    """
    return f"# yaml-language-server: $schema={os.path.relpath(schema_file, file.parent)}"


def schema(cls: type, title: str) -> dict[str, Any]:
    """Return the JSON Schema of the files that hold a record class.

    Args:
        cls: Record class.
        title: Name of the kind of file.
    """
    kind: Any = cls
    if hasattr(cls, "_fields"):  # msgspec reads a NamedTuple from a list
        rows = [(k, v) for k, v in hints(cls).items() if defaults(cls)[k] is MISSING]
        rest = [(k, v, defaults(cls)[k]) for k, v in hints(cls).items() if (k, v) not in rows]
        kind = msgspec.defstruct(cls.__name__, [*rows, *rest])
    content: dict[str, Any] = _json(msgspec.json.schema(kind))
    return {"$schema": SCHEMA_DIALECT, "title": title, **content}


def _json(value: Any) -> Any:
    """Return a schema as JSON can hold it, with every mapping closed to undeclared keys."""
    if isinstance(value, Mapping):
        closed = {"additionalProperties": False} if "properties" in value else {}
        return {
            key: _json(part)
            for key, part in {**value, **closed}.items()
            if part != "" and not (key == "default" and part in (math.inf, -math.inf))
        }
    return [_json(part) for part in value] if isinstance(value, list | tuple) else value
