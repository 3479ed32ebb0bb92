"""Tables in compiled code give what numpy gives."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.interpolation import interpolate, section

many = settings(max_examples=200, deadline=None, derandomize=True)
eighths = st.integers(-8000, 8000).map(lambda number: number / 8)
tables = st.lists(eighths, min_size=1, max_size=12, unique=True)


@many
@given(at=tables, place=st.floats(-2e3, 2e3), seed=st.integers(0, 1000))
def test_interpolation_is_that_of_numpy_bit_for_bit(
    at: list[float], place: float, seed: int
) -> None:
    places = np.array(sorted(at))
    values = np.random.default_rng(seed).normal(0.0, 100.0, len(at))
    for where in (place, *places.tolist()):
        assert interpolate(where, places, values) == np.interp(where, places, values)


@many
@given(at=tables.filter(lambda at: len(at) > 1), place=st.floats(-2e3, 2e3))
def test_section_is_that_of_a_search_of_numpy(at: list[float], place: float) -> None:
    places = np.array(sorted(at))
    for where in (place, *places.tolist()):
        actual = np.searchsorted(places, where, side="right") - 1
        assert section(where, places) == np.clip(actual, 0, len(at) - 2)


def test_place_that_is_no_number_has_no_value() -> None:
    assert math.isnan(interpolate(math.nan, np.array([0.0, 1.0]), np.array([2.0, 3.0])))
