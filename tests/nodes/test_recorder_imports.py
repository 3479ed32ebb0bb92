"""The recorder starts without compiled code: it loads neither numba nor SciPy."""

import subprocess
import sys


def test_the_recorder_loads_neither_numba_nor_scipy() -> None:
    code = (
        "import sys, ampc_msgs_config.nodes.recorder_node;"
        "print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    loaded = done.stdout.split()
    assert {"rclpy", "mcap"} <= set(loaded)
    assert not {"numba", "scipy", "llvmlite", "msgspec"} & set(loaded)
