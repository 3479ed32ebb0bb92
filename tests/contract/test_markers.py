"""Markers: every name in the lists is that of a file or a test."""

import re
from pathlib import Path

from tests.markers import EQUATIONS, ROS, SLOW

TESTS = Path(__file__).resolve().parents[1]


def test_every_marked_name_is_that_of_a_file_or_a_test() -> None:
    files = list(TESTS.rglob("test_*.py"))
    tests = {name for file in files for name in re.findall(r"def (test_\w+)", file.read_text())}
    assert (EQUATIONS | ROS | SLOW) - tests - {file.stem for file in files} == set()
