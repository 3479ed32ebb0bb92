"""CSV paths: every kind of header and line that users bring, and the real ones."""

import math
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.csv_columns import MAX_CSV_BYTES, MAX_POINTS, tangent_plane
from ampc_msgs_config.paths.path import END_DECELERATION
from ampc_msgs_config.paths.path_file import (
    Route,
    SpeedLimits,
    choose_scenario,
    from_csv,
)
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import Scenario, speed_at
from ampc_msgs_config.vehicle_file import load_section

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
with_data = pytest.mark.skipif(not DATA.is_dir(), reason="../shared/data is not at hand")
SIZE = load_section(SizeParameters, find("vehicles", "paper"), "size")
BRAKING = (5.0 - 0.5) / (2 * END_DECELERATION)
"""Additional time of a drive at 5 m/s that brakes at the end of the path, down to 0.5 m/s [s]."""
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
    assert scenario.duration == pytest.approx(6.0 + BRAKING, abs=0.11)


def test_speed_comes_from_its_column(tmp_path: Path) -> None:
    scenario = from_csv(csv_file(tmp_path, "x_m,y_m,v_mps\n0,0,2\n10,0,4\n20,0,4\n30,0,1\n"))
    assert speeds(scenario, 0.0, 5.0, 10.0, 25.0, 30.0, 99.0) == pytest.approx([2, 3, 4, 2.5, 1, 1])


def test_speed_comes_from_the_time_stamps(tmp_path: Path) -> None:
    scenario = from_csv(csv_file(tmp_path, "t_s,x_m,y_m\n5,0,0\n7,10,0\n9,20,0\n11,30,0\n"))
    assert speeds(scenario, 0.0, 15.0, 30.0) == pytest.approx([5.0, 5.0, 5.0])
    assert scenario.duration == pytest.approx(6.0 + BRAKING, abs=0.11)


def test_given_speed_replaces_that_of_the_file(tmp_path: Path) -> None:
    file = csv_file(tmp_path, "x_m,y_m,v_mps\n0,0,2\n10,0,4\n20,0,4\n")
    assert speeds(from_csv(file, speed=7.0), 0.0, 15.0) == [7.0, 7.0]


def test_car_starts_along_the_path_though_its_first_points_are_the_same(tmp_path: Path) -> None:
    file = csv_file(tmp_path, "t_s,x_m,y_m\n0,3,4\n1,3,4\n2,3,9\n3,3,14\n4,3,19\n")
    assert from_csv(file).start == pytest.approx((3.0, 4.0, math.pi / 2))


BAD = {
    "there is no such": (None, "cannot be read"),
    "empty": ("", r"header \[\] must name x_m and y_m"),
    "header of separators": (",,\n0,0,0\n", r"no header and 3 columns must name x_m"),
    "no header, four columns": ("0,0,0,0\n1,0,0,0\n", r"no header and 4 columns must name x_m"),
    "name twice": ("x_m,y_m,x_m\n0,0,0\n1,0,0\n", r"header .* names 'x_m' twice"),
    "two names for x": ("x_m,y_m,easting\n0,0,0\n", r"names x more than once, 'x_m' and 'easting'"),
    "extra fields": ("x_m,y_m\n0,0\n1,5,0,5\n", r"line 3: 4 fields under 2 columns, header"),
    "latitude": ("lat,lon\n95,8\n95,8.1\n", r"lat = 95 must lie in \[-90, 90\] deg"),
    "far apart": ("lat,lon\n48,8\n49,8\n", r"points are 111\d+ m from the first one"),
    "thousands": ("x_m;y_m\n1.234,5;1\n", r"line 2: '1.234,5' must be a number"),
    "half a header": ("x_m,z_m\n1,2\n", r"header \['x_m', 'z_m'\] must name x_m and y_m"),
    "words": ("x_m,y_m\n0,0\n1,left\n", r"line 3: 'left' must be a number"),
    "words after blank lines": ("x_m,y_m\n\n0,0\n\n1,left\n", r"line 5: 'left' must be a number"),
    "short line": ("x_m,y_m\n0,0\n1\n", r"line 3: '' must be a number"),
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
    "many bytes": ("x_m,y_m\n" + " " * MAX_CSV_BYTES, r"\d+ bytes are more than"),
    "huge field": ("x_m,y_m\n" + "1" * 200_000 + ",0\n", r"cannot be read: field larger"),
}


