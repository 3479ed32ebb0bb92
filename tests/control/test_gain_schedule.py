"""Learned schedule: independent forms, limit cases in closed loop, clipping, files, replay."""

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml

from ampc_msgs_config.config import find
from ampc_msgs_config.paths.path import Path as RoadPath
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array, VehicleState
from ampc_msgs_config.vehicle_file import read_vehicle
from ampc_ros.assumed_car import assumed_car
from ampc_ros.certificate import identity_of
from ampc_ros.configuration import Choices, Configuration, configuration, from_yaml, to_yaml
from ampc_ros.controller import build_controller
from ampc_ros.mpc.gain_schedule import (
    Anfis,
    GainSchedule,
    Network,
    ScheduledGains,
    Situation,
    scheduled_gains,
)
from ampc_ros.mpc.gain_table import Gains, gain_table, load_gain_table
from ampc_ros.preview.controller import PreviewMpc, approach, curvature_ahead
from ampc_ros.supervision.health import health
from ampc_ros.supervision.supervisor import Supervisor
from launch_scripts.certifying.subject import load_subject
from launch_scripts.replaying.recorded_run import read_run
from launch_scripts.replaying.repetition import differences, replay_ticks
from launch_scripts.tuning.fleet_rows import Entry, prepare_fleet
from sim_vehicle.closed_loop import Simulation, drive
from tests.recorded_drives import VEHICLE, drive_in_real_time, scenario_of

SET = Gains(25, 20, 3, 0.625, 10.0, 100.0)
RANGES: dict[str, Any] = {
    "speed": [3.0, 40.0],
    "curvature": [3.0e-4, 0.1],
    "latency": [0.0, 0.3],
    "laguerre_pole": [0.1, 0.85],
    "increment_weight": [1.0, 1.0e5],
}


def random_schedule(kind: str, seed: int, size: float = 1.0) -> dict[str, Any]:
    """Return the content of a schedule with random parameters about pole 0.5 and R 1000."""
    rng = np.random.default_rng(seed)

    def row(n: int) -> list[float]:
        return [float(each) for each in size * rng.standard_normal(n)]

    if kind == "network":
        neurons = [{"inputs": row(4), "outputs": row(2)} for _ in range(6)]
        return {"kind": kind, **RANGES, "neurons": neurons, "biases": [0.5, 3.0]}
    rules = [
        {
            "centre": row(3),
            "width": [min(abs(each) + 0.3, 1.0e3) for each in row(3)],
            "laguerre_pole": [0.5, *row(3)],
            "increment_weight": [3.0, *row(3)],
        }
        for _ in range(5)
    ]
    return {"kind": kind, **RANGES, "rules": rules}


def constant_schedule(kind: str) -> dict[str, Any]:
    """Return the content of a schedule whose outputs are the gains of SET."""
    if kind == "network":
        neurons = [{"inputs": [0.3, 1.0, -2.0, 0.5], "outputs": [0.0, 0.0]}]
        return {"kind": kind, **RANGES, "neurons": neurons, "biases": [0.625, 2.0]}
    rule = {"centre": [0.0] * 3, "width": [1.0] * 3}
    rule |= {"laguerre_pole": [0.625, 0.0, 0.0, 0.0], "increment_weight": [2.0, 0.0, 0.0, 0.0]}
    return {"kind": kind, **RANGES, "rules": [rule]}


def file_content(schedule: dict[str, Any] | None, **changes: Any) -> dict[str, Any]:
    """Return the content of a gain file with a schedule."""
    content = {"speed": [9.0], "gains": [dict(SET._asdict())], **changes}
    return content if schedule is None else {**content, "schedule": schedule}


def built(content: dict[str, Any]) -> GainSchedule:
    """Return the schedule of a content."""
    schedule = gain_table(file_content(content)).schedule
    assert schedule
    return schedule


def config_with(schedule: dict[str, Any] | None, **choices: Any) -> Configuration:
    """Return a configuration whose gains have a schedule."""
    return configuration(Choices(**choices))._replace(gains=file_content(schedule))


