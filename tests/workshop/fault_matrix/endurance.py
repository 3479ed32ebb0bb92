"""Endurance test: drive a circuit for hours with random faults.

`python -m tests.workshop.fault_matrix.endurance --hours 1` computes the drive in about two minutes.
Exit code 0: memory stays constant, no tick is missed, every command is within the limits of the
guard, and the car stays on the road; 1: one of these conditions fails; 2: wrong option.
"""

import argparse
import math
import os
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from rich.text import Text

from ampc_msgs_config.metrics import LOST
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.validation import check_range, number
from ampc_ros.supervision.guard import LONGEST_PAUSE, Guard, bounds
from launch_scripts.faults.schedule import SEED, Fault
from tests.workshop.acceptance.road_data import DATA
from tests.workshop.acceptance.trials import LIMITS
from tests.workshop.fault_matrix.fault_loop import CommandedTick, FaultyDrive
from tests.workshop.fault_matrix.inject_cases import CASES, CIRCUIT
from tests.workshop.fault_matrix.inject_cells import Bench, Conditions

PAUSE = (10.0, 30.0)
"""Range of the time from the end of a fault to the start of the next [s]."""
SHARE = (0.3, 1.0)
"""Range of the duration of a fault, relative to the matrix."""
PIECE = 60.0
"""Interval of memory measurements [s]."""
WARM = 5
"""Number of intervals after which memory must be constant."""
GROWTH = 5.0
"""Allowed growth of memory [MB]."""
TOLERANCE = 1.0e-9
"""Tolerance of a limit [rad]."""
HOURS = number(0.01, 100.0, "h")


class Minute(NamedTuple):
    """Results of one interval of the drive."""

    memory: float
    """Resident memory at the end [MB]."""
    error: float
    """Largest cross-track error [m]."""
    commands: int
    outside: int
    """Number of commands outside the limits of the guard, or not finite."""
    below: int
    """Number of commands from a fallback."""


class EnduranceResult(NamedTuple):
    """Results of the whole drive."""

    minutes: Sequence[Minute]
    faults: int
    rejected: int
    missed: int
    expected: int
    """Expected number of commands, one each period."""

    @property
    def growth(self) -> float:
        """Growth of memory from interval WARM on [MB]; 0 in a shorter drive."""
        kept = [minute.memory for minute in self.minutes[WARM - 1 :]]
        return max(kept) - kept[0] if kept else 0.0

    def total(self, field: str) -> int:
        """Return the sum of a field over all intervals."""
        return sum(getattr(minute, field) for minute in self.minutes)

    @property
    def failures(self) -> list[str]:
        """Conditions that fail."""
        worst = max(minute.error for minute in self.minutes)
        conditions = {
            f"memory grew by {self.growth:.1f} MB": self.growth >= GROWTH,
            f"{self.missed} ticks missed": self.missed > 0,
            f"{self.total('outside')} commands outside the limits": self.total("outside") > 0,
            f"the car was {worst:.1f} m off its path": not worst <= LOST,
        }
        return [sentence for sentence, fails in conditions.items() if fails]


def random_faults(duration: float, seed: int) -> tuple[Fault, ...]:
    """Return a random sequence of faults of the matrix, half of them mirrored."""
    rng = np.random.default_rng(seed)
    faults: list[Fault] = []
    time = float(rng.uniform(*PAUSE))
    while True:
        fault = CASES[rng.integers(len(CASES))].fault
        fault = fault.mirrored if rng.random() < 0.5 else fault
        length = round(fault.duration * float(rng.uniform(*SHARE)), 3)
        if time + length > duration:
            return tuple(faults)
        faults.append(replace(fault, start=round(time, 3), duration=length))
        time += length + float(rng.uniform(*PAUSE))


