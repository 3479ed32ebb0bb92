"""Message paths of Foxglove: topic, fields, slices `[:]` and filters `{name=="value"}`."""

import re
from typing import Any

TOPIC = re.compile(r"(/[\w/]+)(.*)")
STEP = re.compile(r"\.(\w+)|(\[:\])|\{(\w+)==\"([^\"]*)\"\}")


def split_path(path: str) -> tuple[str, str]:
    """Return topic and fields of a message path."""
    match = TOPIC.fullmatch(path)
    assert match, path
    return match[1], match[2]


def values_at(fields: str, message: Any) -> list[Any]:
    """Return the values that the fields of a message path select in a message."""
    found, end = [message], 0
    for step in STEP.finditer(fields):
        assert step.start() == end, fields  # nothing else, such as an index
        end = step.end()
        name, slice_, key, value = step.groups()
        if name:
            found = [getattr(each, name) for each in found]
        elif slice_:
            found = [item for each in found for item in each]
        else:
            found = [each for each in found if getattr(each, key) == value]
    assert end == len(fields), fields
    return found