def preview_with(schedule: dict[str, Any] | None) -> PreviewMpc:
    """Return a controller whose gains have a schedule."""
    controller = build_controller(config_with(schedule))
    assert isinstance(controller, PreviewMpc)
    return controller


def numpy_gains(content: dict[str, Any], situation: Situation) -> Array:
    """Return pole and R in matrix form, for inputs and outputs inside their ranges."""
    low, high = np.array([RANGES[key] for key in Situation._fields]).T
    x = np.array(situation)
    u = 2.0 * (x - low) / (high - low) - 1.0
    u[:2] = 2.0 * np.log10(x[:2] / low[:2]) / np.log10(high[:2] / low[:2]) - 1.0
    if content["kind"] == "network":
        W = np.array([each["inputs"] for each in content["neurons"]])
        V = np.array([each["outputs"] for each in content["neurons"]])
        y = np.array(content["biases"]) + np.tanh(W[:, 0] + W[:, 1:] @ u) @ V
    else:
        rules = content["rules"]
        c, s = (np.array([each[key] for each in rules]) for key in ("centre", "width"))
        w = np.prod(np.exp(-0.5 * ((u - c) / s) ** 2), axis=1)
        C = np.array([[each["laguerre_pole"], each["increment_weight"]] for each in rules])
        y = (w / w.sum()) @ (C[..., 0] + C[..., 1:] @ u)
    return np.array([y[0], 10.0 ** y[1]])


@pytest.mark.parametrize("kind", ["network", "anfis"])
def test_outputs_are_those_of_the_matrix_form_within_their_bounds(kind: str) -> None:
    rng, inside = np.random.default_rng(7), 0
    for seed in range(20):
        content = random_schedule(kind, seed, 0.4)
        for _ in range(10):
            at = Situation(*(float(rng.uniform(*RANGES[key])) for key in Situation._fields))
            actual, wanted = scheduled_gains(built(content), at), numpy_gains(content, at)
            bounds = np.array([RANGES[key] for key in ScheduledGains._fields]).T
            inside += bool(np.all((bounds[0] < wanted) & (wanted < bounds[1])))
            assert actual == pytest.approx(np.clip(wanted, *bounds), rel=1e-9)
    assert inside > 50


@pytest.mark.parametrize("kind", ["network", "anfis"])
def test_inputs_outside_the_training_count_as_its_edge(kind: str) -> None:
    schedule = built(random_schedule(kind, 3))
    for outside, edge in [
        (Situation(0.0, 0.01, 0.1), Situation(3.0, 0.01, 0.1)),
        (Situation(-7.0, 0.01, 0.1), Situation(3.0, 0.01, 0.1)),
        (Situation(1.0e9, 0.01, 0.1), Situation(40.0, 0.01, 0.1)),
        (Situation(9.0, 0.0, 0.1), Situation(9.0, 3.0e-4, 0.1)),
        (Situation(9.0, 5.0, 2.0), Situation(9.0, 0.1, 0.3)),
    ]:
        assert scheduled_gains(schedule, outside) == scheduled_gains(schedule, edge)


@pytest.mark.parametrize("kind", ["network", "anfis"])
@pytest.mark.parametrize("size", [30.0, 1.0e4])
def test_huge_parameters_never_leave_the_declared_gains(kind: str, size: float) -> None:
    for seed in range(20):
        schedule = built(random_schedule(kind, seed, size))
        gains = scheduled_gains(schedule, Situation(5.0 + seed, 0.02, 0.05))
        assert gains
        assert 0.1 <= gains.laguerre_pole <= 0.85
        assert 1.0 <= gains.increment_weight <= 1.0e5


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("key", Situation._fields)
def test_an_input_that_is_not_finite_has_no_scheduled_gains(key: str, value: float) -> None:
    at = Situation(9.0, 0.01, 0.1)._replace(**{key: value})
    assert scheduled_gains(built(random_schedule("network", 1)), at) is None


