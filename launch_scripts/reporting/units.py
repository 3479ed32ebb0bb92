"""Numbers with units for readers: three digits, in the prefix that suits them."""

import math

NO_NUMBER = "\u2013"
"""Shown in place of a missing value."""
SHORT = 0.0995
"""Lengths below this are shown in millimetres [m]."""


def length_text(metres: float) -> str:
    """Return a length: millimetres below 0.1 m, such as `4.6 mm`, otherwise metres."""
    if not math.isfinite(metres):
        return NO_NUMBER
    if abs(metres) < SHORT:
        return f"{rounded_text(1e3 * metres)} mm"
    return f"{rounded_text(metres)} m"


def duration_text(seconds: float) -> str:
    """Return a short time: microseconds, milliseconds or seconds."""
    if not math.isfinite(seconds):
        return NO_NUMBER
    for factor, unit in ((1e6, "\u00b5s"), (1e3, "ms")):
        if abs(seconds) * factor < 995.0:
            return f"{rounded_text(factor * seconds)} {unit}"
    return f"{rounded_text(seconds)} s"


def rounded_text(value: float) -> str:
    """Return a number with at most two significant digits behind the point, without an exponent."""
    digits = 0 if abs(value) >= 99.5 else 1 if abs(value) >= 0.995 else 2
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if not float(text) else text
