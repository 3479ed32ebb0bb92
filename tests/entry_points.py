"""Executables of the packages, from their setup.py."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def entry_points() -> dict[str, str]:
    """Return the module of every executable, by package and name such as `ampc_ros/gate`."""
    points: dict[str, str] = {}
    for setup in sorted(ROOT.glob("*/setup.py")):
        found = re.findall(r'"(\w+) = ([\w.]+):main"', setup.read_text(encoding="utf-8"))
        points |= {f"{setup.parent.name}/{name}": module for name, module in found}
    return points


EXECUTABLES = entry_points()
