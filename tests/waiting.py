"""Waits for conditions, with timeouts that one environment variable scales.

`AMPC_TIMEOUT_SCALE=5` gives every wait of the tests five times as long. A timeout is only reached
where a test fails, so the timeouts are generous.
"""

import os
import time
from collections.abc import Callable

SCALE = float(os.environ.get("AMPC_TIMEOUT_SCALE") or 1.0)
TIMEOUT = 180.0 * SCALE
"""Wall time after which a wait has failed, compilation included [s]."""


def wait_for(condition: Callable[[], bool], period: float = 0.02) -> float:
    """Wait until a condition holds; return the time of that [s].

    Args:
        condition: Is evaluated every `period` seconds.
        period: Wall time between two evaluations [s].
    """
    limit = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < limit, f"the condition does not hold after {TIMEOUT:g} s"
        time.sleep(period)
    return time.time()