FORMATS = {
    "semicolon": "x_m;y_m\n0;0\n10;0\n20.5;0\n30;0\n",
    "semicolon and decimal comma": "x_m;y_m\n0,0;0,0\n10;0\n20,5;0,0\n30;0\n",
    "tab": "x_m\ty_m\n0\t0\n10\t0\n20.5\t0\n30\t0\n",
    "tab and decimal comma": "x_m\ty_m\n0,0\t0\n10,0\t0,0\n20,5\t0\n30\t0\n",
    "spaces": "x  y\n 0 0\n 10   0\n20.5 0\n30 0\n",
    "spaces and decimal comma": "x y\n0,0 0,0\n10,0 0,0\n20,5 0,0\n30,0 0,0\n",
    "comments": "# a survey\nx_m,y_m\n0,0\n# half-way\n10,0\n20.5,0\n30,0\n",
    "upper case": "X_M , Y_M\n0,0\n10,0\n20.5,0\n30,0\n",
    "survey": "id,Easting,Northing,code\n1,0,0,a\n2,10,0,b\n3,20.5,0,\n4,30,0,c\n",
    "no header": "0,0\n10,0\n20.5,0\n30,0\n",
    "no header, spaces": "0 0\n10 0\n20.5 0\n30 0\n",
    "trailing separator": "x_m,y_m,\n0,0,\n10,0,\n20.5,0,\n30,0,\n",
}


@pytest.mark.parametrize("name", FORMATS)
def test_separator_decimal_sign_and_header_are_inferred(name: str, tmp_path: Path) -> None:
    scenario = from_csv(csv_file(tmp_path, FORMATS[name]), speed=5.0)
    np.testing.assert_array_equal(scenario.points, [[0, 0], [10, 0], [20.5, 0], [30, 0]])
    separator = next((word for word in ("semicolon", "tab", "space") if word in name), "comma")
    assert f"4 points, separator {separator}; x = " in scenario.note
    assert "[m]" in scenario.note
    assert "open: it has 4 points" in scenario.note


def test_note_names_the_columns_that_are_not_used(tmp_path: Path) -> None:
    scenario = from_csv(csv_file(tmp_path, "x_m,y_m,v_kmh\n0,0,9\n10,0,9\n"), speed=5.0)
    assert "; not used: v_kmh;" in scenario.note


def test_raceline_of_tum_is_read_with_its_speed(tmp_path: Path) -> None:
    text = "# 2f5b\n# 9d1c\n# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2\n"
    text += "".join(f"{s}.0; {s}.0; 1.0; -1.57; 0.0; 12.5; 0.0\n" for s in range(0, 50, 5))
    scenario = from_csv(csv_file(tmp_path, text))
    assert scenario.points[2].tolist() == [10.0, 1.0]
    assert speeds(scenario, 20.0) == [12.5]


@pytest.mark.parametrize(
    ("latitude", "per_latitude", "per_longitude"),
    [(0.0, 110_574.3, 111_319.5), (30.0, 110_852.4, 96_486.3), (45.0, 111_131.8, 78_846.8)],
)
def test_tangent_plane_meets_the_published_lengths_of_a_degree(
    latitude: float, per_latitude: float, per_longitude: float
) -> None:
    """Lengths of a degree on WGS 84 [m]: Wikipedia, Geographic coordinate system."""
    lat = np.array([latitude, latitude + 0.001, latitude])
    east, north = tangent_plane(lat, np.array([179.9, 179.9, 179.901]))
    assert 1000 * north[1] == pytest.approx(per_latitude, rel=2e-5)
    assert 1000 * east[2] == pytest.approx(per_longitude, rel=2e-5)
    assert (east[0], north[0], east[1]) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_latitude_and_longitude_are_converted(tmp_path: Path) -> None:
    text = "time_s,lat,lon\n0,48.0,8.0\n2,48.0001,8.0\n4,48.0002,8.0\n"
    scenario = from_csv(csv_file(tmp_path, text))
    assert scenario.points[:, 1] == pytest.approx([0.0, 11.119, 22.238], abs=0.001)
    assert speeds(scenario, 10.0) == pytest.approx([5.56], abs=0.01)
    assert "converted to the tangent plane (WGS 84)" in scenario.note


@pytest.mark.parametrize("columns", ["x=3,y=4", "x=east,y=4,v=2", " y = north , x = East "])
def test_columns_are_selected_by_number_or_name(columns: str, tmp_path: Path) -> None:
    text = "n,v,east,north\n1,5,0,7\n2,5,10,7\n3,5,20,7\n"
    scenario = from_csv(csv_file(tmp_path, text), speed=5.0, columns=columns)
    assert scenario.points.tolist() == [[0, 7], [10, 7], [20, 7]]
    without_header = text.partition("\n")[2]
    scenario = from_csv(csv_file(tmp_path, without_header), speed=5.0, columns="x=3,y=4")
    assert scenario.points.tolist() == [[0, 7], [10, 7], [20, 7]]


