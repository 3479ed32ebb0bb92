"""The plant's own elementary functions against the library's."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from sim_vehicle.elementary import arc_sine, arc_tangent, sine, sine_and_cosine

Function = Callable[[float], float]
Grid = NDArray[np.float64]
EPSILON = 2.0**-52


def sine_of(x: float) -> float:
    return sine_and_cosine(x)[0]


def cosine_of(x: float) -> float:
    return sine_and_cosine(x)[1]


TURN = np.concatenate((np.linspace(-math.pi, math.pi, 4001), 10.0 ** np.linspace(-300, 0.0, 301)))
LONG = np.concatenate(
    (TURN, np.linspace(-2000.0, 2000.0, 8001), np.arange(-400, 401) * math.pi / 4)
)
RATIOS = np.concatenate((LONG, 10.0 ** np.linspace(-300, 300, 601), [math.sqrt(2) - 1, 1e9]))
SINES = np.concatenate((np.linspace(-1.0, 1.0, 8001), 1.0 - 10.0 ** np.linspace(-16, -1, 100)))
PAIRS = [
    pytest.param(sine, math.sin, TURN, id="sine"),
    pytest.param(sine_of, math.sin, LONG, id="sine_of_long_angles"),
    pytest.param(cosine_of, math.cos, LONG, id="cosine"),
    pytest.param(arc_tangent, math.atan, RATIOS, id="arc_tangent"),
    pytest.param(arc_sine, math.asin, SINES, id="arc_sine"),
]


@pytest.mark.parametrize(("own", "library", "grid"), PAIRS)
def test_value_is_the_library_s_within_two_units_in_the_last_place(
    own: Function, library: Function, grid: Grid
) -> None:
    beyond_the_bits_of_pi = 1e-27  # matters beside a zero other than 0
    for x in grid.tolist():
        tolerance = 2.0 * EPSILON * abs(library(x)) + beyond_the_bits_of_pi * (abs(x) > 1.0)
        assert abs(own(x) - library(x)) <= tolerance, x


@pytest.mark.parametrize(("own", "library", "grid"), PAIRS)
def test_function_is_odd_or_even_to_the_last_bit(
    own: Function, library: Function, grid: Grid
) -> None:
    sign = 1.0 if library is math.cos else -1.0
    for x in grid.tolist():
        assert own(-x) == sign * own(x), x


@pytest.mark.parametrize(("own", "library", "grid"), PAIRS)
def test_zero_is_exact(own: Function, library: Function, grid: Grid) -> None:
    assert own(0.0) == own(-0.0) == library(0.0)


def test_limits_are_exact() -> None:
    for sign in (1.0, -1.0):
        assert arc_tangent(sign * math.inf) == arc_tangent(sign * 1e300) == sign * math.pi / 2
        assert arc_tangent(sign) == sign * math.pi / 4
        assert arc_sine(sign) == sign * math.pi / 2
        assert sine(sign * math.pi / 2) == sign


@pytest.mark.parametrize("own", [sine, sine_of, cosine_of, arc_tangent, arc_sine])
def test_what_is_no_number_stays_none(own: Function) -> None:
    assert math.isnan(own(math.nan))
