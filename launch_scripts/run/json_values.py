"""Measured values as JSON represents them."""

import math
from typing import Any


def to_json(value: Any) -> Any:
    """Return a value with tuples as lists, and None in place of nan and infinity."""
    if isinstance(value, dict):
        return {key: to_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
