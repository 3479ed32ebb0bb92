"""Leaderboard: yardsticks, delivery of states, and the rule of winning."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.supervision.supervisor import Supervisor
from tests.workshop.acceptance.independent_plant import IndependentSimulation
from tests.workshop.leaderboard import leaderboard, preview_lq
from tests.workshop.leaderboard.columns import COLUMNS, beats, reason_of_loss
from tests.workshop.leaderboard.drives import (
    DISTURBANCES,
    SEEDS,
    STEP_NS,
    Disturbance,
    Odometry,
    Result,
    Row,
    Steering,
    Supervised,
    all_rows,
    drive,
    drive_row,
    limits,
    plant,
    road_of,
    vehicle_of,
)
from tests.workshop.leaderboard.first_move import (
    Differences,
    Model,
    first_differences,
    first_move,
)
from tests.workshop.leaderboard.leaderboard_page import Board, read_yardsticks, write_json

NOMINAL = DISTURBANCES[0]
YARDSTICKS = [name for name, column in COLUMNS.items() if not column.is_ours]
LARGEST = {
    "preview_configured": 0.01,
    "preview_50hz": 0.02,
    "preview_lq": 0.05,
    "kinematic_mpc": 0.35,
    "lag_mpc": 0.6,
    "stanley": 0.05,
    "pure_pursuit": 0.4,
}
"""Largest errors on the gentle road [m]; without control it would be 4 m."""


class Recorder:
    """Controller that drives straight on and records what it gets."""

    period, guided_point = 0.05, 0.0

    def __init__(self) -> None:
        """Start without states."""
        self.got: list[tuple[VehicleState, int]] = []

    def command(self, state: VehicleState, now_ns: int) -> float:
        """SearchRecord state and time."""
        self.got.append((state, now_ns))
        return 0.0


def record(disturbance: Disturbance, seed: int | None = None) -> list[tuple[VehicleState, int]]:
    """Return all states of a drive without steering, and the times at which they arrive."""
    recorder = Recorder()
    drive(Row("sc1", "ordinary", disturbance), lambda row, road: recorder, seed)
    return recorder.got


@pytest.mark.parametrize("name", LARGEST)
def test_each_controller_follows_a_gentle_road(name: str) -> None:
    result = drive_row(Row("sine", "ordinary", NOMINAL), COLUMNS[name].make)
    assert 0 < result.rms < result.max < LARGEST[name]
    assert 0 < result.activity < 1.0


@pytest.mark.parametrize("name", YARDSTICKS)
def test_a_mirrored_drive_has_mirrored_steering(name: str) -> None:
    row = Row("lane_change", "ordinary", Disturbance("", offset=1.0, bias_deg=1.0))
    left = drive(row, COLUMNS[name].make)
    right = drive(row, COLUMNS[name].make, mirrored=True)
    np.testing.assert_allclose(right.steering, -left.steering, atol=1e-6)
    np.testing.assert_allclose(right.error, -left.error, atol=1e-5)


@pytest.mark.parametrize("index", [5, 11, 25])
def test_the_gains_of_the_preview_lq_solve_the_riccati_equation_with_the_road_as_state(
    index: int,
) -> None:
    chassis = vehicle_of("ordinary").chassis
    A, B, X, U = preview_lq.model(chassis, index * preview_lq.GRID)
    n = preview_lq.PREVIEW
    road = np.eye(n, k=1)  # the changes of the curvature move towards the car
    A_all = np.block([[A, -np.outer(X, np.eye(n)[0])], [np.zeros((n, 4)), road]])
    B_all = np.concatenate((B, np.zeros(n)))[:, None]
    Q_all = np.zeros((n + 4, n + 4))
    Q_all[:4, :4] = preview_lq.Q
    P = solve_discrete_are(A_all, B_all, Q_all, np.array([[preview_lq.R]]))
    K = np.linalg.solve(preview_lq.R + B_all.T @ P @ B_all, B_all.T @ P @ A_all)[0]
    gains = preview_lq.gains(chassis, index)
    np.testing.assert_allclose(gains.state, K[:4], rtol=1e-6)
    # kappa(i) in terms of its changes: the gain of a change is the sum of all later curvatures
    later = np.cumsum(gains.curvature[::-1])[::-1]
    np.testing.assert_allclose(later[1:], -K[4:], atol=1e-6)
    assert later[0] == pytest.approx(U + K[:4] @ X)


def test_the_preview_lq_steers_a_steady_circle_without_error() -> None:
    chassis, kappa, index = vehicle_of("ordinary").chassis, 0.02, 12
    _, _, X, U = preview_lq.model(chassis, index * preview_lq.GRID)
    gains = preview_lq.gains(chassis, index)
    angle = -gains.state @ (X * kappa) + gains.curvature.sum() * kappa
    assert angle == pytest.approx(U * kappa)


def test_the_first_move_minimises_the_cost() -> None:
    rng = np.random.default_rng(0)
    A, B, E = rng.normal(size=(2, 2)) / 2, rng.normal(size=2), rng.normal(size=2)
    N, R, steady = 4, 0.3, np.array([0.1, -0.2])
    Q = rng.uniform(0.5, 2.0, size=(N, 2))
    cost = Differences(0.7, *first_differences(N, 0.5))
    move = first_move(Model(A, B, E), Q, steady, R, (cost,))
    x0, kappa, wanted = rng.normal(size=2), rng.normal(size=N + 1), rng.normal(size=N)
    before = rng.normal(size=2)

    def residuals(u: Array) -> Array:
        x, parts = x0, []
        for i in range(N):
            x = A @ x + B * u[i] + E * kappa[i]
            parts += [np.sqrt(Q[i]) * (x - steady * kappa[i + 1])]
        parts += [math.sqrt(R) * (u - wanted)]
        parts += [math.sqrt(cost.weight) * (cost.now @ u + cost.before @ before)]
        return np.concatenate(parts)

    zero = residuals(np.zeros(N))
    slopes = np.column_stack([residuals(unit) - zero for unit in np.eye(N)])
    best = np.linalg.lstsq(slopes, -zero, rcond=None)[0]
    angle = move.state @ x0 + move.curvature @ kappa + move.reference @ wanted
    assert angle + move.before @ before == pytest.approx(best[0])


def test_the_compiled_plant_is_the_independent_plant() -> None:
    disturbance = Disturbance("", delay=0.1, gust=True, friction=0.5)
    row = Row("sc1_falcone", "independent", disturbance)
    fast = plant(row, road_of(row.road, row.car))
    slow = IndependentSimulation(fast.scenario, 2, fast.disturbance)  # type: ignore[union-attr]
    rng = np.random.default_rng(0)
    for angle in rng.normal(0.0, 0.03, size=20).tolist():
        for car in (fast, slow):
            car.advance(angle, 11.0, 10 * STEP_NS)
    assert fast.measure(0) == pytest.approx(slow.measure(0), abs=1e-9)  # type: ignore[union-attr]


@pytest.mark.parametrize("late", [0.0, 0.05, 0.15])
def test_late_odometry_is_the_earlier_state_with_its_own_stamp(late: float) -> None:
    on_time = {state.stamp_ns: state for state, _ in record(NOMINAL)}
    delayed = record(Disturbance("", late=late))
    age_ns = round(late * NANOSECONDS)
    assert delayed[0][1] == NANOSECONDS + age_ns
    for state, now_ns in delayed:
        assert state.stamp_ns == now_ns - age_ns
        assert state == on_time[state.stamp_ns]


def test_a_late_state_reaches_the_supervisor_with_its_stamp(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arrived: list[tuple[int, int]] = []
    take = Supervisor.take_state

    def recorded(self: Supervisor, state: VehicleState, now_ns: int) -> bool:
        arrived.append((state.stamp_ns, now_ns))
        return take(self, state, now_ns)

    monkeypatch.setattr(Supervisor, "take_state", recorded)
    made: list[Steering] = []

    def make(row: Row, road: Scenario) -> Steering:
        made.append(COLUMNS["preview"].make(row, road))
        return made[0]

    drive(Row("lane_change", "ordinary", Disturbance("", late=0.1)), make)
    assert {now_ns - stamp_ns for stamp_ns, now_ns in arrived} == {NANOSECONDS // 10}
    assert isinstance(made[0], Supervised)
    assert made[0].rejected == 0
    age = made[0].supervisor.state
    assert age is not None
    assert age.arrival_ns - age.stamp_ns == NANOSECONDS // 10


def test_the_noise_is_the_same_for_all_controllers() -> None:
    odometry = Odometry(0.0, SEEDS[0], 10), Odometry(0.0, SEEDS[0], 10)
    state = VehicleState(0, 1.0, 2.0, 0.1, 9.0, 0.0, 0.0)
    other = Odometry(0.0, SEEDS[1], 10)
    for each in (*odometry, other):
        each.measure(state)
    first, second = (each.newest() for each in odometry)
    assert first == second != state
    assert other.newest() != first


def test_nothing_of_the_actuator_is_configured_by_default() -> None:
    row = Row("sc1", "independent", Disturbance("", delay=0.1))
    road = road_of(row.road, row.car)
    unknown, known = (COLUMNS[name].make(row, road) for name in ("preview", "preview_configured"))
    assert isinstance(unknown, Supervised)
    assert isinstance(known, Supervised)
    steering = unknown.supervisor.config.steering
    assert (steering.delay, steering.max_rate) == (0.0, math.inf)
    assert not steering.is_lag_configured
    steering = known.supervisor.config.steering
    assert (steering.delay, steering.lag) == (0.1, 0.1)
    assert steering.max_rate < 1.0


def result(largest: float, activity: float = 1.0) -> Result:
    """Return numbers of a cell."""
    return Result(largest, largest / 2, activity, largest)


def test_a_tie_does_not_beat_us() -> None:
    assert not beats(0.1, 0.1)
    assert not beats(0.0991, 0.1)  # 1 mm
    assert not beats(0.981, 1.0)  # 2 %
    assert beats(0.97, 1.0)
    assert beats(0.008, 0.0095)


def test_a_row_is_won_by_error_and_activity() -> None:
    others = {"a": result(0.2, 0.5), "b": result(0.1, 1.0), "c": result(math.inf, 0.1)}
    assert reason_of_loss(result(0.1, 1.5), others) == ""
    assert reason_of_loss(result(0.12, 0.5), others) == "b has 0.100 m"
    assert reason_of_loss(result(0.05, 1.6), others) == "1.6 times the activity of b"
    assert reason_of_loss(result(math.inf), others) == "leaves the road"
    assert reason_of_loss(result(4.0, 9.0), {"c": result(math.inf, 0.1)}) == ""


def test_every_road_car_and_disturbance_is_a_row_but_roads_too_slippery() -> None:
    assert len(all_rows()) == 192
    assert len({str(row) for row in all_rows()}) == 192


def test_the_command_writes_page_table_and_picture(tmp_path: Path) -> None:
    words = "--rows none --cars ordinary --roads lane_change --columns preview preview_lq stanley"
    code = leaderboard.main([*words.split(), "--workers", "1", "--output", str(tmp_path)])
    assert code in (0, 1)
    assert {file.suffix for file in tmp_path.iterdir()} == {".md", ".json", ".png"}
    text = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    assert "| lane_change, ordinary |" in text
    assert leaderboard.main(["--rows", "nothing"]) == leaderboard.WRONG


def test_yardsticks_of_an_earlier_run_are_reused(tmp_path: Path) -> None:
    row = Row("sc1", "paper", NOMINAL)
    cells = {"preview": result(0.1), "stanley": result(math.inf), "preview_lq": result(0.2)}
    write_json(Board("", list(cells), {row: cells}), tmp_path / "leaderboard.json")
    other = Row("sc2", "paper", NOMINAL)
    known = read_yardsticks(tmp_path / "leaderboard.json", [row, other])
    assert known == {row: {key: cells[key] for key in ("preview_lq", "stanley")}, other: {}}
    with pytest.raises(ValueError, match="not a leaderboard"):
        read_yardsticks(tmp_path / "missing.json", [row])


def test_yardsticks_have_the_constructor_of_custom_controllers() -> None:
    for name in YARDSTICKS:
        kind = COLUMNS[name].yardstick
        assert kind is not None
        made = kind(chassis=vehicle_of("paper").chassis, settings=limits())
        assert 0.001 <= made.period <= 1.0
