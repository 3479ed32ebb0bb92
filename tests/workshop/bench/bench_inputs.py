"""Measure what large inputs and help cost: part `inputs` of `make bench`.

The time of PyYAML's own parser and of NumPy's import are measured in the same run, for comparison.
"""

import resource
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np
import yaml
from rclpy.serialization import serialize_message

from ampc_msgs_config import config, ros
from ampc_msgs_config.nodes.serialized_path import has_positions_of, preamble
from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.types import Array
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.nodes.received_path import PathRequest, Shift, build_path, prepare
from tests.workshop.bench.bench_report import Section

ROOT = Path(__file__).resolve().parents[3]
COMMANDS = sorted(
    file.stem
    for file in (ROOT / "launch_scripts").glob("*.py")
    if file.stem not in ("__init__", "setup")
)
TITLE = "Large inputs and help"
NOTE = (
    "Processor times, those of texts, repeated paths and help the least of three. The threshold of "
    "help is twice the time of NumPy's import in the same run."
)
YAML_THRESHOLD, HELP_RATIO = 1.0, 2.0
PATH_THRESHOLDS = {10_000: 0.01, 100_000: 0.1, 1_000_000: 1.0}
AGAIN_THRESHOLDS = {100_000: 0.001}
"""By number of poses [s]."""
YAML_SIZE = 4_900_000
"""Size of the YAML texts [characters]."""
PURE_SHARE = 50
"""PyYAML's own parser reads this fraction of the text."""
ROUNDS = 3

TimeRow = tuple[str, float, float | None]
"""What is measured, processor time [s], its threshold [s]."""


def measure(*, quick: bool) -> list[Section]:
    """Return one table of processor times, and its thresholds."""
    counts = (1_000,) if quick else tuple(PATH_THRESHOLDS)
    yaml_size = YAML_SIZE // PURE_SHARE if quick else YAML_SIZE
    commands = COMMANDS[:1] if quick else COMMANDS
    rows = [*yaml_rows(yaml_size), *path_rows(counts), *help_rows(commands)]
    heads = "what", "processor time [s]", "threshold [s]"
    return [Section("inputs", TITLE, NOTE, [dict(zip(heads, row, strict=True)) for row in rows])]


def least(function: Callable[[], object]) -> float:
    """Return the least processor time of some calls [s]."""
    times = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        function()
        times.append(time.process_time() - begin)
    return min(times)


def yaml_rows(size: int) -> Iterator[TimeRow]:
    """Yield the times of YAML texts of a size [characters]."""
    rng = np.random.default_rng(1)
    numbers = rng.uniform(-100.0, 100.0, (400_000, 2)).tolist()
    shapes = {
        "key: number": [f"key_{i}: {x:.4f}\n" for i, (x, _) in enumerate(numbers)],
        "list of pairs": ["points:\n", *(f"  - [{x:.6f}, {y:.6f}]\n" for x, y in numbers)],
    }
    for name, lines in shapes.items():
        text = "".join(lines)
        text = text[: text.rindex("\n", 0, size) + 1]
        part = text[: text.rindex("\n", 0, size // PURE_SHARE) + 1]
        label = f"YAML, {len(text) / 1e6:.1f} MB, {name}"
        duration = least(lambda text=text: config.parse(text, "text"))  # type: ignore[misc]
        yield label, duration, YAML_THRESHOLD
        begin = time.process_time()
        with patch.object(yaml, "__with_libyaml__", False):
            config.parse(part, "text")
        pure = (time.process_time() - begin) * len(text) / len(part)
        yield f"the same with PyYAML's own parser, extrapolated from 1/{PURE_SHARE}", pure, None


def serialized(points: Array) -> bytes:
    """Return the path message through points (n, 2) [m], built from the bytes of a short one."""
    three = serialize_message(ros.path_message(points[:3], 5, "map"))
    two = serialize_message(ros.path_message(points[:2], 5, "map"))
    count, row = len(points), len(three) - len(two)
    head = bytearray(two[:-row])
    struct.pack_into("<I", head, preamble(two).offset - 4, count)
    rows = np.tile(np.frombuffer(three[-row:], np.uint8), (count - 1, 1))
    rows[:, row - 56 : row - 40] = np.ascontiguousarray(points[1:]).view(np.uint8)
    return bytes(head) + rows.tobytes()


def path_rows(counts: Sequence[int]) -> Iterator[TimeRow]:
    """Yield the times from serialised paths of some numbers of poses to smoothed ones."""
    chassis = load_section(ChassisParameters, config.find("vehicles", "paper"), "chassis")
    request = PathRequest(Shift(), chassis, 0.5, None)
    prepare()
    for count in counts:
        s = 0.1 * np.arange(count)
        points = np.column_stack((s, 20.0 * np.sin(s / 60.0)))
        data, other = serialized(points), serialized(points + 1.0)
        begin = time.process_time()
        build_path(data, request)
        duration = time.process_time() - begin
        label = f"path of {count:,} poses, 0.1 m apart"
        yield f"{label}: read, check, smooth", duration, PATH_THRESHOLDS.get(count)
        again = bytes(bytearray(data))
        assert has_positions_of(again, data)
        assert not has_positions_of(other, data)
        took = least(lambda a=again, b=data: has_positions_of(a, b))  # type: ignore[misc]
        yield f"{label}: recognise it when it is sent again", took, AGAIN_THRESHOLDS.get(count)


def help_rows(commands: Sequence[str]) -> Iterator[TimeRow]:
    """Yield the times of NumPy's import and of the help of commands."""
    numpy = process_time("-c", "import numpy")
    yield "`python -c 'import numpy'`", numpy, None
    for name in commands:
        file = str(ROOT / "launch_scripts" / f"{name}.py")
        yield f"`{name}.py --help`", process_time(file, "--help"), HELP_RATIO * numpy


def process_time(*arguments: str) -> float:
    """Return the least processor time of a Python process [s]."""
    times = []
    for _ in range(ROUNDS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)
