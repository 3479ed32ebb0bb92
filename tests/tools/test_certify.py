"""Certification: eigenvalues and margins against independent methods, verdicts, and determinism."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.paths.path import Path as Reference
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array, Plan, VehicleState
from ampc_ros.certificate import certificate_problem, identity_of, read_certificate
from ampc_ros.configuration import Choices, configuration
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from ampc_ros.preview.tick import DISTURBANCE, EXPECTED
from launch_scripts.certify import main
from launch_scripts.certifying import measurements
from launch_scripts.certifying.bounds import ACCEPTANCE_BOUNDS
from launch_scripts.certifying.certificate import (
    SHIPPED_FOLDER,
    default_folder,
    file_name,
    rounded_value,
)
from launch_scripts.certifying.linear_loop import (
    CertifiedController,
    loop_matrix,
    spectral_radius,
    time_constant,
)
from launch_scripts.certifying.margins import last_settling, margins
from launch_scripts.certifying.measurements import (
    GainStepMeter,
    disturbances,
    gain_steps,
    time_constants,
)
from launch_scripts.certifying.page import bounds_table, results_table
from launch_scripts.certifying.run_certify import SHIPPED
from launch_scripts.certifying.subject import (
    Subject,
    Variation,
    cars_within_spread,
    load_subject,
    speed_grid,
    top_speed,
)
from launch_scripts.run.progress import show_progress
from launch_scripts.tuning.drives import straight
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import load_vehicle_file
from tests.certificates import certificate_of, write_certificate
from tests.html_pages import CHROMIUM, check_widths, open_browser

ROOT = Path(__file__).resolve().parents[2]
ORDINARY = load_vehicle_file(find("vehicles", "ordinary"))


def silent(_: float) -> None:
    """Receive the progress of drives."""


def plant(v: float, T: float) -> tuple[Array, Array]:
    """Return A (4, 4) and B (4,) of [v_y, e_psi, r, e_y] of the ordinary car without steering lag.

    The matrix exponential of SciPy; the product uses a series of its own.
    """
    c = ORDINARY.chassis
    m, I_z, l_f, l_r = c.mass, c.yaw_inertia, c.cg_to_front_axle, c.cg_to_rear_axle
    F, R = 2 * c.front_cornering_stiffness, 2 * c.rear_cornering_stiffness
    M: Array = np.zeros((5, 5))
    M[0, [0, 2, 4]] = -(F + R) / (m * v), (R * l_r - F * l_f) / (m * v) - v, F / m
    M[1, 2] = 1.0
    M[2, [0, 2, 4]] = (
        (R * l_r - F * l_f) / (I_z * v),
        -(F * l_f**2 + R * l_r**2) / (I_z * v),
        F * l_f / I_z,
    )
    M[3, [0, 1]] = 1.0, v
    full: Array = np.asarray(expm(M * T), dtype=np.float64)
    return full[:4, :4], full[:4, 4]


def decay_per_tick(controller: CertifiedController, v: float, *, estimator: bool) -> float:
    """Return the decay of a small error per tick in a loop of the controller and `plant`."""
    path, l_r = make_path([(0.0, 0.0), (2000.0, 0.0)]), ORDINARY.chassis.cg_to_rear_axle
    A, B = plant(v, controller.period)
    x, sizes = np.array([0.0, 0.0, 0.0, 1e-3]), []
    for tick in range(1, round(20.0 / controller.period)):
        stamp = round(tick * controller.period * NANOSECONDS)
        state = VehicleState(stamp, 300.0, x[3], x[1], v, x[0], x[2])
        u = controller.step(at_distance(state, -l_r), path).steering
        if not estimator:
            controller.memory[DISTURBANCE:EXPECTED] = 0.0
        x = A @ x + B * u
        sizes.append(float(np.abs(x).max()))
    # Largest size in two windows that contain whole oscillations
    n = round(3.0 / controller.period)
    early, late = max(sizes[n : 2 * n]), max(sizes[3 * n : 4 * n])
    return float((late / early) ** (1.0 / (2 * n)))


@pytest.mark.parametrize("v", [4.0, 12.5, 31.0])
@pytest.mark.parametrize("table", ["preview", "preview_ordinary"])
def test_spectral_radius_is_the_decay_of_a_simulated_loop(table: str, v: float) -> None:
    subject = load_subject(Choices(vehicle="ordinary", gain_table=table))
    loop = subject.controller(), ORDINARY.chassis, ORDINARY.steering
    radius = spectral_radius(*loop, v, estimator=False)
    actual = decay_per_tick(subject.controller(), v, estimator=False)
    T = subject.period
    assert time_constant(radius, T) == pytest.approx(time_constant(actual, T), rel=0.15)


@pytest.mark.parametrize("car", ["paper", "ordinary"])
@pytest.mark.parametrize("v", [3.5, 17.0, 44.0])
def test_the_estimator_adds_its_own_poles_and_changes_no_other(car: str, v: float) -> None:
    subject = load_subject(Choices(vehicle=car))
    loop = subject.controller(), subject.vehicle.chassis, subject.vehicle.steering
    whole = np.linalg.eigvals(loop_matrix(*loop, v))
    held = np.linalg.eigvals(loop_matrix(*loop, v, estimator=False))
    own = [1.0 - share for share in (0.3, 0.05, 0.3, 0.05)]
    expected = np.poly(np.concatenate((held, own, np.zeros(1))))
    np.testing.assert_allclose(np.poly(whole), expected, atol=1e-4)
    assert np.abs(held).max() < 0.93 < np.abs(whole).max()


@given(st.lists(st.floats(0.0, 1.05), min_size=1, max_size=5), st.floats(0.3, 0.9))
def test_the_last_settling_value_lies_below_the_first_failure(
    limits: list[float], island: float
) -> None:
    def settles(places: Sequence[int], at: Sequence[float]) -> list[bool]:
        pairs = zip(places, at, strict=True)
        return [v <= limits[i] or limits[i] + 0.15 < v < island for i, v in pairs]

    values = [i * 0.1 for i in range(11)]
    for limit, found in zip(limits, last_settling(len(limits), values, 0.02, settles), strict=True):
        assert limit >= 1.0 or limit - 0.0301 < found <= limit


class Altered:
    """Controller behind a linkage with another ratio."""

    def __init__(self, controller: CertifiedController, effect: float) -> None:
        """Wrap a controller."""
        self.controller, self.period, self.effect = controller, controller.period, effect

    def step(self, state: VehicleState, path: Reference) -> Plan:
        """Return the command multiplied."""
        plan = self.controller.step(state, path)
        return plan._replace(steering=self.effect * plan.steering)


def settles_alone(subject: Subject, v: float, delay: float, effect: float) -> bool:
    """Return whether one car, driven in Python, settles on a straight road."""
    nominal = subject.vehicle.steering
    limits = {"max_rate": effect * nominal.max_rate, "max_angle": min(effect * 0.6, 1.5)}
    steering = replace(nominal, delay=nominal.delay + delay, **limits)
    car = subject.vehicle._replace(steering=steering)
    scenario = straight(v, 15.0, 0.5)
    driven = drive(Simulation(car, scenario), Altered(subject.controller(), effect))
    to_cg = car.chassis.cg_to_rear_axle
    errors = np.array([at_distance(state, to_cg).y for state in driven.states])
    return bool(np.abs(errors[-round(5.0 / subject.period) :]).max() <= 0.05)


@pytest.mark.parametrize("v", [3.5, 8.0])
def test_margins_are_those_of_one_car_with_every_delay_and_factor(v: float) -> None:
    subject = load_subject(Choices(vehicle="ordinary"))
    found = margins(subject, np.array([v]), 1, silent)
    delay = next(i for i in count() if not settles_alone(subject, v, 0.005 * i, 1.0))
    assert found["delay_margin"] == [pytest.approx(0.005 * (delay - 1), abs=1e-9)]
    factor = next(i for i in count() if not settles_alone(subject, v, 0.0, 1.0 + 0.05 * i))
    assert found["gain_margin"] == [pytest.approx(1.0 + 0.05 * (factor - 1), abs=1e-9)]


def test_gust_and_spread_are_those_of_one_car_driven_in_python() -> None:
    subject, v = load_subject(Choices(vehicle="ordinary")), 23.0
    found = disturbances(subject, np.array([v]), 1, silent)
    to_cg = ORDINARY.chassis.cg_to_rear_axle
    gusty = drive(Simulation(ORDINARY, measurements.gusty_road(v)), subject.controller())
    errors = [abs(at_distance(state, to_cg).y) for state in gusty.states]
    assert found["gust"] == [pytest.approx(max(errors), rel=1e-6)]
    worst = 0.0
    for mass, tyres in ((1.0, 0.7), (1.0, 1.3), (1.2, 1.0)):
        chassis = replace(
            ORDINARY.chassis,
            mass=mass * ORDINARY.chassis.mass,
            front_cornering_stiffness=tyres * ORDINARY.chassis.front_cornering_stiffness,
            rear_cornering_stiffness=tyres * ORDINARY.chassis.rear_cornering_stiffness,
        )
        road = measurements.joining_road(v, 3.0)
        car = ORDINARY._replace(chassis=chassis)
        joined = drive(Simulation(car, road), subject.controller())
        worst = max(worst, *(-at_distance(state, to_cg).y for state in joined.states))
    assert found["spread_overshoot"] == [pytest.approx(worst, abs=1e-9)]


def test_a_step_of_the_gains_is_measured_and_equal_gains_make_none() -> None:
    subject = load_subject(Choices(vehicle="ordinary"))
    node = load_gain_table("preview").nodes[2]
    other = node._replace(increment_weight=node.increment_weight / 100.0)

    def largest_step(nodes: list[Gains]) -> float:
        meter = GainStepMeter(subject.controller())
        speeds = np.linspace(10.0, 20.0, len(nodes)).tolist()
        meter.controller.table = GainTable(speeds, [0.0], nodes).table
        road = measurements.ramp(10.0, 20.0)._replace(start_offset=0.5)
        drive(Simulation(ORDINARY, road), meter)
        return max((size for _, size in meter.steps), default=0.0)

    assert largest_step([node, node]) < 1e-9
    assert largest_step([node] * 30) < 1e-9
    assert largest_step([node, other]) > 1e-5


def test_the_grid_is_finer_than_the_table_and_ends_where_the_car_ends() -> None:
    grid, beyond = speed_grid([3.0, 5.0, 20.0], 21.5)
    assert {3.0, 3.5, 4.0, 4.5, 5.0, 8.75, 12.5, 16.25, 20.0, 21.0} <= set(grid.tolist())
    assert grid[0] == pytest.approx(3.0 / 1.1, abs=1e-3)
    assert beyond.tolist() == [22.0]


def test_the_top_speed_is_that_of_a_simulated_car() -> None:
    weak = ORDINARY._replace(powertrain=replace(ORDINARY.powertrain, max_power=9000.0))
    start = Simulation(weak, straight(25.0, 150.0, 0.0))
    controller = load_subject(Choices(vehicle="ordinary")).controller()
    states = drive(start, controller).states
    assert states[-1].v_x == pytest.approx(top_speed(weak), abs=0.5)


def test_spread_of_the_vehicle_file_replaces_the_default() -> None:
    default = list(cars_within_spread(ORDINARY, {}))
    assert [round(v.car.chassis.mass) for v in default] == [1500, 1500, 1800]
    assert default[0].car.chassis.rear_cornering_stiffness == pytest.approx(0.7 * 62000.0)
    own = {"chassis.mass": 0.1, "steering.delay": 0.03, "steering.ratio": 0.25}
    own |= {"steering.offset": 0.02, "size.width": 0.5, "tyre.friction": 0.2}
    cars = list(cars_within_spread(ORDINARY, own))[2:]
    assert [v.car.chassis.mass for v in cars[:2]] == pytest.approx([1350.0, 1650.0])
    assert [v.car.steering.delay for v in cars[2:4]] == [0.0, 0.03]
    assert [v.effect for v in cars[4:6]] == pytest.approx([1 / 0.75, 0.8])
    assert [v.misalignment for v in cars[6:8]] == [-0.02, 0.02]
    assert [v.car.tyre.friction for v in cars[8:]] == pytest.approx([0.8, 1.2])
    assert cars[4] == Variation(ORDINARY, 1 / 0.75)


def test_a_spread_beyond_the_range_of_a_value_ends_at_its_bound() -> None:
    spread = {"body.front_roll_share": 2.0, "steering.max_angle": 5.0, "steering.lag": 9.0}
    cars = [variation.car for variation in cars_within_spread(ORDINARY, spread)][3:]
    assert [car.body.front_roll_share for car in cars[:2]] == [pytest.approx(0.029), 1.0]
    assert [car.steering.max_angle for car in cars[2:4]] == [pytest.approx(0.03), 1.5]
    assert [car.steering.lag for car in cars[4:6]] == [0.0, 5.0]


def write_table(file: Path, speeds: Sequence[float], **changes: float) -> Path:
    """Write the gains `preview` at these speeds, with numbers changed."""
    table = load_gain_table("preview")
    rows = [{**table.lookup(v).gains._asdict(), **changes} for v in speeds]
    file.write_text(yaml.safe_dump({"speed": list(speeds), "gains": rows}), encoding="utf-8")
    return file


def test_a_certificate_has_the_same_bytes_on_each_run_and_the_node_accepts_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_table(tmp_path / "fast.yaml", [20.0])
    options = ["--vehicle", "ordinary", "--gain-table", str(table)]
    assert main([*options, "--workers", "1"]) == 0
    file = tmp_path / "fast.ordinary.certificate.json"
    page = file.with_suffix(".html")
    first = file.read_bytes(), page.read_bytes()
    assert b"Certified" in first[1]
    if CHROMIUM:
        with open_browser() as browser:
            check_widths(browser, page)
    assert main([*options, "--workers", "3"]) == 0
    assert (file.read_bytes(), page.read_bytes()) == first
    content = json.loads(first[0])
    assert [check["key"] for check in content["checks"]] == [
        bound.key for bound in ACCEPTANCE_BOUNDS
    ]
    assert all(len(check["values"]) == len(content["speeds"]) for check in content["checks"])
    assert "certified" in capsys.readouterr().out
    choices = Choices(vehicle="ordinary", gain_table=str(table))
    assert certificate_problem(choices, configuration(choices)) == ""


UNSTABLE = {
    "weight / 1000": (["--vehicle", "ordinary"], {"increment_weight": 0.3}),
    "short horizon": (["--vehicle", "paper"], {"prediction_horizon": 5, "control_horizon": 5,
                                               "laguerre_terms": 5, "increment_weight": 1.0}),
}  # fmt: skip


@pytest.mark.parametrize("case", UNSTABLE)
def test_aggressive_gains_are_refused(case: str, tmp_path: Path) -> None:
    options, changes = UNSTABLE[case]
    table = write_table(tmp_path / "t.yaml", [15.0], **changes)
    assert main([*options, "--gain-table", str(table)]) == 1
    (file,) = tmp_path.glob("t.*.certificate.json")
    assert any("margin" in failure for failure in read_certificate(file).failures)


def test_table_3_of_the_paper_is_refused_with_a_delay(tmp_path: Path) -> None:
    car = tmp_path / "late.yaml"
    car.write_text("same_as: paper\nsteering: {delay: 0.05}\n", encoding="utf-8")
    options = ["--vehicle", str(car), "--controller", "paper", "--output", str(tmp_path)]
    assert main(options) == 1
    certificate = read_certificate(tmp_path / "table3.late.certificate.json")
    assert any("= lost" in failure for failure in certificate.failures)


def test_a_certificate_is_written_where_the_controller_looks_for_it(tmp_path: Path) -> None:
    car, table = tmp_path / "car" / "car.yaml", tmp_path / "table" / "t.yaml"
    for file in (car, table):
        file.parent.mkdir()
    car.write_text("same_as: ordinary\nchassis: {mass: 1490}\n", encoding="utf-8")
    write_table(table, [15.0])
    for vehicle, gains, folder in (
        (str(car), str(table), table.parent),
        (str(car), "preview", car.parent),
        ("ordinary", str(table), table.parent),
        ("ordinary", "preview_paper", SHIPPED_FOLDER),
    ):
        choices = Choices(vehicle=vehicle, gain_table=gains)
        assert default_folder(load_subject(choices)) == folder
        if folder == SHIPPED_FOLDER:
            continue
        name = f"{Path(gains).stem}.{Path(vehicle).stem}.certificate.json"
        content = json.dumps(certificate_of(choices))
        (folder / name).write_text(content, encoding="utf-8")
        assert certificate_problem(choices, configuration(choices)) == ""


WRONG = {
    "vehicle": (["--vehicle", "none"], "'none' is neither a file nor"),
    "table": (["--gain-table", "none"], "'none' is neither a file nor"),
    "controller": (["--controller", "pure_pursuit"], "must be one of preview, paper"),
    "workers": (["--workers", "0"], "--workers 0: must be at least 1"),
    "output": (["--output", "/proc/x"], "--output: /proc/x: cannot create this folder"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_option_ends_with_2_and_one_line(
    case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options, sentence = WRONG[case]
    assert main(options) == 2
    out = capsys.readouterr().out
    assert sentence in out
    assert len(out.splitlines()) == 1


def test_a_car_that_reaches_no_speed_of_the_table_cannot_be_certified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    car = tmp_path / "slow.yaml"
    car.write_text("same_as: ordinary\npowertrain: {max_power: 300.0}\n", encoding="utf-8")
    options = ["--vehicle", str(car), "--output", str(tmp_path)]
    assert main(options) == 2
    assert "the car reaches no speed of the table, from 2.727 m/s on" in capsys.readouterr().out


@pytest.mark.parametrize("choices", SHIPPED, ids=lambda c: f"{c.gain_table}-{c.vehicle}")
def test_shipped_certificates_are_current(choices: Choices) -> None:
    subject = load_subject(choices)
    certificate = read_certificate(SHIPPED_FOLDER / file_name(subject))
    assert certificate.identity == identity_of(subject.config, subject.content)
    problem = certificate_problem(choices, subject.config)
    assert (problem == "") == certificate.certified
    assert certificate.certified or "fails: " in problem


QUICK = [(c, at) for c, at in zip(SHIPPED, (9, 30, 0, 2, 4, 6, 8, 1, 3, 5, 7), strict=True)
         if c.settings == "table3"]  # fmt: skip


@pytest.mark.parametrize(("choices", "at"), QUICK, ids=lambda c: getattr(c, "gain_table", ""))
def test_shipped_certificates_are_measured_again_at_one_speed(choices: Choices, at: int) -> None:
    subject = load_subject(choices)
    content = json.loads((SHIPPED_FOLDER / file_name(subject)).read_text(encoding="utf-8"))
    speeds = np.array(content["speeds"][at : at + 1])
    found = time_constants(subject, speeds) | margins(subject, speeds, 1, silent)
    found |= disturbances(subject, speeds, 1, silent)
    stored = {check["key"]: check["values"][at] for check in content["checks"]}
    for key, (value,) in found.items():
        expected = math.inf if stored[key] is None else stored[key]
        actual = rounded_value(value) if math.isfinite(value) else math.inf
        assert actual == pytest.approx(expected, rel=0.006, abs=2e-4), key


def test_the_page_lists_all_bounds_and_all_shipped_results() -> None:
    names = [file_name(load_subject(choices)) for choices in SHIPPED]
    contents = [json.loads((SHIPPED_FOLDER / name).read_text(encoding="utf-8")) for name in names]
    lines = (ROOT / "ampc_ros/doc/certificate.md").read_text(encoding="utf-8").splitlines()
    for table in (bounds_table(), results_table(contents)):
        begin = lines.index(table[0])
        assert lines[begin : begin + len(table)] == table


def test_gain_steps_of_a_shipped_certificate_are_measured_again() -> None:
    subject = load_subject(Choices(vehicle="ordinary"))
    content = json.loads((SHIPPED_FOLDER / file_name(subject)).read_text(encoding="utf-8"))
    found = gain_steps(subject, np.array(content["speeds"]), silent)["gain_step"]
    stored = {check["key"]: check["values"] for check in content["checks"]}["gain_step"]
    assert list(map(rounded_value, found)) == pytest.approx(stored, rel=0.006, abs=2e-4)


def test_settings_of_the_certificate_are_those_of_the_controller() -> None:
    choices = Choices(settings="50hz", vehicle="ordinary", gain_table="preview_50hz")
    subject = load_subject(choices)
    settings = load(ControllerSettings, find("controllers", "50hz"))
    assert asdict(subject.config.settings) == asdict(settings)
    assert subject.controller().period == 0.02


def test_progress_without_a_terminal_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from rich.console import Console

    clock = iter(range(0, 1000, 4))
    monkeypatch.setattr("launch_scripts.run.progress.time.monotonic", lambda: next(clock))
    with show_progress(Console(width=100), "work", 10.0) as advance:
        for _ in range(10):
            advance(1.0, "stage")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "work: 30%, stage, about 28 s left"
    assert 3 <= len(lines) <= 4


def test_a_written_certificate_of_a_test_is_accepted(tmp_path: Path) -> None:
    table = write_table(tmp_path / "t.yaml", [15.0])
    choices = Choices(vehicle="ordinary", gain_table=str(table))
    assert read_certificate(write_certificate(choices)).certified