def resident() -> float:
    """Return the resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1.0e6


def circuit(file: Path, duration: float) -> Scenario:
    """Return enough laps of a circuit for a duration [s]."""
    lap = from_csv(file, limits=LIMITS)
    laps = math.ceil(duration / lap.duration)
    return from_csv(file, limits=LIMITS, laps=laps)._replace(duration=duration)


def endure(drive: FaultyDrive, pieces: Iterable[int]) -> list[Minute]:
    """Drive in intervals; evaluate and discard the log after each."""
    minutes, last = [], 0.0
    for piece in pieces:
        drive.run((piece + 1) * PIECE)
        supervisor, ticks = drive.supervisor, drive.ticks
        config = supervisor.config
        guard = Guard(config.guard, config.chassis, supervisor.period)
        outside = 0
        for tick in ticks:
            outside += not is_inside(tick, guard, last)
            last = tick.record.command.steering
        below = sum(tick.record.command.rung > 0 for tick in ticks)
        error = max(abs(seen[1]) for seen in drive.samples)
        minutes.append(Minute(resident(), error, len(ticks), outside, below))
        drive.samples.clear()
        drive.ticks.clear()
    return minutes


def is_inside(tick: CommandedTick, guard: Guard, last: float) -> bool:
    """Check that a command is finite and within the limits of angle, rate and jerk.

    Args:
        tick: CommandedTick with the command.
        guard: Guard with the limits.
        last: Previous command [rad].
    """
    angle = tick.record.command.steering
    bound = bounds(guard.limits, guard.chassis, tick.v_x)
    turn = min(bound.rate, bound.jerk) * guard.period * LONGEST_PAUSE
    inside = abs(angle) <= max(guard.limits.max_angle) and abs(angle - last) <= turn + TOLERANCE
    return math.isfinite(angle) and inside


def drive_for(
    duration: float, file: Path, conditions: Conditions, console: Console
) -> EnduranceResult:
    """Drive for a duration, a multiple of PIECE [s]."""
    bench = Bench(conditions)
    faults = random_faults(duration, conditions.seed)
    drive = bench.drive(circuit(file, duration), faults)
    pieces = range(round(duration / PIECE))
    minutes = endure(drive, track(pieces, "minutes", console=console))
    expected = round(duration / drive.supervisor.period)
    drive.samples.append((0.0, 0.0, 0.0, 0.0))
    log = drive.log()
    return EnduranceResult(minutes, len(faults), log.rejected.total(), log.missed, expected)


def result_table(result: EnduranceResult) -> Table:
    """Format the results for the terminal."""
    minutes = result.minutes
    table = Table(title=Text("endurance"), title_justify="left", show_header=False)
    rows = {
        "simulated time": f"{len(minutes) * PIECE / 3600:.2f} h",
        "faults": str(result.faults),
        "commands": f"{result.total('commands')} of {result.expected} periods",
        "missed ticks": str(result.missed),
        "commands outside the limits": str(result.total("outside")),
        "commands from a fallback": str(result.total("below")),
        "rejected inputs": str(result.rejected),
        "largest cross-track error": f"{max(each.error for each in minutes):.2f} m",
        f"memory from minute {WARM} to the end": f"{result.growth:+.2f} MB, to "
        f"{minutes[-1].memory:.1f} MB",
    }
    for row in rows.items():
        table.add_row(*row)
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, print the results, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    circuit_file = DATA / "tracks" / f"{CIRCUIT}.csv"
    parser.add_argument(
        "--hours", type=float, default=1.0, help="duration of the drive; default: 1"
    )
    parser.add_argument("--path", type=Path, default=circuit_file, help="CSV of a circuit")
    parser.add_argument("--seed", type=int, default=0, help="seed of the faults; default: 0")
    chosen, console = parser.parse_args(arguments), Console(highlight=False, soft_wrap=True)
    try:
        check_range("--hours", chosen.hours, HOURS)
        check_range("--seed", chosen.seed, SEED)
        duration = math.ceil(chosen.hours * 3600 / PIECE) * PIECE
        result = drive_for(duration, chosen.path, Conditions(seed=chosen.seed), console)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return 2
    console.print(result_table(result))
    for failure in result.failures:
        console.print(Text.assemble(("failed:", "red"), f" {failure}"))
    return 1 if result.failures else 0


if __name__ == "__main__":
    sys.exit(main())
