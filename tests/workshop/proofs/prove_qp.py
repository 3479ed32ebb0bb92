"""Solve degenerate QPs, and check each solution by a certificate and by two other solvers.

`python -m tests.workshop.proofs.prove_qp [--problems 100000] [--seed 1]` (about 2 minutes) prints a
table by kind of problem. The exit code is 1 where a problem that x = 0, or a large enough slack,
satisfies is not solved, a residual is above the tolerance, or a solution contradicts that of DAQP
or of non-negative least squares. Problems of the kind `moved` have no such start: rounding may make
them infeasible, so they are only counted.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from ampc_ros.mpc.qp import INFEASIBLE, SOLVED, Qp
from tests.filled import QpSolution, active_set
from tests.workshop.proofs.qp_problems import (
    KINDS,
    TOLERANCE,
    by_daqp,
    by_nnls,
    degenerate_problem,
    disagreement,
    own_certificate,
    unit_problem,
)

CONTRADICTION = 1e-9
"""Largest half squared distance of two solutions beyond what their residuals allow."""
CLOSE = 1e-6
"""Distance within which two solutions are counted as equal, relative to the scale."""


class Verdict(NamedTuple):
    """Checks of one solution."""

    status: int
    """Status of the solver."""
    residual: float
    """Largest residual of the Kuhn-Tucker conditions; 0 if unsolved."""
    compared: tuple[bool, bool]
    """Whether DAQP and least squares have a solution."""
    equal: tuple[bool, bool]
    """Whether it is the same."""
    contradicts: tuple[bool, bool]
    """Whether both cannot be right within their residuals."""

    @property
    def wrong(self) -> bool:
        """Check whether the solution is not the minimum."""
        return self.residual > TOLERANCE or any(self.contradicts)


def check(qp: Qp, solution: QpSolution) -> Verdict:
    """Check one solution by its certificate and against both other solvers."""
    nothing = (False, False)
    unit = unit_problem(qp)
    if solution.status != SOLVED:
        return Verdict(solution.status, 0.0, nothing, nothing, nothing)
    own = own_certificate(qp, unit, solution.x, solution.multipliers)
    others = [by_daqp(unit), by_nnls(unit)]
    compared = [other is not None and other.residual < 1e-7 for other in others]
    distances = [
        float(np.linalg.norm(own.point - other.point)) if other else 0.0 for other in others
    ]
    contradicts = [
        other is not None and use and disagreement(unit, own, other) > CONTRADICTION
        for other, use in zip(others, compared, strict=True)
    ]
    equal = [use and each < CLOSE for use, each in zip(compared, distances, strict=True)]
    return Verdict(
        solution.status,
        own.residual,
        (compared[0], compared[1]),
        (equal[0], equal[1]),
        (contradicts[0], contradicts[1]),
    )


def verdicts(kind: str, problems: int, seed: int) -> Iterable[Verdict]:
    """Yield the verdicts on generated problems of one kind."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    for _ in range(problems):
        qp = degenerate_problem(rng, kind)
        yield check(qp, active_set(qp))


class Count(NamedTuple):
    """Result for one kind of problem."""

    problems: int
    wrong: int
    infeasible: int
    """Reported as infeasible, although all problems are feasible."""
    unfinished: int
    residual: float
    """Largest residual of a solution."""
    daqp: tuple[int, int]
    """Solved by DAQP; of these the same point."""
    nnls: tuple[int, int]
    """Solved by least squares; of these the same point."""

    @property
    def failed(self) -> bool:
        """Check whether any problem is not solved correctly."""
        return self.wrong + self.infeasible + self.unfinished > 0


def count(each: Iterable[Verdict]) -> Count:
    """Count verdicts."""
    results = list(each)
    return Count(
        len(results),
        sum(result.wrong for result in results),
        sum(result.status == INFEASIBLE for result in results),
        sum(result.status not in {SOLVED, INFEASIBLE} for result in results),
        max((result.residual for result in results), default=0.0),
        (sum(r.compared[0] for r in results), sum(r.equal[0] for r in results)),
        (sum(r.compared[1] for r in results), sum(r.equal[1] for r in results)),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Solve and check, print a table, return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--problems", type=int, default=100_000, help="number of problems")
    parser.add_argument("--seed", type=int, default=1, help="seed of the generator")
    chosen, failed = parser.parse_args(arguments), False
    table = Table(
        *("kind", "problems", "wrong", "infeasible", "unfinished", "residual", "DAQP", "NNLS"),
        title="Degenerate QPs, all feasible; largest residual; share of the problems that DAQP and "
        "NNLS solve in which they find the same point",
        box=box.SIMPLE,
        pad_edge=False,
    )
    for i, kind in enumerate(KINDS):
        share = chosen.problems // len(KINDS) + (i < chosen.problems % len(KINDS))
        result = count(verdicts(kind, share, chosen.seed))
        numbers = [*result[:4], f"{result.residual:.1e}"]
        numbers += [f"{same / max(solved, 1):.0%}" for solved, same in result[-2:]]
        table.add_row(kind, *map(str, numbers))
        failed |= result.failed and kind != "moved"
    Console(highlight=False).print(table)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
