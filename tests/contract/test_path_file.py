"""CSV paths: every kind of header and line that users bring, and the real ones."""

import math
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.path_file import (
    MAX_BYTES,
    MAX_POINTS,
    Route,
    SpeedLimits,
    choose_scenario,
    from_csv,
)
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import Scenario, speed_at

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
with_data = pytest.mark.skipif(not DATA.is_dir(), reason="../shared/data is not at hand")
SIZE = load(SizeParameters, find("vehicles", "paper"), "size")
STRAIGHT = "0,0\n10,0\n20,0\n30,0\n"


def csv_file(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    """Write a path file."""
    file = folder / "road.csv"
    file.write_bytes(text.encode(encoding))
    return file


def speeds(scenario: Scenario, *places: float) -> list[float]:
    """Return the speed at these arc lengths [m/s]."""
    return [speed_at(scenario.speed, place) for place in places]


@pytest.mark.parametrize(
    "text",
    [
        "x_m,y_m\n" + STRAIGHT,
        "# x_m, y_m\n" + STRAIGHT,
        "x_east_m,y_north_m\n" + STRAIGHT,
        "x_m,y_m\r\n" + STRAIGHT.replace("\n", "\r\n"),
        "\ufeffx_m,y_m\n" + STRAIGHT,
        "x_m,y_m\n\n" + STRAIGHT.replace("\n", "\n\n"),
        "yaw_rad,y_m,colour,x_m\n0,0,red,0\n0,0,red,10\n0,0,,20\n0,0,blue,30\n",
        '"x_m","y_m"\n"0","0"\n10,0\n 20 , 0 \n3e1,0\n',
        "x_m,y_m\n0,0\n0,0\n10,0\n10,0\n20,0\n30,0\n30,0\n",
    ],
    ids=["plain", "hash", "east north", "CRLF", "BOM", "blank lines", "order", "quotes", "twice"],
)
def test_header_names_decide_which_columns_count(text: str, tmp_path: Path) -> None:
    scenario = from_csv(csv_file(tmp_path, text), speed=5.0)
    path = make_path(scenario.points)
    assert path.length == pytest.approx(30.0)
    np.testing.assert_allclose(path.y, 0.0, atol=1e-12)
    assert scenario.name == "road"
    assert scenario.duration == pytest.approx(6.0, abs=0.11)


def test_speed_comes_from_its_column(tmp_path: Path) -> None:
    scenario = from_csv(csv_file(tmp_path, "x_m,y_m,v_mps\n0,0,2\n10,0,4\n20,0,4\n30,0,1\n"))
    assert speeds(scenario, 0.0, 5.0, 10.0, 25.0, 30.0, 99.0) == pytest.approx([2, 3, 4, 2.5, 1, 1])


def test_speed_comes_from_the_time_stamps(tmp_path: Path) -> None:
    scenario = from_csv(csv_file(tmp_path, "t_s,x_m,y_m\n5,0,0\n7,10,0\n9,20,0\n11,30,0\n"))
    assert speeds(scenario, 0.0, 15.0, 30.0) == pytest.approx([5.0, 5.0, 5.0])
    assert scenario.duration == pytest.approx(6.0, abs=0.11)


def test_given_speed_replaces_that_of_the_file(tmp_path: Path) -> None:
    file = csv_file(tmp_path, "x_m,y_m,v_mps\n0,0,2\n10,0,4\n20,0,4\n")
    assert speeds(from_csv(file, speed=7.0), 0.0, 15.0) == [7.0, 7.0]


def test_car_starts_along_the_path_though_its_first_points_are_the_same(tmp_path: Path) -> None:
    file = csv_file(tmp_path, "t_s,x_m,y_m\n0,3,4\n1,3,4\n2,3,9\n3,3,14\n4,3,19\n")
    assert from_csv(file).start == pytest.approx((3.0, 4.0, math.pi / 2))


BAD = {
    "there is no such": (None, "cannot be read"),
    "empty": ("", r"header \[\] must name x_m and y_m"),
    "no header": (STRAIGHT, r"header \['0', '0'\] must name x_m and y_m"),
    "half a header": ("x_m,z_m\n1,2\n", r"header \['x_m', 'z_m'\] must name x_m and y_m"),
    "words": ("x_m,y_m\n0,0\n1,left\n", r"line 3: 'left' must be a number"),
    "words after blank lines": ("x_m,y_m\n\n0,0\n\n1,left\n", r"line 5: 'left' must be a number"),
    "short line": ("x_m,y_m\n0,0\n1\n", r"line 3: '' must be a number"),
    "comma as point": ("x_m;y_m\n0,5;1\n", r"header \['x_m;y_m'\] must name"),
    "nan": ("x_m,y_m\n0,0\nnan,0\n", r"line 3: 'nan' must be finite"),
    "inf": ("x_m,y_m,v_mps\n0,0,1\n1,0,inf\n", r"line 3: 'inf' must be finite"),
    "no lines": ("x_m,y_m,v_mps\n", r"0 different points, at least 2"),
    "one point": ("x_m,y_m,v_mps\n1,1,1\n1,1,1\n", r"1 different points, at least 2"),
    "no speed": ("x_m,y_m\n" + STRAIGHT, r"has neither v_mps nor t_s"),
    "negative speed": ("x_m,y_m,v_mps\n0,0,1\n1,0,-1\n2,0,1\n", r"must lie in \[0, 100\] m/s"),
    "time stands": ("t_s,x_m,y_m\n0,0,0\n0,1,0\n1,2,0\n", r"t_s = 0 must be greater than 0"),
    "time goes back": ("t_s,x_m,y_m\n0,0,0\n2,1,0\n1,2,0\n", r"t_s = 1 must be greater than 2"),
    "another frame": ("x_m,y_m,v_mps\n0,0,1\n1,0,1\n5e8,5e8,1\n", r"length = .* must be at most"),
    "many points": ("x_m,y_m\n" + "1,0\n" * (MAX_POINTS + 1), r"500001 points are more than"),
    "many bytes": ("x_m,y_m\n" + " " * MAX_BYTES, r"\d+ bytes are more than"),
    "huge field": ("x_m,y_m\n" + "1" * 200_000 + ",0\n", r"cannot be read: field larger"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_file_is_refused_with_file_line_and_value(kind: str, tmp_path: Path) -> None:
    text, complaint = BAD[kind]
    file = tmp_path / "road.csv" if text is None else csv_file(tmp_path, text)
    with pytest.raises(ValueError, match=f"road.csv: .*{complaint}"):
        from_csv(file)


def test_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "road.csv").write_bytes(b"\xff\xfe\x00x\x80")
    with pytest.raises(ValueError, match=r"road.csv: (cannot be read|header)"):
        from_csv(tmp_path / "road.csv", 5.0)


@pytest.mark.parametrize("laps", [1, 3])
def test_closed_path_is_driven_as_many_laps_as_wished(laps: int, tmp_path: Path) -> None:
    angle = np.linspace(0.0, math.tau, 80, endpoint=False)
    text = "".join(f"{30 * math.cos(a)},{30 * math.sin(a)}\n" for a in angle)
    scenario = from_csv(csv_file(tmp_path, "x_m,y_m\n" + text), speed=6.0, laps=laps)
    assert scenario.duration == pytest.approx(laps * math.tau * 30.0 / 6.0, abs=0.2)
    assert speed_at(scenario.speed, 1000.0) == 6.0


def test_limits_slow_the_car_before_and_behind_a_bend(tmp_path: Path) -> None:
    """A quarter circle of 20 m between two straights: v^2 / R <= 4, v dv/ds <= 2."""
    angle = np.linspace(0.0, math.pi / 2, 30)
    bend = [(100 + 20 * math.sin(a), 20 - 20 * math.cos(a)) for a in angle]
    rest = [(120.0, 20.0 + s) for s in range(2, 100, 2)]
    points = [(float(x), 0.0) for x in range(0, 100, 2)] + bend + rest
    text = "x_m,y_m\n" + "".join(f"{x},{y}\n" for x, y in points)
    scenario = from_csv(csv_file(tmp_path, text), 25.0, SpeedLimits(4.0, 2.0, 18.0))
    path = make_path(scenario.points)
    v, at = scenario.speed.speed, scenario.speed.at
    assert v.max() <= 18.0
    assert (v**2 * np.abs(path.curvature) <= 4.0 + 1e-9).all()
    assert (np.abs(np.diff(v**2)) <= 2 * 2.0 * np.diff(at) + 1e-9).all()
    in_bend = float(np.interp(115.0, at, v))
    assert in_bend == pytest.approx(math.sqrt(4.0 * 20.0), rel=0.03)


def test_file_wins_over_the_name_of_a_scenario(tmp_path: Path) -> None:
    file = csv_file(tmp_path, "x_m,y_m,v_mps\n0,0,2\n10,0,4\n")
    assert choose_scenario(Route("sc1", path=str(file)), SIZE).name == "road"
    assert choose_scenario(Route("sc1"), SIZE).name == "sc1"


@with_data
@pytest.mark.parametrize(
    ("name", "length", "speed"),
    [
        ("authors_trajectories/double_lane_change_30mps.csv", None, 30.0),
        ("authors_trajectories/lane_change_30mps.csv", None, 30.0),
        ("authors_trajectories/weave_20mps.csv", None, 20.0),
        ("authors_trajectories/general_9mps.csv", None, None),
        ("real_drive/comma2k19_example1.csv", None, None),
        ("tracks/Oschersleben.csv", 3692.0, None),
        ("tracks/Norisring.csv", 2296.0, None),
        ("tracks/IMS.csv", 4022.0, None),
    ],
)
def test_real_paths_load(name: str, length: float | None, speed: float | None) -> None:
    circuit = name.startswith("tracks")
    scenario = from_csv(DATA / name, limits=SpeedLimits(4.0) if circuit else None)
    path = make_path(scenario.points)
    assert path.closed is circuit
    if length is not None:
        assert path.length == pytest.approx(length, rel=0.01)
    if speed is not None:
        assert speed_at(scenario.speed, path.length / 2) == pytest.approx(speed, rel=0.05)
    assert 3.0 < scenario.duration < 600.0


@with_data
def test_speed_of_the_real_drive_is_what_its_satellite_receiver_measured() -> None:
    file = DATA / "real_drive" / "comma2k19_example1.csv"
    table = np.genfromtxt(file, delimiter=",", names=True)
    distance = np.concatenate(
        ([0.0], np.cumsum(np.hypot(np.diff(table["x_east_m"]), np.diff(table["y_north_m"]))))
    )
    profile = from_csv(file).speed
    read = np.array([speed_at(profile, float(s)) for s in distance])
    assert float(np.abs(read - table["gps_speed_mps"]).mean()) < 0.2
