"""Drive for an hour round a circuit while random faults come: does anything grow, or give way?

`python tests/workshop/fault_matrix/endurance.py --hours 1` computes the drive in a minute or two.
The exit code is 0 where memory stays flat, no tick is missed, every command keeps to the guard's
limits and the car is never lost; 1 where one of these does not hold, 2 where an option is wrong.
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
from tests.workshop.acceptance.trials import DATA, LIMITS
from tests.workshop.fault_matrix.fault_loop import CommandedTick, FaultyDrive
from tests.workshop.fault_matrix.inject_cases import CASES, CIRCUIT
from tests.workshop.fault_matrix.inject_cells import Bench, Conditions

PAUSE = (10.0, 30.0)
"""From the end of one fault to the start of the next [s]."""
SHARE = (0.3, 1.0)
"""Of its duration in the matrix, that a fault takes."""
PIECE = 60.0
"""Time after which memory is looked at [s]."""
WARM = 5
"""Pieces after which memory has to stay as it is."""
GROWTH = 5.0
"""By which it may grow [MB]."""
TOLERANCE = 1.0e-9
"""Of a limit [rad]."""
HOURS = number(0.01, 100.0, "h")


class Minute(NamedTuple):
    """What one piece of the drive was like."""

    memory: float
    """Resident, at its end [MB]."""
    error: float
    """Largest [m]."""
    commands: int
    outside: int
    """Commands outside the guard's limits, or not finite."""
    below: int
    """Commands from below the top of the ladder."""


class Account(NamedTuple):
    """What the whole drive was like."""

    minutes: Sequence[Minute]
    faults: int
    rejected: int
    missed: int
    expected: int
    """Commands, one each period."""

    @property
    def growth(self) -> float:
        """Of memory, from minute WARM on [MB]; 0 in a shorter drive."""
        kept = [minute.memory for minute in self.minutes[WARM - 1 :]]
        return max(kept) - kept[0] if kept else 0.0

    def total(self, field: str) -> int:
        """Add a count up."""
        return sum(getattr(minute, field) for minute in self.minutes)

    @property
    def complaints(self) -> list[str]:
        """What does not hold."""
        worst = max(minute.error for minute in self.minutes)
        found = {
            f"memory grew by {self.growth:.1f} MB": self.growth >= GROWTH,
            f"{self.missed} ticks missed": self.missed > 0,
            f"{self.total('outside')} commands outside the limits": self.total("outside") > 0,
            f"the car was {worst:.1f} m off its path": not worst <= LOST,
        }
        return [sentence for sentence, holds in found.items() if holds]


def random_faults(duration: float, seed: int) -> tuple[Fault, ...]:
    """Draw faults of the matrix, one after the other, to both sides."""
    rng = np.random.default_rng(seed)
    found: list[Fault] = []
    time = float(rng.uniform(*PAUSE))
    while True:
        fault = CASES[rng.integers(len(CASES))].fault
        fault = fault.mirrored if rng.random() < 0.5 else fault
        length = round(fault.duration * float(rng.uniform(*SHARE)), 3)
        if time + length > duration:
            return tuple(found)
        found.append(replace(fault, start=round(time, 3), duration=length))
        time += length + float(rng.uniform(*PAUSE))


def resident() -> float:
    """Give the memory of this process, as Linux counts it [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1.0e6


def circuit(file: Path, duration: float) -> Scenario:
    """Give laps enough for a duration [s]."""
    lap = from_csv(file, limits=LIMITS)
    laps = math.ceil(duration / lap.duration)
    return from_csv(file, limits=LIMITS, laps=laps)._replace(duration=duration)


def endure(drive: FaultyDrive, pieces: Iterable[int]) -> list[Minute]:
    """Drive piece by piece; what was seen is judged after each, and forgotten."""
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
    """Whether a command is finite, no farther than any angle allowed, and no faster than allowed.

    Args:
        tick: With the command.
        guard: Whose limits hold.
        last: Command before it [rad].
    """
    angle = tick.record.command.steering
    bound = bounds(guard.limits, guard.chassis, tick.v_x)
    turn = min(bound.rate, bound.jerk) * guard.period * LONGEST_PAUSE
    inside = abs(angle) <= max(guard.limits.max_angle) and abs(angle - last) <= turn + TOLERANCE
    return math.isfinite(angle) and inside


def drive_for(duration: float, file: Path, conditions: Conditions, console: Console) -> Account:
    """Drive for a time, a multiple of PIECE [s]."""
    bench = Bench(conditions)
    faults = random_faults(duration, conditions.seed)
    drive = bench.drive(circuit(file, duration), faults)
    pieces = range(round(duration / PIECE))
    minutes = endure(drive, track(pieces, "minutes", console=console))
    expected = round(duration / drive.supervisor.period)
    drive.samples.append((0.0, 0.0, 0.0, 0.0))
    log = drive.log()
    return Account(minutes, len(faults), log.rejected.total(), log.missed, expected)


def table_of(account: Account) -> Table:
    """Lay the account out for the terminal."""
    minutes = account.minutes
    table = Table(title=Text("endurance"), title_justify="left", show_header=False)
    rows = {
        "simulated time": f"{len(minutes) * PIECE / 3600:.2f} h",
        "faults": str(account.faults),
        "commands": f"{account.total('commands')} of {account.expected} periods",
        "missed ticks": str(account.missed),
        "commands outside the limits": str(account.total("outside")),
        "commands from below the top of the ladder": str(account.total("below")),
        "refused inputs": str(account.rejected),
        "largest cross-track error": f"{max(each.error for each in minutes):.2f} m",
        f"memory from minute {WARM} to the end": f"{account.growth:+.2f} MB, to "
        f"{minutes[-1].memory:.1f} MB",
    }
    for row in rows.items():
        table.add_row(*row)
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive and judge; gives the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    circuit_file = DATA / "tracks" / f"{CIRCUIT}.csv"
    parser.add_argument("--hours", type=float, default=1.0, help="of the drive; default: 1")
    parser.add_argument("--path", type=Path, default=circuit_file, help="CSV of a circuit")
    parser.add_argument("--seed", type=int, default=0, help="of the faults; default: 0")
    chosen, console = parser.parse_args(arguments), Console(highlight=False, soft_wrap=True)
    try:
        check_range("--hours", chosen.hours, HOURS)
        check_range("--seed", chosen.seed, SEED)
        duration = math.ceil(chosen.hours * 3600 / PIECE) * PIECE
        account = drive_for(duration, chosen.path, Conditions(seed=chosen.seed), console)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return 2
    console.print(table_of(account))
    for complaint in account.complaints:
        console.print(Text.assemble(("does not hold:", "red"), f" {complaint}"))
    return 1 if account.complaints else 0


if __name__ == "__main__":
    sys.exit(main())
