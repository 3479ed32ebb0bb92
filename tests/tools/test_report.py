"""Report of complete, old, foreign and damaged bags."""

import csv
import json
import math
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

from ampc_msgs_config import ros
from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import FRICTION_SHARE, GuardLimits
from ampc_msgs_config.types import NANOSECONDS, Diagnosis, Plan
from ampc_ros.mpc.internal_model import limits_of
from ampc_ros.preview.model import angle_bound
from launch_scripts.report import main, names_of, page_file
from launch_scripts.reporting import export, page
from launch_scripts.reporting.charts import draw_panel, thin_series
from launch_scripts.reporting.drive import JudgedDrive, judge_bag
from launch_scripts.reporting.page import MAX_BYTES
from launch_scripts.reporting.panels import PANELS, Axis, Panel, Series
from sim_vehicle.parameters import load_vehicle_file
from tests.report_bags import (
    TICK_NS,
    Messages,
    odometry,
    road,
    straight_states,
    write_messages,
)
from tests.tools.test_result import CIRCLE, drive_messages, write_bag
from tests.workshop.bench.bench_report_page import make_bag

EXAMPLE = Path(__file__).parents[2] / "launch_scripts" / "reporting" / "thresholds.yaml"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a bag with all topics: 12 s, almost 5 s of them with faults."""
    return make_bag(tmp_path_factory.mktemp("whole") / "bag", minutes=0.2, start=590.0)


@pytest.fixture(scope="module")
def whole_drive(whole: Path) -> JudgedDrive:
    """Judge that bag."""
    return judged(whole)


def judged(bag: Path, namespace: str | None = None, **options: Any) -> JudgedDrive:
    return judge_bag(bag, "drive", namespace, **options)


def foreign(ticks: int = 30, topics: Messages | None = None) -> Messages:
    """Return messages of another system: odometry and a path, no command, or the given topics."""
    messages: Messages = {
        "/odom": odometry(straight_states(ticks)),
        "/reference_path": [road(0, 0)],
    }
    return messages | (topics or {})


def test_numbers_of_a_bag_with_ticks_are_those_it_was_made_of(whole_drive: JudgedDrive) -> None:
    drive = whole_drive
    found = drive.metrics
    assert found["ticks"] == 120
    assert found["missed_ticks"] == 0
    assert found["duration"] == pytest.approx(11.9)
    assert found["distance"] == pytest.approx(15.0 * 11.9)
    assert found["max_lateral_acceleration"] == pytest.approx(15.0**2 / 800.0)
    assert found["fall_backs"] == found["rung_shifted_plan"] == 49
    assert found["rung_optimal"] == 71
    assert found["time_constrained"] == pytest.approx(4.9)
    assert found["time_at_limit"] == 0.0
    assert drive.context.controller == "preview"
    assert drive.notes == []


def test_errors_are_worked_out_here_for_the_centre_of_gravity(whole_drive: JudgedDrive) -> None:
    drive = whole_drive
    radius = np.hypot(drive.states[:, 0], drive.states[:, 1] - 800.0)
    swing = 800.0 - np.hypot(radius, drive.context.to_cg)  # 1.5 m ahead on the tangent
    np.testing.assert_allclose(drive.errors[:, 0], swing, atol=1e-3)


def test_the_page_states_the_noise_of_the_path(tmp_path: Path) -> None:
    points = np.column_stack(
        (np.arange(0.0, 200.0), 0.02 * np.random.default_rng(1).normal(size=200))
    )
    noisy: Messages = {"/reference_path": [(0, ros.path_message(points, 0))]}
    drive = judged(write_messages(tmp_path / "noisy", foreign(topics=noisy)))
    assert drive.path_noise == pytest.approx(0.02, rel=0.2)
    assert ("Path noise", f"{100 * drive.path_noise:.1f} cm") in page.facts_of(drive)
    alone = judged(write_messages(tmp_path / "alone", {"/odom": odometry(straight_states(30))}))
    assert "Path noise" not in dict(page.facts_of(alone))


def test_an_old_bag_is_reported_with_what_it_lacks_in_words(tmp_path: Path) -> None:
    drive = judged(write_bag(tmp_path / "bag", {"": drive_messages(CIRCLE)}))
    assert drive.metrics["solve_time_median"] == pytest.approx(1e-4)
    assert drive.metrics["fall_backs"] is None
    text = " ".join(drive.notes)
    assert "no controller/configuration" in text
    assert "no controller/tick: no faults, fallbacks and guard" in text


def test_odometry_alone_is_a_drive(tmp_path: Path) -> None:
    drive = judged(write_messages(tmp_path / "bag", {"/odom": odometry(straight_states(30))}))
    assert drive.metrics["distance"] == pytest.approx(29.0)
    assert drive.metrics["max_cross_track_error"] is None
    assert "no reference_path" in drive.notes[-1]


def test_commands_with_stamps_of_their_own_answer_the_state_before(tmp_path: Path) -> None:
    commands = [
        (s.stamp_ns, ros.joint_message(s.stamp_ns + TICK_NS // 3, 0.01, 0.0))
        for s in straight_states(30)
    ]
    drive = judged(
        write_messages(tmp_path / "bag", foreign(topics={"/steering_command": commands}))
    )
    assert drive.metrics["ticks"] == 30
    assert drive.metrics["max_cross_track_error"] == pytest.approx(0.1)
    assert any(note.startswith("Commands carry no stamp") for note in drive.notes)


def test_each_tick_is_judged_by_the_path_that_was_in_force(tmp_path: Path) -> None:
    later = [road(0.0, 0), road(0.4, NANOSECONDS + 10 * TICK_NS)]
    drive = judged(write_messages(tmp_path / "bag", foreign(topics={"/reference_path": later})))
    np.testing.assert_allclose(drive.errors[:10, 0], 0.1, atol=1e-9)
    np.testing.assert_allclose(drive.errors[10:, 0], -0.3, atol=1e-9)


def test_log_times_of_another_clock_are_brought_onto_that_of_the_stamps(tmp_path: Path) -> None:
    ahead = 10**18
    stop = [(NANOSECONDS + 15 * TICK_NS + ahead, Bool(data=True))]
    topics = {"/odom": odometry(straight_states(30), ahead), "/stop_request": stop}
    drive = judged(write_messages(tmp_path / "bag", topics))
    assert drive.columns.values["stop_request"][0, 0] == pytest.approx(1.5)
    assert drive.metrics["stop_requests"] == 1


def test_shuffled_times_give_the_same_numbers_and_a_note(tmp_path: Path) -> None:
    rows = odometry(straight_states(30))
    order = np.random.default_rng(1).permutation(30)
    mixed = [(rows[k][0], rows[int(i)][1]) for k, i in enumerate(order)]
    straight = judged(write_messages(tmp_path / "straight", foreign()))
    shuffled = judged(write_messages(tmp_path / "mixed", foreign(topics={"/odom": mixed})))
    assert shuffled.metrics == straight.metrics
    assert any("time goes back" in note for note in shuffled.notes)


def test_unusable_messages_are_counted_and_the_rest_is_used(tmp_path: Path) -> None:
    states = straight_states(30)
    states[5] = states[5]._replace(x=math.nan)
    drive = judged(write_messages(tmp_path / "bag", {"/odom": odometry(states)}))
    assert drive.metrics["ticks"] == 29
    assert any(note.startswith("/odom: 1 of 30 messages") for note in drive.notes)


def test_a_topic_of_a_wrong_type_is_left_out_by_name(tmp_path: Path) -> None:
    words = {"/wind": [(NANOSECONDS, String(data="strong"))]}
    drive = judged(write_messages(tmp_path / "bag", foreign(topics=words)))
    sentence = "/wind holds std_msgs/msg/String, not geometry_msgs/msg/Vector3Stamped"
    assert any(sentence in note for note in drive.notes)


def test_a_configuration_that_is_none_is_left_out_by_name(tmp_path: Path) -> None:
    text = {"/controller/configuration": [(NANOSECONDS, String(data="chassis: {mass: -1"))]}
    drive = judged(write_messages(tmp_path / "bag", foreign(topics=text)))
    assert any("controller/configuration is no YAML" in note for note in drive.notes)


@pytest.mark.parametrize("value", [math.nan, math.inf, -3.0, 7.5, 1e300])
def test_no_number_in_a_tick_breaks_the_report(value: float, tmp_path: Path) -> None:
    ticks = []
    for s in straight_states(20):
        tick = JointState(name=list(ros.TICK_QUANTITIES))
        tick.position = [value] * len(ros.TICK_QUANTITIES)
        tick.header.stamp = ros.time_message(s.stamp_ns)
        ticks.append((s.stamp_ns, tick))
    bag = write_messages(tmp_path / "bag", foreign(topics={"/controller/tick": ticks}))
    assert main([str(bag)]) == 0
    summary = json.loads((tmp_path / "report.json").read_text())["drives"][0]["summary"]
    assert (summary["fall_backs"] is None) is not math.isfinite(value)


def test_one_namespace_is_reported_never_mixed_with_another(tmp_path: Path) -> None:
    topics = foreign() | {f"/car1{k}": v for k, v in foreign(20).items()}
    bag = write_messages(tmp_path / "bag", topics)
    assert judged(bag, "/car1").metrics["ticks"] == 20
    assert judged(bag, "").metrics["ticks"] == 30


def test_a_truncated_bag_is_reported_up_to_where_it_ends(tmp_path: Path) -> None:
    file = next(write_messages(tmp_path / "bag", foreign(300)).glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    drive = judged(file.parent)
    assert 50 < (drive.metrics["ticks"] or 0) < 250
    assert "not closed" in drive.notes[0]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "there is no such file or folder"),
        (b"", "the file is empty"),
        (b"#!/bin/sh", "does not begin as MCAP files do"),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line(
    content: bytes | None, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / "x.mcap").write_bytes(content)
    assert main([str(tmp_path / "x.mcap")]) == 2
    told = capsys.readouterr().out
    assert words in told
    assert told.count("\n") == 1
    assert not (tmp_path / "x_report.html").exists()


def test_odometry_of_a_wrong_type_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_messages(tmp_path / "bag", {"/odom": [(NANOSECONDS, String(data="here"))]})
    assert main([str(bag)]) == 2
    assert "/odom holds std_msgs/msg/String, not nav_msgs/msg/Odometry" in capsys.readouterr().out


def test_vehicle_of_a_bag_that_does_not_tell_may_be_named(tmp_path: Path) -> None:
    vehicle = load_vehicle_file(find("vehicles", "paper"))
    drive = judged(write_messages(tmp_path / "bag", foreign()), vehicle=vehicle)
    assert drive.context.to_cg == vehicle.chassis.cg_to_rear_axle
    outline = drive.context.outline
    length = vehicle.size.rear_overhang + vehicle.chassis.wheelbase + vehicle.size.front_overhang
    assert np.ptp(outline[:, 0]) == pytest.approx(length)
    assert np.ptp(outline[:, 1]) == pytest.approx(vehicle.size.width)


def test_the_bound_of_the_angle_is_that_of_the_controller(whole_drive: JudgedDrive) -> None:
    context, speeds = whole_drive.context, [0.0, 0.5, 5.0, 10.0, 30.0]
    assert context.settings is not None
    assert context.chassis is not None
    bound = context.angle_bound(np.array(speeds))
    assert bound is not None
    assert bound[0] == pytest.approx(math.pi / 6)
    assert bound[-1] < 0.1
    limits = limits_of(context.settings, context.steering)
    most = FRICTION_SHARE * limits.mu_g
    row = astuple(context.chassis)
    assert bound.tolist() == [angle_bound(row, v, limits.u_max, most) for v in speeds]


def test_the_guard_s_bound_is_its_angle_or_that_of_its_lateral_acceleration(
    whole_drive: JudgedDrive,
) -> None:
    row = {"max_rate": (1.0, 1.0), "lateral_jerk": (9.0, 9.0), "measured_step": (1.0, 1.0)}
    limits = GuardLimits(
        speed=(0.0, 20.0), max_angle=(0.6, 0.2), lateral_acceleration=(3.0, 3.0), **row
    )
    known = whole_drive.context._replace(guard=limits)
    chassis = known.chassis
    assert chassis is not None
    bound = known.guard_bound(np.array([1.0, 20.0]))
    assert bound is not None
    expected = 3.0 * (chassis.wheelbase / 400.0 + chassis.understeer_gradient)
    np.testing.assert_allclose(bound, [0.58, expected])
    assert known._replace(guard=None).guard_bound(np.array([1.0])) is None


def thresholds(folder: Path, text: str) -> str:
    (folder / "limits.yaml").write_text(text, encoding="utf-8")
    return str(folder / "limits.yaml")


@pytest.mark.parametrize(
    ("text", "code", "told"),
    [
        ("max_cross_track_error: 0.5\nmin_distance: 100", 0, "pass"),
        ("max_cross_track_error: 0.01", 1, "fail"),
        ("fall_backs: 48", 1, "49 ticks"),
        ("max_error: 0.5", 2, "limits.yaml: unknown key 'max_error'"),
        ("max_cross_track_error: wide", 2, "max_cross_track_error = 'wide' must be a number"),
        ("max_cross_track_error: -1.0", 2, "max_cross_track_error = -1.0 must lie in [0, inf] m"),
        ("{}", 2, "contains no threshold"),
    ],
)
def test_thresholds_decide_the_exit_code(
    whole: Path,
    text: str,
    code: int,
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(page, "PANELS", PANELS[:1])
    limits = thresholds(tmp_path, text)
    assert main([str(whole), "--output", str(tmp_path), "--thresholds", limits]) == code
    assert told in capsys.readouterr().out
    if code < 2:
        content = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
        assert content["passed"] is (code == 0)
        assert 'class="verdict' in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_what_a_bag_does_not_tell_fails_its_threshold(tmp_path: Path) -> None:
    bag = write_messages(tmp_path / "bag", foreign())
    limits = thresholds(tmp_path, "fall_backs: 0")
    assert main([str(bag), "--output", str(tmp_path / "page.html"), "--thresholds", limits]) == 1
    content = json.loads((tmp_path / "page.json").read_text(encoding="utf-8"))
    assert content["drives"][0]["verdicts"][0]["value"] is None


def test_the_shipped_thresholds_fail_only_where_the_drive_does(tmp_path: Path) -> None:
    states = straight_states(90)  # 0.1 m beside its path, solve time untold
    commands = [
        (s.stamp_ns, ros.steering_message(Plan(s.stamp_ns, 0.0, 0.0, Diagnosis()))) for s in states
    ]
    bag = write_messages(tmp_path / "bag", foreign(90) | {"/steering_command": commands})
    assert main([str(bag), "--thresholds", str(EXAMPLE)]) == 1
    content = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    failed = {v["threshold"] for v in content["drives"][0]["verdicts"] if not v["passed"]}
    assert failed == {"rms_cross_track_error", "unsolved_ticks", "solve_time_p99"}


def test_the_page_is_one_small_file_that_loads_nothing(whole: Path, tmp_path: Path) -> None:
    assert main([str(whole), "--output", str(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert len(text.encode()) <= MAX_BYTES < 3_000_000
    assert '<html lang="en">' in text
    assert text.count("<table") == text.count("<caption>")
    assert "src=" not in text
    assert "://" not in text
    assert "default-src 'none'" in text
    content = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert content["drives"][0]["summary"]["ticks"] == 120
    assert content["drives"][0]["configuration"]["controller"]["controller"] == "preview"


def test_names_from_outside_are_text_never_markup(tmp_path: Path) -> None:
    bag = write_messages(tmp_path / "<b>&amp;" / "bag", foreign())
    assert main([str(bag), "--output", str(tmp_path / "page.html")]) == 0
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<b>" not in text
    assert "&lt;b&gt;&amp;amp;" in text


def test_bags_side_by_side_keep_their_colours_in_all_plots(
    whole_drive: JudgedDrive, tmp_path: Path
) -> None:
    other = write_bag(tmp_path / "bag", {"": drive_messages(CIRCLE)})
    drives = [whole_drive._replace(name="a"), judged(other)._replace(name="b")]
    colours: dict[str, set[str]] = {"a": set(), "b": set()}
    for panel in PANELS:
        for line in draw_panel(panel, drives, 500).data:
            if ": " in line.name:
                colours[line.name.partition(": ")[0]].add(line.line.color)
    assert colours == {"a": {"#0072B2"}, "b": {"#D55E00"}}


def test_thinning_keeps_every_peak_and_shows_every_gap() -> None:
    time = np.arange(200_000, dtype=np.float64) * 0.02
    time[120_000:] += 60.0
    values = np.sin(0.01 * time)
    values[[777, 99_999, 150_001]] = 9.0, -7.0, 5.0
    x, y = thin_series(Series("", time, values), 1000)
    known = [value for value in y if value is not None]
    assert len(known) < 1500
    assert max(known) == 9.0
    assert min(known) == -7.0
    assert 5.0 in known
    assert y.count(None) == 1
    assert x[y.index(None)] == pytest.approx(time[119_999])


def test_a_line_that_steps_is_kept_where_it_changes() -> None:
    time, values = np.arange(1000, dtype=np.float64), np.repeat([3.0, 4.0], 500)
    x, y = thin_series(Series("", time, values, step=True), 1000)
    assert (x, y) == ([0.0, 500.0, 999.0], [3.0, 4.0, 4.0])


def test_names_tell_bags_apart_as_shortly_as_possible() -> None:
    assert names_of([Path("/runs/a/bag"), Path("/runs/b/bag")]) == ["a", "b"]
    assert names_of([Path("/x/one.mcap")]) == ["one"]
    assert names_of([Path("/m/a/bag"), Path("/n/a/bag")]) == ["m/a", "n/a"]
    assert names_of([Path("/m/a"), Path("/m/a")]) == ["a (1)", "a (2)"]


def test_the_page_lies_beside_its_bag_unless_told_otherwise() -> None:
    assert page_file(None, Path("/runs/a/bag")) == Path("/runs/a/report.html")
    assert page_file(None, Path("/data/drive_1")) == Path("/data/drive_1_report.html")
    assert page_file(Path("out"), Path("/x")) == Path("out/report.html")
    assert page_file(Path("out/my.html"), Path("/x")) == Path("out/my.html")


def test_a_panel_of_a_user_is_drawn_on_the_page(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def yaw_rate(drive: JudgedDrive) -> Iterator[Series]:
        yield Series("yaw rate", drive.record.time, drive.record.yaw_rate)

    panel = Panel("yaw_rate", "Yaw rate", "As measured.", (Axis("rate [rad/s]", yaw_rate),))
    monkeypatch.setattr(page, "PANELS", [PANELS[0], panel])
    monkeypatch.setattr(export, "PANELS", [PANELS[0], panel])
    assert main([str(whole), "--output", str(tmp_path), "--format", "svg"]) == 0
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert 'id="plot-yaw_rate" role="figure" aria-label="Yaw rate over time. yaw rate from' in text
    assert (tmp_path / "report_yaw_rate.svg").exists()


def test_exported_time_series_are_those_of_the_drive(
    whole: Path, whole_drive: JudgedDrive, tmp_path: Path
) -> None:
    assert main([str(whole), "--output", str(tmp_path / "my.html"), "--format", "csv"]) == 0
    drive = whole_drive
    with (tmp_path / "my.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 120

    def column(head: str) -> list[float]:
        return [float(row[head] or "nan") for row in rows]

    np.testing.assert_allclose(column("time [s]"), drive.record.time)
    np.testing.assert_allclose(column("yaw_rate [rad/s]"), drive.states[:, 5], rtol=1e-8)
    np.testing.assert_allclose(column("cross_track_error [m]"), drive.errors[:, 0], rtol=1e-8)
    np.testing.assert_allclose(column("steering_command [rad]"), drive.record.steering, rtol=1e-8)
    rungs = drive.record.tick["rung"][:, 1]
    np.testing.assert_array_equal(column("tick/rung"), rungs)
    assert "tick/solve_time [s]" in rows[0]
    assert not list(tmp_path.glob("*.svg"))


def test_sampled_values_hold_until_the_next_sample() -> None:
    rows = np.array([[1.0, 10.0], [2.0, 20.0]])
    found = export.latest(rows, np.array([0.5, 1.0, 1.9, 2.0, 9.0]))
    np.testing.assert_array_equal(found, [np.nan, 10.0, 10.0, 20.0, 20.0])


def test_charts_of_several_drives_are_exported(whole: Path, tmp_path: Path) -> None:
    other = write_bag(tmp_path / "other" / "bag", {"": drive_messages(CIRCLE)})
    arguments = [str(whole), str(other), "--output", str(tmp_path), "--format", "csv", "svg", "pdf"]
    assert main(arguments) == 0
    assert {file.name for file in tmp_path.glob("*.csv")} == {
        f"report_{whole.parent.name}.csv",
        "report_other.csv",
    }
    pdf = (tmp_path / "report.pdf").read_bytes()
    charts = {file.stem for file in tmp_path.glob("*.svg")}
    assert {"report_map", "report_steering", "report_events", "report_solve_time"} <= charts
    assert pdf.startswith(b"%PDF")
    assert pdf.count(b"/Type /Page\n") + pdf.count(b"/Type /Page ") == len(charts)
    text = (tmp_path / "report_events.svg").read_text(encoding="utf-8")
    assert text.count("<path") > 5
