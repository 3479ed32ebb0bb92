"""Columns of a path file: separator, decimal sign, header and units are inferred and stated."""

import csv
import math
import re
from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import read_text
from ampc_msgs_config.types import Array

MAX_CSV_BYTES, MAX_POINTS = 50_000_000, 500_000
"""Greatest size [bytes] and number of points of a CSV file."""
HEADER_NAMES = {
    "x": ("x_m", "x", "x_east_m", "easting", "easting_m", "east_m", "x_ref_m"),
    "y": ("y_m", "y", "y_north_m", "northing", "northing_m", "north_m", "y_ref_m"),
    "v": ("v_mps", "vx_mps", "speed_mps"),
    "t": ("t_s", "time_s"),
    "lat": ("lat", "latitude", "lat_deg", "latitude_deg"),
    "lon": ("lon", "lng", "long", "longitude", "lon_deg", "longitude_deg"),
}
"""Names of each quantity in a header, in lower case."""
UNITS = {"x": "m", "y": "m", "v": "m/s", "t": "s", "lat": "deg", "lon": "deg"}
SEPARATORS = {";": "semicolon", "\t": "tab", ",": "comma", " ": "space"}
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
WHOLE = re.compile(r"[+-]?\d+")
EXAMPLE = "a valid file begins with: x_m,y_m / 0.0,0.0 / 1.0,0.0"
SEMI_MAJOR_AXIS, FLATTENING = 6378137.0, 1 / 298.257223563
"""Ellipsoid of WGS 84 [m]; NGA.STND.0036, World Geodetic System 1984, 2014, table 3.1."""
MAX_REACH = 50_000.0
"""Greatest distance of a point from the first one in the tangent plane [m]."""


class PathTable(NamedTuple):
    """Numbers of a path file."""

    columns: dict[str, Array]
    """x [m], y [m], and v [m/s] or t [s] where the file has them (n,)."""
    note: str
    """What was inferred: separator, columns, units, conversion."""


def read_path_table(file: File, selection: str = "") -> PathTable:
    """Read a path file.

    Args:
        file: Text with one point a line; lines that begin with # are comments, the last one before
            the points may be the header.
        selection: Columns by number from 1, or by name: `x=3,y=4,v=speed`; empty: by the header.

    Raises:
        ValueError: File, header or line, and value.
    """
    text = read_text(file, MAX_CSV_BYTES).lstrip("\ufeff")
    try:
        return _table(text.splitlines(), selection)
    except csv.Error as error:
        raise ValueError(f"{file}: cannot be read: {error}") from error
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


def _table(lines: list[str], selection: str) -> PathTable:
    """Return the numbers of the lines of a file."""
    content = [(i, each) for i, each in enumerate(lines, 1) if each.strip()]
    body = [(i, each) for i, each in content if not each.lstrip().startswith("#")]
    if len(body) - 1 > MAX_POINTS:
        raise ValueError(f"{len(body) - 1} points are more than {MAX_POINTS}")
    first = body[0][0] if body else math.inf
    comments = [each for i, each in content if i < first and each.lstrip().startswith("#")]
    # the separator follows from the first line of numbers; the line before it may be the header
    separator = _separator(body[1][1] if len(body) > 1 else body[0][1] if body else ",")
    rows = list(
        zip((i for i, _ in body), _split([each for _, each in body], separator), strict=True)
    )
    names = _strip(rows.pop(0)[1]) if rows and not _is_number(rows[0][1][0], separator) else []
    if not names and comments:
        named = _strip(_split([comments[-1].strip().lstrip("#")], separator)[0])
        names = named if selection or _found(named).keys() & {"x", "lat"} else []
    width = len(names) or (len(rows[0][1]) if rows else 0)
    places = (
        _selected(selection, names, width) if selection else _inferred(names, width, bool(rows))
    )
    for line, row in rows:
        if len(row) > width and any(field.strip() for field in row[width:]):
            raise ValueError(
                f"line {line}: {len(row)} fields under {width} columns, header {names}; separate "
                "columns with semicolons if the comma is the decimal sign: 0,5;1,0"
            )
    columns = {key: _numbers(rows, i, separator) for key, i in places.items()}
    _check_times(columns, rows)
    shown = ", ".join(
        f"{key} = {names[i] if names else i + 1} [{UNITS[key]}]" for key, i in places.items()
    )
    note = f"separator {SEPARATORS[separator]}; {shown}"
    rest = [name for i, name in enumerate(names) if name and i not in places.values()]
    note += f"; not used: {', '.join(rest)}" if rest else ""
    if "lat" in columns:
        x, y = tangent_plane(columns.pop("lat"), columns.pop("lon"))
        columns |= {"x": x, "y": y}
        note += "; converted to the tangent plane (WGS 84) of the first point"
    return PathTable(columns, note)


def _separator(line: str) -> str:
    for separator in (";", "\t"):
        if separator in line:
            return separator
    fields = line.split()
    decimal = all(DECIMAL_COMMA.fullmatch(field) or WHOLE.fullmatch(field) for field in fields)
    if "," in line and not (len(fields) > 1 and decimal):
        return ","
    return " " if len(fields) > 1 else ","


def _split(lines: list[str], separator: str) -> list[list[str]]:
    if separator == " ":
        return [line.split() for line in lines]
    return [row or [""] for row in csv.reader(lines, delimiter=separator)]


def _strip(row: list[str]) -> list[str]:
    names = [name.strip(' #"') for name in row]
    while names and not names[-1]:
        names.pop()
    return names


