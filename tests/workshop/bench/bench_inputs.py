"""Measure what large inputs and help cost: `python -m tests.workshop.bench.bench_inputs`.

Prints a Markdown table of processor times, each the least of three. The time of PyYAML's own parser
and of NumPy's import are measured in the same run, for comparison.
"""

import argparse
import resource
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
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

ROOT = Path(__file__).resolve().parents[3]
COMMANDS = sorted(
    file.stem
    for file in (ROOT / "launch_scripts").glob("*.py")
    if file.stem not in ("__init__", "setup")
)
YAML_SIZE = 4_900_000
"""Size of the YAML texts [characters]."""
PURE_SHARE = 50
"""PyYAML's own parser reads this fraction of the text."""
ROUNDS = 3


def main() -> None:
    """Print the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    print("| what | processor time [s] |\n|---|---|")
    for what, seconds in [*yaml_rows(), *path_rows(), *help_rows()]:
        print(f"| {what} | {seconds:.3g} |", flush=True)


def least(function: Callable[[], object]) -> float:
    """Return the least processor time of some calls [s]."""
    times = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        function()
        times.append(time.process_time() - begin)
    return min(times)


def yaml_rows() -> Iterator[tuple[str, float]]:
    """Yield the times of YAML texts."""
    rng = np.random.default_rng(1)
    numbers = rng.uniform(-100.0, 100.0, (400_000, 2)).tolist()
    shapes = {
        "key: number": [f"key_{i}: {x:.4f}\n" for i, (x, _) in enumerate(numbers)],
        "list of pairs": ["points:\n", *(f"  - [{x:.6f}, {y:.6f}]\n" for x, y in numbers)],
    }
    for name, lines in shapes.items():
        text = "".join(lines)
        text = text[: text.rindex("\n", 0, YAML_SIZE) + 1]
        part = text[: text.rindex("\n", 0, YAML_SIZE // PURE_SHARE) + 1]
        label = f"YAML, {len(text) / 1e6:.1f} MB, {name}"
        yield label, least(lambda text=text: config.parse(text, "text"))  # type: ignore[misc]
        begin = time.process_time()
        with patch.object(yaml, "__with_libyaml__", False):
            config.parse(part, "text")
        pure = (time.process_time() - begin) * len(text) / len(part)
        yield f"the same with PyYAML's own parser, extrapolated from 1/{PURE_SHARE}", pure


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


def path_rows() -> Iterator[tuple[str, float]]:
    """Yield the times from a serialised path to a smoothed one."""
    chassis = load_section(ChassisParameters, config.find("vehicles", "paper"), "chassis")
    request = PathRequest(Shift(), chassis, 0.5, None)
    prepare()
    for count in (10_000, 100_000, 1_000_000):
        s = 0.1 * np.arange(count)
        points = np.column_stack((s, 20.0 * np.sin(s / 60.0)))
        data, other = serialized(points), serialized(points + 1.0)
        begin = time.process_time()
        build_path(data, request)
        label = f"path of {count:,} poses, 0.1 m apart"
        yield f"{label}: read, check, smooth", time.process_time() - begin
        again = bytes(bytearray(data))
        assert has_positions_of(again, data)
        assert not has_positions_of(other, data)
        yield (
            f"{label}: recognise it when it is sent again",
            least(
                lambda a=again, b=data: has_positions_of(a, b)  # type: ignore[misc]
            ),
        )


def help_rows() -> Iterator[tuple[str, float]]:
    """Yield the times of NumPy's import and of the help of commands."""
    yield "`python -c 'import numpy'`", process_time("-c", "import numpy")
    for name in COMMANDS:
        file = str(ROOT / "launch_scripts" / f"{name}.py")
        yield f"`{name}.py --help`", process_time(file, "--help")


def process_time(*arguments: str) -> float:
    """Return the least processor time of a Python process [s]."""
    times = []
    for _ in range(ROUNDS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)


if __name__ == "__main__":
    main()
