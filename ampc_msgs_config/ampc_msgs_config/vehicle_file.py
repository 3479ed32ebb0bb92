"""Read vehicle files: sections, inheritance with `same_as`, and marks of estimated values."""

import json
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from ampc_msgs_config.config import (
    LONGEST_NAME,
    build,
    is_regular_file,
    read,
    shipped,
    shipped_schema,
)
from ampc_msgs_config.validation import T, check_mapping, convert, did_you_mean, hints, number

SECTIONS = ("chassis", "steering", "size", "tyre", "body", "aerodynamics", "powertrain")
"""Sections of a vehicle file; controllers use the first two, the simulated car uses all."""
SAME_AS, ESTIMATED = "same_as", "estimated"
SPREAD = number(0.0, 10.0, "", "Spread of an estimated value, about 95 %.")
ABSOLUTE_SPREADS = ("steering.delay", "steering.lag", "steering.offset")
"""Values whose spread is absolute, in their own unit; all other spreads are relative."""

REMARKS = {
    "missing key": "; launch_scripts/new_car.py estimates what no data sheet states",
    "steering.max_angle =": "; it is a road-wheel angle: that of the steering wheel divided by its "
    "ratio",
}
"""Ends of messages by a part of the message."""


class VehicleContent(NamedTuple):
    """Content of a vehicle file after inheritance, section by section, not yet checked."""

    files: tuple[Path, ...]
    """The file, followed by the files that it inherits from."""
    sections: dict[str, dict[str, Any]]
    estimated: dict[str, float]
    """Spread of each estimated value by its dotted key; see `ABSOLUTE_SPREADS`."""

    @property
    def where(self) -> str:
        """Names of the files, for messages."""
        first, *inherited = map(str, self.files)
        return f"{first} ({SAME_AS} {', '.join(inherited)})" if inherited else first

    @property
    def digest(self) -> str:
        """SHA-256 of all files."""
        return sha256(b"".join(file.read_bytes() for file in self.files)).hexdigest()

    def section(self, cls: type[T], name: str, user: str) -> T:
        """Build the object of one section.

        Args:
            cls: Record class.
            name: One of SECTIONS.
            user: What needs the section, for the message.

        Raises:
            ValueError: The section is missing; or file, key, value and bound.
        """
        if name not in self.sections:
            remedy = f"state it, inherit it with '{SAME_AS}: ordinary', or write a complete file "
            raise ValueError(
                f"{self.where}: missing section {name!r}, which {user} needs: {remedy}"
                "with launch_scripts/new_car.py"
            )
        try:
            return build(cls, self.sections[name], self.where, name)
        except ValueError as error:
            raise ValueError(f"{error}{self._remark(cls, name, str(error))}") from error

    def _remark(self, cls: type, name: str, problem: str) -> str:
        """Return the end of a message about a section: where a key belongs, or how to get it."""
        parts = json.loads(shipped_schema("vehicle").read_text(encoding="utf-8"))["$defs"]
        for key in self.sections[name]:
            for section, part in parts["Vehicle"]["properties"].items():
                fields = parts.get(part.get("$ref", "").rpartition("/")[2], {"properties": {}})
                if key in fields["properties"] and key not in hints(cls):
                    return f"; {key!r} is a key of the section {section!r}"
        return next((text for start, text in REMARKS.items() if start in problem), "")


def read_vehicle(file: Path) -> VehicleContent:
    """Read a vehicle file, and merge it key by key over the file that it inherits from.

    A value that the file itself states is no longer estimated by the file that it inherits from.

    Raises:
        ValueError: A file cannot be read, has an unknown section or mark, or inherits from itself.
    """
    return _inherit(file, ())


def load_section(cls: type[T], file: Path, name: str, user: str = "this program") -> T:
    """Load one section of a vehicle file; see `VehicleContent.section`."""
    return read_vehicle(file).section(cls, name, user)


def _inherit(file: Path, heirs: tuple[Path, ...]) -> VehicleContent:
    chain = (*heirs, file)
    if file.resolve() in [heir.resolve() for heir in heirs]:
        raise ValueError(f"{chain[0]}: {SAME_AS} is a cycle: {' -> '.join(map(str, chain))}")
    content = read(file)
    for name in content:
        if name not in (SAME_AS, ESTIMATED, *SECTIONS):
            known = ", ".join((SAME_AS, ESTIMATED, *SECTIONS))
            near = did_you_mean(name, SECTIONS)
            raise ValueError(f"{file}: unknown section {name!r}; known are {known}{near}")
    base = VehicleContent((), {}, {})
    if SAME_AS in content:
        base = _inherit(_parent(file, content[SAME_AS]), chain)
    try:
        return _merge(file, content, base)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


def _parent(file: Path, name: object) -> Path:
    """Return the file of a shipped name, or of a path relative to the file that inherits."""
    if not isinstance(name, str) or not name:
        raise ValueError(f"{file}: {SAME_AS} = {name!r} must be a shipped vehicle or a file")
    known, beside = shipped("vehicles"), file.parent / name
    if name not in known and not is_regular_file(beside):
        names = f"{', '.join(known)}{did_you_mean(name, known)}"
        problem = f"is neither the file {beside} nor one of the shipped vehicles: {names}"
        problem = f"{name!r} {problem}" if len(name) <= LONGEST_NAME else "is too long for a name"
        raise ValueError(f"{file}: {SAME_AS} = {problem}")
    return known.get(name, beside)


def _merge(file: Path, content: dict[str, Any], base: VehicleContent) -> VehicleContent:
    sections, estimated = dict(base.sections), dict(base.estimated)
    for name in SECTIONS:
        if name in content:
            check_mapping(content[name], name)
            sections[name] = {**base.sections.get(name, {}), **content[name]}
            for key in content[name]:
                estimated.pop(f"{name}.{key}", None)
    marks = content.get(ESTIMATED, {})
    check_mapping(marks, ESTIMATED)
    for key, spread in marks.items():
        section, _, field = str(key).partition(".")
        if field not in sections.get(section, {}):
            raise ValueError(f"{ESTIMATED}: {key!r} is no value of this file, such as chassis.mass")
        estimated[key] = convert(Annotated[float, SPREAD], spread, f"{ESTIMATED}.{key}")
    return VehicleContent((file, *base.files), sections, estimated)
