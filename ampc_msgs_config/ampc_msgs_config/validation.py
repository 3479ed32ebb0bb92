"""Declare configuration fields once, with type, bounds, unit and meaning, and check values by them.

A field is declared as `mass: Annotated[float, number(1.0, 1.0e5, "kg", "Mass of the car.")]` in a
dataclass based on `Checked`, in a NamedTuple, or in a msgspec.Struct (one of several kinds, chosen
by its tag). msgspec checks each value and exports the declarations as JSON Schema. This module adds
the dotted key, the value and the bound to the message.
"""

import math
import types
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec

T = TypeVar("T")
Fields = Callable[[Any], dict[str, Any]]
"""Function from a record class to something for each of its fields."""
cached: Callable[[Fields], Fields] = cache
"""`functools.cache`, typed for classes, which are hashable although type checkers doubt it."""
LONGEST_VALUE = 60
"""Longest text of a value in a message [characters]."""


def number(
    low: float, high: float, unit: str = "", meaning: str = "", *, whole: bool = False
) -> msgspec.Meta:
    """Declare a number in [low, high]; an infinite bound is itself an allowed value.

    Args:
        low: Least value.
        high: Greatest value.
        unit: SI unit; empty: none.
        meaning: One sentence for schema and documentation.
        whole: Whether only whole numbers are allowed, also where they are stored as float.
    """
    return msgspec.Meta(
        ge=low if low > -math.inf else None,
        le=high if high < math.inf else None,
        multiple_of=1 if whole else None,
        description=f"{meaning} [{unit}]" if unit else meaning,
        extra={"unit": unit, "meaning": meaning},
    )


def choice(options: tuple[str, ...], meaning: str = "") -> msgspec.Meta:
    """Declare a text that is one of a few words."""
    return msgspec.Meta(
        description=meaning,
        extra_json_schema={"enum": list(options)},
        extra={"options": options, "meaning": meaning},
    )


def described(meaning: str, *, most: int | None = None) -> msgspec.Meta:
    """Declare the meaning of any other field, and the greatest length of a list."""
    return msgspec.Meta(
        description=meaning,
        extra={"meaning": meaning},
        min_length=None if most is None else 1,
        max_length=most,
    )


@dataclass(frozen=True, kw_only=True)
class Checked:
    """Base of parameter dataclasses: checks every field at construction.

    Whole numbers become floats and lists become tuples where the field is declared so.
    """

    RENAMED: ClassVar[Mapping[str, str]] = {}
    """Former key -> present key; a former key is rejected with the present one in the message."""
    ELSEWHERE: ClassVar[Mapping[str, str]] = {}
    """Key that users expect here -> end of the message that rejects it."""

    def __post_init__(self) -> None:
        """Check every field against its declaration."""
        for name, kind in hints(type(self)).items():
            object.__setattr__(self, name, convert(kind, getattr(self, name), name))


@cached
def hints(cls: Any) -> dict[str, Any]:
    """Return the declared type of each field of a record class, with its annotations."""
    declared = get_type_hints(cls, include_extras=True)
    return {name: declared[name] for name in defaults(cls)}


@cached
def defaults(cls: Any) -> dict[str, Any]:
    """Return the default of each field of a record class in order; MISSING: required."""
    if is_dataclass(cls):
        return {
            item.name: item.default if item.default_factory is MISSING else item.default_factory()
            for item in fields(cls)
        }
    if issubclass(cls, msgspec.Struct):
        items = msgspec.structs.fields(cls)
        return {item.name: item.default if not item.required else MISSING for item in items}
    record = cast(Any, cls)  # a NamedTuple
    return {name: record._field_defaults.get(name, MISSING) for name in record._fields}


def is_record(kind: Any) -> bool:
    """Return whether a type is a class of named fields: dataclass, NamedTuple or Struct."""
    return isinstance(kind, type) and (
        is_dataclass(kind) or issubclass(kind, msgspec.Struct) or hasattr(kind, "_fields")
    )


def unwrap(kind: Any) -> tuple[Any, msgspec.Meta | None]:
    """Split an annotated type into type and declaration."""
    if get_origin(kind) is Annotated:
        inner, meta = get_args(kind)
        return inner, meta
    return kind, None


def convert(kind: Any, value: Any, key: str) -> Any:
    """Return a value as the declared type; mappings become records, lists become tuples.

    Args:
        kind: Declared type.
        value: Value as YAML or Python code holds it.
        key: Dotted key, for the message; empty: the whole content.

    Raises:
        ValueError: Key, value and bound; or the unknown, missing or renamed key.
    """
    inner, meta = unwrap(kind)
    if is_record(inner):
        return value if isinstance(value, inner) else _record(inner, value, key)
    if get_origin(inner) in (Union, types.UnionType):
        return convert(_alternative(inner, value, key), value, key)
    if get_origin(inner) is tuple:
        return _row(inner, meta, value, key)
    if isinstance(value, float):
        value = float(value)  # msgspec rejects numpy.float64
    if meta and meta.extra and "options" in meta.extra:
        inner = Literal[meta.extra["options"]]
    try:
        return msgspec.convert(value, Annotated[inner, meta] if meta else inner)
    except msgspec.ValidationError:
        raise ValueError(f"{key} = {shown(value)} must {expected(inner, meta, value)}") from None


