"""`compile_all` compiles all that the first drives need."""

import os
import subprocess
import sys
from functools import partial

import pytest

from launch_scripts import compile_all

PROGRAM = """
from launch_scripts import compile_all
from tests.workshop.proofs.compile_times import dispatchers, name_of

def compiled():
    return {(name_of(each), *map(str, each.signatures)) for each in dispatchers()}

for pair in compile_all.PAIRS:
    for part in pair:
        part()
before = compiled()
for name in ("preview", "paper", "classic"):
    compile_all.compile_controller(name)
    compile_all.compile_fleet(name)
late = sorted(each[0] for each in compiled() - before if each[1:])
raise SystemExit(", ".join(late) or 0)
"""


@pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")
def test_no_controller_or_fleet_compiles_anything_afterwards() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_part_that_fails_in_the_other_process_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(compile_all, "PAIRS", ((int, partial(sys.exit, 3)),))
    with pytest.raises(RuntimeError, match="exit code 3"):
        compile_all.compile_everything()