@pytest.mark.parametrize(
    ("columns", "complaint"),
    [
        ("x=9,y=1", "'9' is neither one of .* nor 1 to 3"),
        ("x=0,y=1", "'0' is neither"),
        ("x=1", "must select x and y"),
        ("x=1,x=2,y=3", "'x=2' must be one of x, y, v, t, lat, lon, once"),
        ("z=1,y=2", "'z=1' must be one of"),
        ("x,y", "'x' must be one of"),
    ],
)
def test_bad_selection_is_rejected(columns: str, complaint: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"road.csv: columns .*{complaint}"):
        from_csv(csv_file(tmp_path, "a,b,c\n0,0,0\n1,1,1\n"), 5.0, columns=columns)


def test_times_that_decrease_are_rejected_even_if_a_speed_is_selected(tmp_path: Path) -> None:
    file = csv_file(tmp_path, "t_s,x_m,y_m\n0,0,0\n2,1,0\n1,2,0\n")
    with pytest.raises(ValueError, match=r"line 4: t_s = 1 must be greater than 2"):
        from_csv(file, speed=5.0)


def test_laps_on_an_open_path_are_rejected_with_the_reason(tmp_path: Path) -> None:
    file = csv_file(tmp_path, "x_m,y_m\n" + "".join(f"{x},0\n" for x in range(40)))
    route = Route(path=str(file), speed=5.0, laps=3)
    with pytest.raises(
        ValueError, match=r"laps = 3, but the path is open: its ends are 39 m apart"
    ):
        choose_scenario(route, SIZE)
    assert choose_scenario(route._replace(laps=1), SIZE).name == "road"


@with_data
@pytest.mark.parametrize("circuit", ["Oschersleben", "Norisring"])
@pytest.mark.parametrize("grid", [0.01, 0.05])
def test_rounding_a_circuit_does_not_change_its_lap_time(
    circuit: str, grid: float, tmp_path: Path
) -> None:
    file = DATA / "tracks" / f"{circuit}.csv"
    clean = from_csv(file, limits=SpeedLimits(4.0))
    path = clean.path
    points = np.column_stack((path.x, path.y))[:-1:4]
    text = "".join(f"{x},{y}\n" for x, y in (np.round(points / grid) * grid).tolist())
    rounded = from_csv(csv_file(tmp_path, "x_m,y_m\n" + text), limits=SpeedLimits(4.0))
    assert rounded.path.closed
    assert rounded.duration == pytest.approx(clean.duration, rel=0.05)


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


def test_speeds_along_a_closed_path_match_where_its_laps_meet(tmp_path: Path) -> None:
    angle = np.linspace(0.0, math.tau, 80, endpoint=False)
    slow = [2.0] + [12.0] * 78 + [4.0]
    rows = (
        f"{60 * math.cos(a)},{60 * math.sin(a)},{v}\n" for a, v in zip(angle, slow, strict=True)
    )
    file = csv_file(tmp_path, "x_m,y_m,v_mps\n" + "".join(rows))
    scenario = from_csv(file, limits=SpeedLimits(40.0, 1.5, 50.0))
    v, at = scenario.speed.speed, scenario.speed.at
    assert v[0] == v[-1] == 2.0
    assert (np.abs(np.diff(v**2)) <= 2 * 1.5 * np.diff(at) + 1e-9).all()
    assert v.max() > 10.0


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


def test_a_point_beside_the_path_and_a_speed_beyond_the_tyres_are_reported(tmp_path: Path) -> None:
    s = np.arange(0.0, 120.0, 0.5)
    x, y = 20.0 * np.sin(s / 20.0), 20.0 * (1.0 - np.cos(s / 20.0))
    y[100] += 0.8

    def note(speed: float) -> str:
        rows = "".join(f"{a:.4f},{b:.4f}\n" for a, b in zip(x, y, strict=True))
        return from_csv(csv_file(tmp_path, f"x_m,y_m\n{rows}"), speed=speed).note

    assert "point 101 lies 0." in note(5.0)
    assert "demands" not in note(5.0)
    assert "more than tyres on dry asphalt allow" in note(15.0)
    y[100] -= 0.8
    assert "lies" not in note(5.0)