def _record(cls: type[T], content: Any, key: str) -> T:
    """Build a record from a mapping without unknown, renamed or missing keys."""
    check_mapping(content, key)
    where, known, (tag, _) = f"{key}: " if key else "", defaults(cls), tag_of(cls)
    renamed = getattr(cls, "RENAMED", {})
    for name in content:
        if name in renamed:
            raise ValueError(f"{where}key {name!r} is now {renamed[name]!r}")
        if name not in known and name != tag:
            keys = ", ".join([tag, *known] if tag else known)
            near = getattr(cls, "ELSEWHERE", {}).get(name) or did_you_mean(name, known)
            known_keys = f"known are {keys or 'none'}"
            raise ValueError(f"{where}unknown key {shown(name)}; {known_keys}{near}")
    for name, default in known.items():
        if name not in content and default is MISSING:
            raise ValueError(f"{where}missing key {name!r}")
    kinds = hints(cls).items()
    values = {k: convert(kind, content[k], dotted(key, k)) for k, kind in kinds if k in content}
    try:
        return cls(**values)
    except ValueError as error:  # what ties several fields together
        raise ValueError(dotted(key, str(error))) from error


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of a message with the known name that is most similar, or an empty text."""
    near = get_close_matches(str(name), known, 1)
    return f"; did you mean {near[0]!r}?" if near else ""


def check_mapping(content: Any, key: str) -> None:
    """Raise a ValueError unless the content at a key is a mapping."""
    if not isinstance(content, Mapping) and key:
        raise ValueError(f"{key} = {shown(content)} must be a mapping of keys")
    if not isinstance(content, Mapping):
        raise ValueError(f"must be a mapping of keys, not {shown(content)}")


def _alternative(union: Any, value: Any, key: str) -> Any:
    """Return the member of a union that a value is meant for: by None, by tag, or by its form."""
    if value is None and type(None) in get_args(union):
        return type(None)
    members = [member for member in get_args(union) if member is not type(None)]
    for member in members:
        if isinstance(member, type) and isinstance(value, member):
            return member
    tagged = {tag_of(member)[1]: member for member in members}
    if None not in tagged:
        check_mapping(value, key)
        field = tag_of(members[0])[0]
        if field not in value:
            raise ValueError(f"{key}: missing key {field!r}")
        tag = value[field]
        if not isinstance(tag, str) or tag not in tagged:
            options = ", ".join(map(str, tagged))
            raise ValueError(f"{key}.{field} = {shown(tag)} must be one of {options}")
        return tagged[tag]
    records = [member for member in members if is_record(unwrap(member)[0])]
    others = [member for member in members if member not in records]
    return (records + others if isinstance(value, Mapping) else others + records)[0]


def tag_of(cls: Any) -> tuple[str | None, str | None]:
    """Return the name of the tag field of a Struct and its tag; None: no tag."""
    config = getattr(cls, "__struct_config__", None)
    return (config.tag_field, config.tag) if config else (None, None)


def _row(kind: Any, meta: msgspec.Meta | None, values: Any, key: str) -> tuple[Any, ...]:
    """Return a list as a tuple: of any length where declared with `...`, else of the given one."""
    kinds = get_args(kind)
    low, high = len(kinds), float(len(kinds))
    if kinds[-1] is ...:
        low, high = (meta.min_length or 0, meta.max_length or math.inf) if meta else (0, math.inf)
    if not isinstance(values, list | tuple) or hasattr(values, "_fields"):
        of = " of numbers" if unwrap(kinds[0])[0] in (int, float) else ""
        raise ValueError(f"{key} = {shown(values)} must be a list{of}")
    if not low <= len(values) <= high:
        to = "" if low == high else " or more" if high == math.inf else f" to {high:.0f}"
        raise ValueError(f"{key} = {shown(values)} must be a list of {low}{to} entries")
    if kinds[-1] is ...:
        kinds = (kinds[0],) * len(values)
    items = enumerate(zip(kinds, values, strict=True))
    return tuple(convert(kind, value, f"{key}[{i}]") for i, (kind, value) in items)


def check_range(name: str, value: Any, declared: msgspec.Meta) -> None:
    """Raise a ValueError with name, value and bound unless a number lies in its declared range."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        low, high = number_bounds(declared)
        if low <= value <= high and declared.multiple_of is None:
            return  # called in each period of a simulated drive
    convert(Annotated[float, declared], value, name)


def units_of(cls: Any) -> dict[str, str]:
    """Return the units of the numbers of a record class."""
    metas = {name: unwrap(kind)[1] for name, kind in hints(cls).items()}
    return {name: (meta.extra or {}).get("unit", "") for name, meta in metas.items() if meta}


def dotted(key: str, name: str) -> str:
    """Return the key of a field inside the record at `key`."""
    return f"{key}.{name}" if key else name


def shown(value: Any) -> str:
    """Return a value as text for a message, cut where it is long."""
    if isinstance(value, int) and abs(value) >= 10**LONGEST_VALUE:
        return f"a whole number of {int(math.log10(abs(value))) + 1} digits"
    text = repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."


def number_bounds(declared: msgspec.Meta) -> tuple[float, float]:
    """Return the bounds of a declared number."""
    low = -math.inf if declared.ge is None else float(declared.ge)
    return low, math.inf if declared.le is None else float(declared.le)


def expected(kind: Any, meta: msgspec.Meta | None, value: Any) -> str:
    """Return what a value of this declared type must be, as the end of a message."""
    if get_origin(kind) is Literal:
        return f"be one of {', '.join(get_args(kind))}"
    if kind not in (int, float):
        names = {bool: "true or false", str: "text"}
        return f"be {names.get(kind, 'a mapping of keys')}"
    within = ""
    if meta:
        low, high = number_bounds(meta)
        within = f" in [{low:g}, {high:g}] {(meta.extra or {}).get('unit', '')}".rstrip()
    is_whole = kind is int or (meta is not None and meta.multiple_of is not None)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return f"be a {'whole ' if is_whole else ''}number{within}"
    if is_whole and isinstance(value, float) and math.isfinite(value) and value % 1:
        return f"be a whole number{within}"
    return f"lie{within}"
