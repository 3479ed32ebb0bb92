"""The tyre against its formula, its limits, and its behaviour in time."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from sim_vehicle.pacejka import (
    cornering_stiffness,
    lateral_force,
    peak_force,
    transient_slip,
    tyre_forces,
)

C_ALPHA, STATIC_LOAD = 33000.0, 3311.0
MAGIC = (1.0, 1.5, -0.5, 0.1, 2.0, 0.1, 0.04, C_ALPHA, STATIC_LOAD)
LINEAR = (0.0, *MAGIC[1:])
STEP = 0.005

slips = st.floats(-math.pi, math.pi)
loads = st.floats(0.0, 30000.0)
frictions = st.floats(0.01, 2.0)
demands = st.floats(-1.0e5, 1.0e5)
speeds = st.floats(-40.0, 40.0)
tyres = st.sampled_from([MAGIC, LINEAR])
many = settings(max_examples=300, deadline=None)


@pytest.mark.parametrize("load", [500.0, 3311.0, 5200.0])
def test_force_is_the_magic_formula_of_the_nominal_plant(load: float) -> None:
    z = load / 3311.0
    D = 0.9 * load * (1 - 0.1 * (z - 1))
    B = C_ALPHA * 1.25 * z / (1 + z**2 / 4) / (1.5 * D)
    for slip in (-0.4, -0.1, -0.01, 0.0, 0.003, 0.05, 0.2, 1.5):
        inner = B * slip + 0.5 * (B * slip - math.atan(B * slip))
        expected = D * math.sin(1.5 * math.atan(inner))
        assert lateral_force(slip, load, 0.9, MAGIC) == pytest.approx(expected, rel=1e-9)


@many
@given(load=st.floats(10.0, 30000.0), friction=frictions)
def test_slope_at_zero_slip_is_the_cornering_stiffness(load: float, friction: float) -> None:
    slip = 1.0e-7
    slope = lateral_force(slip, load, friction, MAGIC) / slip
    assert slope == pytest.approx(cornering_stiffness(load, MAGIC), rel=1e-4)


def test_cornering_stiffness_is_c_alpha_at_the_static_load_and_peaks_at_twice_that() -> None:
    assert cornering_stiffness(STATIC_LOAD, MAGIC) == pytest.approx(C_ALPHA)
    values = [cornering_stiffness(float(z) * STATIC_LOAD, MAGIC) for z in np.arange(0.0, 4.0, 0.01)]
    assert np.argmax(values) == 200


def test_linear_tyre_is_c_alpha_times_slip_up_to_the_friction_limit() -> None:
    for load in (1000.0, STATIC_LOAD, 6000.0):
        assert lateral_force(0.02, load, 0.9, LINEAR) == pytest.approx(0.02 * C_ALPHA)
        assert lateral_force(-0.02, load, 0.9, LINEAR) == pytest.approx(-0.02 * C_ALPHA)
        assert lateral_force(0.5, load, 0.9, LINEAR) == peak_force(load, 0.9, LINEAR)


@many
@given(slip=slips, demand=demands, load=loads, friction=frictions, tyre=tyres)
def test_force_stays_inside_the_friction_limit_for_any_slip_load_and_demand(
    slip: float, demand: float, load: float, friction: float, tyre: tuple[float, ...]
) -> None:
    force = math.hypot(*tyre_forces(slip, demand, load, friction, tyre))
    assert force <= peak_force(load, friction, tyre) * (1 + 1e-12) + 1e-8
    assert peak_force(load, friction, tyre) <= 1.1 * friction * load + 1e-12


@many
@given(slip=slips, demand=demands, load=loads, friction=frictions, tyre=tyres)
def test_lateral_force_is_odd_in_slip_and_even_in_the_longitudinal_force(
    slip: float, demand: float, load: float, friction: float, tyre: tuple[float, ...]
) -> None:
    F_x, F_y = tyre_forces(slip, demand, load, friction, tyre)
    assert tyre_forces(-slip, demand, load, friction, tyre) == (F_x, -F_y)
    assert tyre_forces(slip, -demand, load, friction, tyre) == (-F_x, F_y)
    assert F_y * slip >= 0.0


def test_full_braking_leaves_a_fifth_of_the_lateral_force() -> None:
    free, braked = (tyre_forces(0.1, demand, 4000.0, 0.9, MAGIC)[1] for demand in (0.0, -1.0e6))
    assert braked / free == pytest.approx(0.2, abs=0.005)


def test_lifted_wheel_makes_no_force() -> None:
    for tyre in (MAGIC, LINEAR):
        assert tyre_forces(0.2, 500.0, 0.0, 0.9, tyre) == (0.0, 0.0)


@pytest.mark.parametrize("slip", [-0.05, 0.05])
@pytest.mark.parametrize("speed", [0.5, 5.0, 15.0])
def test_slip_builds_up_over_the_relaxation_length(slip: float, speed: float) -> None:
    rolling, sliding = speed * math.cos(slip), -speed * math.sin(slip)

    def rate(_: float, s: Any, /) -> Any:
        return transient_slip(float(s[0]), rolling, sliding, STEP, MAGIC)[:1]

    distance = np.array([0.02, 0.1, 0.3])
    run = solve_ivp(rate, (0, 1), [0.0], t_eval=distance / speed, rtol=1e-10, atol=1e-12)
    assert run.y[0] == pytest.approx(math.sin(slip) * (1 - np.exp(-distance / 0.1)), rel=1e-6)


@many
@given(direction=slips, speed=st.floats(0.01, 60.0))
def test_settled_slip_is_the_angle_between_wheel_and_motion_at_any_speed(
    direction: float, speed: float
) -> None:
    rolling, sliding = speed * math.cos(direction), speed * math.sin(direction)
    rate, slip = transient_slip(-math.sin(direction), rolling, sliding, STEP, MAGIC)
    assert rate == pytest.approx(0.0, abs=1e-9)
    assert slip == pytest.approx(math.atan2(-sliding, abs(rolling)), abs=1e-6)


@many
@given(rolling=speeds, sliding=speeds)
def test_transient_slip_never_leaves_its_bounds(rolling: float, sliding: float) -> None:
    assert transient_slip(1.0, rolling, sliding, STEP, MAGIC)[0] <= 1e-12
    assert transient_slip(-1.0, rolling, sliding, STEP, MAGIC)[0] >= -1e-12


def test_standing_tyre_is_a_damped_spring() -> None:
    assert transient_slip(0.03, 0.0, 0.0, STEP, MAGIC) == (0.0, math.asin(0.03))
    rate, slip = transient_slip(0.0, 0.0, 1.0e-3, STEP, MAGIC)
    assert rate == pytest.approx(-1.0e-3 / 0.1)
    assert slip == pytest.approx(0.04 * rate, rel=1e-2)  # the force opposes the motion