@pytest.mark.parametrize("kind", ["network", "anfis"])
def test_a_constant_schedule_drives_like_the_single_set_bit_for_bit(kind: str) -> None:
    single = drive(Simulation(VEHICLE, scenario_of("sc2", 12.0)), preview_with(None))
    actual = drive(
        Simulation(VEHICLE, scenario_of("sc2", 12.0)), preview_with(constant_schedule(kind))
    )
    np.testing.assert_array_equal(actual.steering, single.steering)
    assert actual.states == single.states


def settled_gains(controller: PreviewMpc, path: RoadPath, s: float, tick: int) -> tuple[float, ...]:
    """Return pole and R after 20 s at the same place, and the index of the projection."""
    for i in range(200):
        state = VehicleState((tick + i) * 10**8, s, 0.0, 0.0, 9.0, 0.0, 0.0)
        plan = controller.step(state, path)
    used = plan.diagnosis
    return used.laguerre_pole, used.increment_weight, controller.memory[0]


def test_gains_settle_at_those_of_speed_curvature_and_latency() -> None:
    content = random_schedule("network", 5, 0.4)
    controller, schedule = preview_with(content), built(content)
    path, car = make_path(scenario_of("sc1").points), assumed_car(config_with(None))
    for i, (delay, lag) in enumerate([(0.0, 0.0), (0.13, 0.05)]):
        controller.use_car(car._replace(response=car.response._replace(delay=delay, lag=lag)))
        pole, R, index = settled_gains(controller, path, 20.0, 400 * i)
        ahead = path.curvature[int(index) : int(index) + int(18.0 / path.spacing) + 1]
        at = Situation(9.0, float(np.abs(ahead).max()), delay + lag)
        assert at.curvature > 1.0e-3
        assert (pole, R) == pytest.approx(scheduled_gains(schedule, at), rel=1e-6)


def test_gains_never_jump_and_approach_a_new_situation_exponentially() -> None:
    content = random_schedule("anfis", 2, 1.0)
    controller = preview_with(content)
    driven = []
    for side in range(60):
        path = make_path(scenario_of("sc1" if side % 20 < 10 else "circle").points)
        state = VehicleState(side * 10**8, 20.0, 0.0, 0.0, 9.0, 0.0, 0.0)
        used = controller.step(state, path).diagnosis
        driven.append((used.laguerre_pole, math.log10(used.increment_weight)))
    share = 1.0 - math.exp(-0.1 / 1.0)
    steps = np.abs(np.diff(driven, axis=0)).max(axis=0)
    assert np.all(steps <= share * np.array([0.85 - 0.1, 5.0]))
    assert approach((0.2, 10.0), (0.6, 1000.0), math.log(2.0)) == pytest.approx((0.4, 100.0))
    assert approach((0.3, 77.7), (0.3, 77.7), 0.1) == (0.3, 77.7)


def test_the_first_tick_knows_the_road_and_an_unusable_speed_has_the_gains_of_the_set() -> None:
    content, road = random_schedule("anfis", 2), scenario_of("sc1")
    path = make_path(road.points)
    first = preview_with(content)
    used = first.step(VehicleState(0, 20.0, 0.0, 0.0, 9.0, 0.0, 0.0), path).diagnosis
    index = int(first.memory[0])
    ahead = path.curvature[index : index + int(18.0 / path.spacing) + 1]
    wanted = scheduled_gains(built(content), Situation(9.0, float(np.abs(ahead).max()), 0.0))
    assert wanted
    assert used.increment_weight == pytest.approx(wanted.increment_weight, rel=0.05)
    assert math.isnan(curvature_ahead(path, 0, math.nan))
    other = preview_with(content)
    assert other.schedule
    state = VehicleState(0, 20.0, 0.0, 0.0, math.nan, 0.0, 0.0)
    table, _ = other.scheduled_table(other.schedule, state, path)
    assert table.nodes[0].tolist() == list(SET)