def _is_number(text: str, separator: str) -> bool:
    try:
        _number(text.strip(), separator)
    except ValueError:
        return False
    return True


def _number(text: str, separator: str) -> float:
    """Return the number that a text states; Python reads 1_0 as 10, a path file does not."""
    if "_" in text:
        raise ValueError
    return float(_with_point(text, separator))


def _with_point(text: str, separator: str) -> str:
    """Return a number with a decimal point instead of a decimal comma."""
    return text.replace(",", ".") if separator != "," and DECIMAL_COMMA.fullmatch(text) else text


def _found(names: list[str]) -> dict[str, int]:
    """Return the column of each quantity that a header names.

    Raises:
        ValueError: A name or a quantity occurs twice.
    """
    lower = [name.lower() for name in names]
    twice = [name for i, name in enumerate(lower) if name and name in lower[:i]]
    if twice:
        raise ValueError(f"header {names} names {twice[0]!r} twice")
    result: dict[str, int] = {}
    for key, known in HEADER_NAMES.items():
        places = [i for i, name in enumerate(lower) if name in known]
        if len(places) > 1:
            both = " and ".join(repr(names[i]) for i in places)
            raise ValueError(f"header {names} names {key} more than once, {both}: select --columns")
        if places:
            result[key] = places[0]
    return result


def _inferred(names: list[str], width: int, lines: bool) -> dict[str, int]:
    """Return the columns by the header; without one, two columns are x and y."""
    if not names and width == 2 and lines:
        return {"x": 0, "y": 1}
    found = _found(names)
    cartesian = {"x", "y"} <= found.keys()
    if not cartesian and not {"lat", "lon"} <= found.keys():
        missing = f"no header and {width} columns" if not names and lines else f"header {names}"
        raise ValueError(
            f"{missing} must name x_m and y_m (or x,y; easting,northing; lat,lon), or select "
            f"columns, as in --columns x=1,y=2; {EXAMPLE}"
        )
    unused = {"lat", "lon"} if cartesian else {"x", "y"}
    return {key: i for key, i in found.items() if key not in unused}


def _selected(selection: str, names: list[str], width: int) -> dict[str, int]:
    """Return the columns of a selection such as `x=3,y=speed`."""
    result: dict[str, int] = {}
    for part in selection.split(","):
        key, _, column = (each.strip() for each in part.partition("="))
        if key not in HEADER_NAMES or not column or key in result:
            raise ValueError(
                f"columns {selection!r}: {part!r} must be one of {', '.join(HEADER_NAMES)}, once, "
                "with a number or name, as in x=3,y=4"
            )
        lower = [name.lower() for name in names]
        if column.lower() in lower:
            result[key] = lower.index(column.lower())
        elif column.isdecimal() and 1 <= int(column) <= width:
            result[key] = int(column) - 1
        else:
            raise ValueError(
                f"columns {selection!r}: {column!r} is neither one of {names} nor 1 to {width}"
            )
    if not ({"x", "y"} <= result.keys() or {"lat", "lon"} <= result.keys()):
        raise ValueError(f"columns {selection!r} must select x and y, or lat and lon")
    return result


def _numbers(rows: list[tuple[int, list[str]]], i: int, separator: str) -> Array:
    values = []
    for line, row in rows:
        text = row[i].strip() if i < len(row) else ""
        try:
            values.append(_number(text, separator))
        except ValueError:
            raise ValueError(f"line {line}: {text!r} must be a number") from None
        if not math.isfinite(values[-1]):
            raise ValueError(f"line {line}: {text!r} must be finite")
    return np.array(values)


def _check_times(columns: dict[str, Array], rows: list[tuple[int, list[str]]]) -> None:
    time = columns.get("t", np.zeros(1))
    backward = np.diff(time) < 0
    if backward.any():
        i = int(np.argmax(backward))
        raise ValueError(
            f"line {rows[i + 1][0]}: t_s = {time[i + 1]:g} must be greater than {time[i]:g} "
            "before it"
        )


def tangent_plane(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Return east and north of points on the ellipsoid in the tangent plane of the first one [m].

    Args:
        latitude: (n,) [deg].
        longitude: (n,) [deg].

    Raises:
        ValueError: An angle is out of range, or a point is too far from the first one.

    Source: B. Hofmann-Wellenhof et al., GNSS, Springer 2008, sections 8.2 and 8.3: geodetic to
    geocentric coordinates, and from there to the local frame.
    """
    for name, values, most in (("lat", latitude, 90.0), ("lon", longitude, 180.0)):
        if (np.abs(values) > most).any():
            value = values[int(np.argmax(np.abs(values)))]
            raise ValueError(f"{name} = {value:g} must lie in [-{most:g}, {most:g}] deg")
    if not len(latitude):
        return latitude, longitude
    phi, lam = np.radians(latitude), np.radians(longitude)
    squared = FLATTENING * (2 - FLATTENING)
    normal = SEMI_MAJOR_AXIS / np.sqrt(1 - squared * np.sin(phi) ** 2)
    X = normal * np.cos(phi) * np.cos(lam - lam[0])
    Y = normal * np.cos(phi) * np.sin(lam - lam[0])
    Z = normal * (1 - squared) * np.sin(phi)
    north = (Z - Z[0]) * math.cos(phi[0]) - (X - X[0]) * math.sin(phi[0])
    reach = float(np.hypot(Y, north).max())
    if reach > MAX_REACH:
        raise ValueError(f"points are {reach:g} m from the first one, at most {MAX_REACH:g} m")
    return np.asarray(Y), np.asarray(north)
