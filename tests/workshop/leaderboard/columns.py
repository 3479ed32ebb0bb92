"""Columns of the leaderboard, and the rule of winning (stated in `leaderboard`)."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ampc_msgs_config.scenarios.scenario import Scenario
from tests.workshop.leaderboard.drives import (
    DISTURBANCES,
    STEP_NS,
    Result,
    Row,
    Steering,
    drive_row,
    plant,
    road_of,
    shipped,
    yardstick,
)
from tests.workshop.leaderboard.kinematic_mpc import KinematicMpc
from tests.workshop.leaderboard.lag_mpc import LagMpc
from tests.workshop.leaderboard.preview_lq import PreviewLq
from tests.workshop.leaderboard.pursuit import RegulatedPurePursuit
from tests.workshop.leaderboard.stanley import Stanley
from tests.workshop.leaderboard.yardstick import Yardstick

SAME, SAME_SHARE = 0.001, 0.02
"""Differences of the largest error that do not count [m], and as a share."""
MORE_ACTIVE = 1.5
"""Largest ratio of the steering activity to that of the best yardstick."""


class Column(NamedTuple):
    """A controller of the leaderboard: settings and gains of ours, or a yardstick."""

    title: str
    settings: str = ""
    gains: str = ""
    configured: bool = False
    """Whether the parameters of the actuator are configured."""
    yardstick: type[Yardstick] | None = None
    source: str = ""
    """Publication of a yardstick."""

    @property
    def is_ours(self) -> bool:
        """Whether this is a controller of the product."""
        return self.yardstick is None

    @property
    def decides(self) -> bool:
        """Whether the lost rows of this column decide the exit code."""
        return self.is_ours and not self.configured

    def drives(self, row: Row) -> bool:
        """Return whether the row has a cell in this column."""
        return not (self.configured and row.actuator_is_ideal)

    def make(self, row: Row, road: Scenario) -> Steering:
        """Build the controller for a row."""
        if self.yardstick is not None:
            return yardstick(self.yardstick, row, road)
        configured = self.configured
        return shipped(self.settings, self.gains, configured=configured, row=row, road=road)


COLUMNS = {
    "preview": Column("preview, 10 Hz", "table3"),
    "preview_50hz": Column("preview, 50 Hz", "50hz", "preview_50hz"),
    "preview_configured": Column("preview, 10 Hz, actuator configured", "table3", "", True),
    "preview_50hz_configured": Column(
        "preview, 50 Hz, actuator configured", "50hz", "preview_50hz", True
    ),
    "preview_lq": Column(
        "preview LQ, 20 Hz",
        yardstick=PreviewLq,
        source="Sharp and Valtetsiotis, Vehicle System Dynamics 35 (2001)",
    ),
    "kinematic_mpc": Column(
        "kinematic MPC, 20 Hz",
        yardstick=KinematicMpc,
        source="Kong et al., IEEE Intelligent Vehicles Symposium 2015",
    ),
    "lag_mpc": Column(
        "MPC with lag and delay, 33 Hz",
        yardstick=LagMpc,
        source="Autoware's `autoware_mpc_lateral_controller` with its default parameters",
    ),
    "stanley": Column(
        "Stanley, 20 Hz",
        yardstick=Stanley,
        source="Hoffmann et al., American Control Conference 2007",
    ),
    "pure_pursuit": Column(
        "regulated pure pursuit, 20 Hz",
        yardstick=RegulatedPurePursuit,
        source="Macenski et al., Autonomous Robots 47 (2023)",
    ),
}


def drive_cell(row: Row, name: str) -> Result:
    """Return the numbers of a column in a row."""
    return drive_row(row, COLUMNS[name].make)


def compile_for(rows: Sequence[Row], columns: Sequence[str]) -> None:
    """Compile what these cells use: the independent plant, and the columns."""
    for row in rows:
        if row.car == "independent":
            plant(row, road_of(row.road, row.car)).advance(0.0, 9.0, STEP_NS)
            break
    for name in columns:
        row = Row("lane_change", "ordinary", DISTURBANCES[0])
        COLUMNS[name].make(row, road_of(row.road, row.car))


def beats(other: float, error: float) -> bool:
    """Return whether a largest error is smaller than ours by more than a tie [m]."""
    return other < error - SAME and other < (1 - SAME_SHARE) * error


def reason_of_loss(ours: Result, yardsticks: Mapping[str, Result]) -> str:
    """Return why a controller of ours loses a row, in one line; empty: it wins."""
    if not ours.stays:
        return "leaves the road"
    staying = {name: result for name, result in yardsticks.items() if result.stays}
    if not staying:
        return ""
    best = min(staying, key=lambda name: staying[name].max)
    other = staying[best]
    if beats(other.max, ours.max):
        return f"{best} has {other.max:.3f} m"
    if ours.activity > MORE_ACTIVE * other.activity:
        return f"{ours.activity / other.activity:.1f} times the activity of {best}"
    return ""