def test_curvature_ahead_is_the_largest_one_of_the_road_also_over_the_start_of_a_lap() -> None:
    t = np.linspace(0.0, 2.0 * math.pi, 400)[:-1]
    points = np.column_stack((60.0 * np.cos(t), 30.0 * np.sin(t)))
    path = make_path(np.vstack((points, points[:1])))
    assert path.closed
    last = len(path.x) - 1
    for index in (0, last - 3, 2 * last + 5, -7):
        count = int(25.0 / path.spacing) + 1
        ahead = [abs(path.curvature[(index + k) % last]) for k in range(count)]
        assert curvature_ahead(path, index, 25.0) == max(ahead)
    assert curvature_ahead(path, 11, 1.0e300) == np.abs(path.curvature[:last]).max()
    road = make_path(scenario_of("sc1").points)
    assert curvature_ahead(road, len(road.x) + 9, 20.0) == 0.0


@pytest.mark.parametrize("kind", ["network", "anfis"])
def test_a_mirrored_road_is_driven_with_mirrored_angles(kind: str) -> None:
    driven = []
    for side in (1.0, -1.0):
        scenario = scenario_of("sc2", 10.0)
        scenario = scenario._replace(points=scenario.points * [1.0, side])
        controller = preview_with(random_schedule(kind, 4, 0.3))
        driven.append(drive(Simulation(VEHICLE, scenario), controller).steering)
    np.testing.assert_allclose(driven[0], -driven[1], atol=1e-9)
    assert np.abs(driven[0]).max() > 0.01


def schedule_changes(supervisor: Supervisor, step: int) -> None:
    """Switch from a network to an ANFIS and to the single set while driving."""
    schedules = {0: random_schedule("network", 6, 0.3), 130: random_schedule("anfis", 6, 0.3)}
    if step in (0, 130, 300):
        content = file_content(schedules.get(step))
        supervisor.reconfigure(supervisor.config._replace(gains=content))


def test_a_recorded_drive_with_schedules_replays_bit_for_bit(tmp_path: Path) -> None:
    drive_in_real_time(tmp_path / "bag", schedule_changes, 1)
    run = read_run(tmp_path / "bag")
    assert sum("schedule" in config.gains for config in run.config.values()) == 2
    records = list(replay_ticks(run.ticks, run.config))
    poles = {record.command.plan.diagnosis.laguerre_pole for record in records}
    assert len(poles) > 20
    for tick, record in zip(run.ticks, records, strict=True):
        assert differences(tick, record, 0.0) == []


@pytest.mark.parametrize("kind", ["network", "anfis"])
def test_a_configuration_with_a_schedule_survives_its_yaml(kind: str) -> None:
    config = config_with(random_schedule(kind, 8))
    again, _ = from_yaml(to_yaml(config, 3), "bag")
    assert gain_table(again.gains).schedule == gain_table(config.gains).schedule
    assert msgspec.to_builtins(gain_table(again.gains).schedule)["kind"] == kind


def changed(kind: str, key: str, value: Any) -> dict[str, Any]:
    """Return a schedule with one bad value; a dotted key changes an entry of the first row."""
    content = random_schedule(kind, 0)
    part, _, inner = key.rpartition(".")
    target = content[part][0] if part else content
    target[inner] = value
    return content


