"""Load YAML configuration as declared types, and export the declarations as JSON Schema.

Every error is one line with file, dotted key, value and bound. The fields are declared with
`validation`, which uses msgspec. Measured before the choice, for import on its own: msgspec takes
24 ms and 5 MB, pydantic 98 ms and 21 MB; each node pays this once per start.

The accepted YAML is 1.1 without its traps. Booleans are `true` and `false` only. Numbers are
decimal, `1e-3` included. `yes`, `1:30`, `0017`, `0x1F`, `1_0` and dates are text, which no number
field accepts. A key that occurs twice in a mapping is an error.
"""

import math
import os
import re
from collections.abc import Mapping
from dataclasses import MISSING
from importlib import resources
from pathlib import Path
from typing import Any, cast

import msgspec
import yaml

from ampc_msgs_config.validation import T, convert, defaults, did_you_mean, dotted, hints

FOLDER = Path(str(resources.files("ampc_msgs_config"))) / "config"
"""Folder of the shipped files."""
MAX_YAML_BYTES = 5_000_000
"""Greatest size of a YAML file [bytes]."""
MAX_NODES = 5_000_000
"""Greatest number of values in a YAML file, where each alias counts as all that it stands for."""
LONGEST_NAME = 300
"""Longest name of a file in a message [characters]."""
SCALARS = {
    "bool": re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z"),
    "int": re.compile(r"[-+]?(?:0|[1-9][0-9]*)\Z"),
    "float": re.compile(
        r"""[-+]?(?:(?:0|[1-9][0-9]*)\.[0-9]*(?:[eE][-+]?[0-9]+)?|\.[0-9]+(?:[eE][-+]?[0-9]+)?
        |(?:0|[1-9][0-9]*)[eE][-+]?[0-9]+|\.(?:inf|Inf|INF))\Z|\.(?:nan|NaN|NAN)\Z""",
        re.VERBOSE,
    ),
}
SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
"""Dialect of the exported schemas."""


class Loader(yaml.SafeLoader):
    """Safe YAML loader whose plain scalars are only numbers, booleans, null and text.

    Note:
        libyaml's own loader crashes on deep nesting.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012 (PyYAML's own registry, replaced as a whole)
        first: [
            (tag, pattern)
            for tag, pattern in resolvers
            if tag.rpartition(":")[2] in ("null", "merge")
        ]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


class Dumper(yaml.SafeDumper):
    """Safe YAML writer that quotes every text which `Loader` would read as something else."""


def _construct(loader: Loader, node: yaml.ScalarNode) -> bool | int | float:
    """Return the value of a boolean or number, also where the text has an explicit tag."""
    text, kind = str(loader.construct_scalar(node)).lower(), node.tag.rpartition(":")[2]
    problem = f"{node.value!r} is not of the type {kind}"
    if SCALARS[kind].match(node.value):
        if kind != "float":
            return text == "true" if kind == "bool" else int(text)
        value = float(text.replace(".inf", "inf").replace(".nan", "nan"))
        if "inf" in text or not math.isinf(value):
            return value
        problem = f"{node.value} is beyond the range of floating-point numbers"
    raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)


for kind, pattern in SCALARS.items():
    tag, starts = f"tag:yaml.org,2002:{kind}", list("tTfF" if kind == "bool" else "-+0123456789.")
    Loader.add_constructor(tag, _construct)
    Loader.add_implicit_resolver(tag, pattern, starts)
    if kind != "bool":  # as PyYAML's own dumper quotes `yes`, too
        Dumper.add_implicit_resolver(tag, pattern, starts)


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
        loader = Loader(text)
        node: Any = loader.get_single_node()
        check_nodes(node, {}, "")
        content = loader.construct_document(node) if node else None
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


def check_nodes(node: Any, counts: dict[int, int], key: str) -> int:
    """Count the values of a YAML node, with every alias replaced, and check its keys.

    Args:
        node: Composed node, or a part of one, or None.
        counts: Counts of visited nodes, by id; 0 while a node is being counted.
        key: Dotted key of the node, for the message.

    Raises:
        ValueError: More than MAX_NODES values, a node that contains itself, or a key that occurs
            twice in one mapping.
    """
    if id(node) in counts:
        if not counts[id(node)]:
            raise ValueError("an alias names what it is part of")
        return counts[id(node)]
    counts[id(node)] = 0
    total, parts, lines = 1, list[tuple[str, Any]](), dict[str, int]()
    if isinstance(node, yaml.SequenceNode):
        parts = [(f"{key}[{i}]", part) for i, part in enumerate(node.value)]
    elif isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            inner, line = dotted(key, str(name.value)), name.start_mark.line + 1
            if isinstance(name, yaml.ScalarNode) and name.value in lines:
                text = value.value if isinstance(value, yaml.ScalarNode) else "..."
                where = f"in line {line} repeats the key of line {lines[name.value]}"
                raise ValueError(f"{inner} = {text} {where}")
            lines[str(name.value)] = line
            parts += [(inner, name), (inner, value)]
    for inner, part in parts:
        total += check_nodes(part, counts, inner)
        if total > MAX_NODES:
            raise ValueError(f"more than {MAX_NODES} values, with aliases replaced")
    counts[id(node)] = total
    return total


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
