"""Ask the public database of vulnerabilities about every package in lock/. `make audit`.

The exit code is 0 where all is well, 1 where a package is known to be vulnerable, and 2 where
nothing could be asked.
"""

import json
import subprocess
import sys
from collections.abc import Iterable
from typing import Any, NamedTuple

from launch_scripts.lock import LOCKS

ASK = [
    *(sys.executable, "-m", "pip_audit", "--disable-pip", "--require-hashes"),
    *("--format=json", "--progress-spinner=off", "--timeout=15"),
]
VULNERABLE, NOT_ASKED = 1, 2


class Findings(NamedTuple):
    """What the database says."""

    known: set[str]
    """Packages that it knows, by name and version."""
    unknown: set[str]
    vulnerable: set[str]
    """One line each: package, number of the vulnerability, versions that mend it."""


def findings(packages: Iterable[Any]) -> Findings:
    """Sort what pip-audit gives as JSON."""
    found = Findings(set(), set(), set())
    for package in packages:
        if "skip_reason" in package:
            found.unknown.add(package["name"])
            continue
        name = f"{package['name']} {package['version']}"
        found.known.add(name)
        for each in package["vulns"]:
            mended = ", ".join(each["fix_versions"]) or "no version"
            found.vulnerable.add(f"{name}: {each['id']}, mended in {mended}")
    return found


def judge(found: Findings) -> tuple[str, int]:
    """Give what is to be said, and the exit code."""
    if not found.known:
        return "audit: the database knows none of the packages: nothing is audited", NOT_ASKED
    unknown = f"; not in the database: {len(found.unknown)}" if found.unknown else ""
    total = f"audit: {len(found.known)} packages, {len(found.vulnerable)} vulnerabilities{unknown}"
    return "\n".join([*sorted(found.vulnerable), total]), VULNERABLE if found.vulnerable else 0


def main() -> int:
    """Audit; gives the exit code."""
    packages: list[Any] = []
    for lock in sorted(LOCKS.glob("*.txt")):
        done = subprocess.run([*ASK, "-r", str(lock)], capture_output=True, text=True)
        try:
            packages += json.loads(done.stdout)["dependencies"]
        except ValueError:
            last = (done.stderr.strip().splitlines() or ["without a word"])[-1]
            print(f"audit: the database cannot be asked: {last}")
            return NOT_ASKED
    words, code = judge(findings(packages))
    print(words)
    return code


if __name__ == "__main__":
    sys.exit(main())