HOSTILE = [
    (changed("network", "kind", "forest"), r"schedule\.kind = 'forest' must be one of"),
    ({**RANGES}, r"schedule: missing key 'kind'"),
    (changed("network", "neurons", []), r"schedule\.neurons = \[\] must be a list of 1"),
    (changed("network", "biases", [0.5]), r"schedule\.biases = \[0.5\] must be a list of 2"),
    (changed("network", "biases", [0.5, math.nan]), r"schedule\.biases\[1\] = nan must lie in"),
    (changed("network", "neurons.inputs", [1.0, 2.0]), r"neurons\[0\]\.inputs = .* of 4 entries"),
    (changed("network", "neurons.outputs", [0, math.inf]), r"outputs\[1\] = inf must lie in"),
    (changed("network", "neurons.colour", 1), r"neurons\[0\]: unknown key 'colour'"),
    (changed("anfis", "rules.width", [1, 0, 1]), r"rules\[0\]\.width\[1\] = 0.* lie in \[0\.001"),
    (changed("anfis", "rules.centre", "left"), r"rules\[0\]\.centre = 'left' must be a list"),
    (changed("anfis", "rules", [{}] * 101), r"schedule\.rules = .* must be a list of 1 to 100"),
    (changed("anfis", "speed", [40.0, 3.0]), r"schedule\.speed\[1\] = 3 must be greater than 40"),
    (changed("anfis", "curvature", [0.0, 0.1]), r"schedule\.curvature\[0\] = 0.* lie in \[1e-06"),
    (changed("anfis", "laguerre_pole", [0.1, 1.2]), r"laguerre_pole\[1\] = 1\.2 must lie in"),
    (changed("anfis", "increment_weight", [-1, 2]), r"increment_weight\[0\] = -1.* must lie in"),
    ([1, 2], r"schedule = \[1, 2\] must be a mapping"),
]


@pytest.mark.parametrize(("schedule", "message"), HOSTILE)
def test_a_hostile_file_is_rejected_with_key_value_and_bound(
    schedule: Any, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(file_content(schedule)), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"mine\.yaml: .*{message}") as error:
        load_gain_table(str(file))
    assert "\n" not in str(error.value)


def test_a_schedule_needs_a_single_gain_set_and_the_controller_preview(tmp_path: Path) -> None:
    two = file_content(constant_schedule("network"), speed=[3.0, 9.0], gains=[SET._asdict()] * 2)
    with pytest.raises(ValueError, match="gains has 2 entries, must have 1 beside a schedule"):
        gain_table(two)
    for controller in ("paper", "classic"):
        config = config_with(constant_schedule("anfis"), controller=controller)
        with pytest.raises(ValueError, match="schedule: only the controller preview"):
            build_controller(config)
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(file_content(constant_schedule("anfis"))), encoding="utf-8")
    with pytest.raises(ValueError, match=r"mine\.yaml: schedule: .* cannot be certified"):
        load_subject(Choices(gain_table=str(file)))
    entry = Entry(
        Simulation(VEHICLE, scenario_of("sc1")), preview_with(constant_schedule("network"))
    )
    with pytest.raises(ValueError, match=r"fleet: .* schedule"):
        prepare_fleet([entry])


def test_a_certificate_of_the_set_does_not_hold_for_its_schedule() -> None:
    vehicle = read_vehicle(find("vehicles", "paper"))
    plain, learned, other = (
        identity_of(config_with(schedule), vehicle)
        for schedule in (None, random_schedule("network", 1), random_schedule("network", 2))
    )
    assert len({str(plain), str(learned), str(other)}) == 3


def test_a_speed_outside_the_schedule_is_reported() -> None:
    supervisor = Supervisor(config_with(random_schedule("network", 1, 0.2), static_path=True))
    path, now_ns = make_path(scenario_of("straight").points), 10**9
    supervisor.follow(path, now_ns, now_ns)
    for tick in range(3):
        at = now_ns + tick * 10**8
        supervisor.take_state(VehicleState(at, 1.0 + 0.2 * tick, 0.0, 0.0, 2.0, 0.0, 0.0), at)
        record = supervisor.tick(at)
    assert record
    assert record.command.plan.diagnosis.outside_table == 1.0
    assert (
        "1.0 m/s outside the gain table, valid from 3 to 40"
        in health(supervisor, record, at).sentence
    )


def test_kinds_are_distinguished_by_their_tag() -> None:
    assert isinstance(built(random_schedule("network", 0)), Network)
    assert isinstance(built(random_schedule("anfis", 0)), Anfis)
