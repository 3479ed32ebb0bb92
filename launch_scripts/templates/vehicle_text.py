"""Vehicle template as the commented text of a vehicle file."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ampc_msgs_config.config import dump, schema_line, shipped_schema
from ampc_msgs_config.validation import hints, units_of
from ampc_msgs_config.vehicle_file import ABSOLUTE_SPREADS, ESTIMATED
from launch_scripts.templates.vehicle_rules import Template
from sim_vehicle.parameters import Vehicle

COMMENTS = {
    "chassis.front_cornering_stiffness": "ONE tyre, with the compliance of suspension and steering",
    "chassis.rear_cornering_stiffness": "ONE tyre",
    "steering.max_angle": "road-wheel angle, also with a ratio",
    "steering.max_rate": "of the road-wheel angle",
    "steering.lag": "-1: unknown; it is estimated while the car is driven",
    "steering.delay": "state it where it is known",
    "steering.ratio": "position on steering_command per road-wheel angle",
    "tyre.model": "or linear",
    "aerodynamics.drag_area": "with its coefficient",
    "aerodynamics.side_area": "with its coefficient",
    "aerodynamics.side_force_arm": "ahead of the centre of gravity",
}
"""Remarks on keys whose meaning is often mistaken."""


def spread_text(key: str, spread: float) -> str:
    """Return the spread of an estimated value as text, such as `estimated, +-30 %`."""
    if key in ABSOLUTE_SPREADS:
        unit = units_of(hints(Vehicle)[key.partition(".")[0]])[key.partition(".")[2]]
        return f"estimated, +-{spread:g} {unit}"
    return f"estimated, +-{100 * spread:.0f} %"


def vehicle_text(template: Template, command: str, file: Path) -> str:
    """Return the text of a vehicle file.

    Args:
        template: Content.
        command: Command that wrote it.
        file: File that it will be in, for the path of the schema.
    """
    head = [
        schema_line(shipped_schema("vehicle"), file.absolute()),
        f"# Written by {command}",
        f"# Type {template.type}; sources of the rules: launch_scripts/templates/vehicle_rules.py.",
        "# Replace what you know, and remove its line from the section `estimated`.",
    ]
    return "\n".join([*head, *lines(template)]) + "\n"


def lines(template: Template) -> Iterator[str]:
    """Yield the lines of all sections."""
    for section, values in template.sections.items():
        yield f"\n{section}:"
        units = units_of(hints(Vehicle)[section])
        yield from key_lines(section, values, units, template.estimated)
    yield f"\n{ESTIMATED}:  # relative spread (95 %), but {', '.join(ABSOLUTE_SPREADS)}: s or rad"
    for key, spread in template.estimated.items():
        yield f"  {key}: {spread:g}"


def key_lines(
    section: str,
    values: Mapping[str, Any],
    units: Mapping[str, str],
    estimated: Mapping[str, float],
) -> Iterator[str]:
    """Yield one line for each value, with unit, remark and spread as a comment."""
    for name, value in values.items():
        key = f"{section}.{name}"
        said = [units.get(name, ""), COMMENTS.get(key, "")]
        said += [spread_text(key, estimated[key])] if key in estimated else []
        text = f"  {name}: {dump(value).splitlines()[0]}"
        comment = ", ".join(filter(None, said))
        yield f"{text:<38}# {comment}" if comment else text
