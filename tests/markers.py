"""Markers of the tests by file, for quick selections: `make check` and `make uncompiled`.

* `ros`: starts ROS nodes or other processes.
* `slow`: takes more than a few seconds of processor time, without ROS.
* `equations`: equations without ROS that are quick without compilation, too.
"""

from collections.abc import Iterator

EQUATIONS = {
    *("test_actuator", "test_car", "test_constraints", "test_gain_table", "test_interpolation"),
    *("test_laguerre", "test_lateral_mpc", "test_metrics", "test_model", "test_pacejka"),
    *("test_path", "test_prediction", "test_preview_model", "test_progress", "test_pure_pursuit"),
    *("test_qp", "test_scenario", "test_types"),
}
"""Files of the equations. ROS nodes and closed loops are left out: they would take minutes."""
MANY_SWEEPS = ("2000", "enough_sweeps")
"""Parts of the names of tests that solve hundreds of problems with thousands of sweeps."""
ROS: set[str] = set()
SLOW: set[str] = set()


def markers_of(file: str, folder: str, name: str) -> Iterator[str]:
    """Return the markers of a test by its file, folder and name."""
    if folder in ("nodes", "workshop") or file in ROS:
        yield "ros"
    elif file in SLOW:
        yield "slow"
    if file in EQUATIONS and not any(part in name for part in MANY_SWEEPS):
        yield "equations"
