"""Smoothing of noisy points: noise estimate, error against the true road, symmetries, closure."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import closure, make_path, without_standstills
from ampc_msgs_config.paths.smoothing import FEWEST, Smoother, chord_parameter, smoothed
from ampc_msgs_config.types import Array
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.supervision.checks import check_path

generated = settings(max_examples=15, deadline=None, derandomize=True)
NOISES = st.sampled_from([0.002, 0.005, 0.01, 0.02, 0.05])
SEEDS = st.integers(0, 2**32 - 1)


def weave(x: Array) -> Array:
    """Return y of a road of 3 m to both sides, with a wavelength of 90 m [m]."""
    return np.asarray(3.0 * np.sin(math.tau * x / 90.0))


def points_of(shape: str, spacing: float) -> Array:
    """Return points of a road, about equally far apart (n, 2) [m]."""
    if shape == "circle":
        angle = np.asarray(np.arange(0.0, 250.0, spacing) / 60.0, dtype=np.float64)
        return 60.0 * np.column_stack((np.sin(angle), 1 - np.cos(angle)))
    x = np.arange(0.0, 250.0, spacing, dtype=np.float64)
    y = weave(x) if shape == "weave" else np.zeros_like(x)
    return np.column_stack((x, y))


def offsets(shape: str, path: Path) -> Array:
    """Return the distance of each sample from the true road (n,) [m]."""
    if shape == "circle":
        return np.asarray(np.hypot(path.x, path.y - 60.0) - 60.0)
    slope = math.tau * 3.0 / 90.0 * np.cos(math.tau * path.x / 90.0)
    road = weave(path.x) if shape == "weave" else 0.0 * path.x
    return np.asarray((path.y - road) / (np.hypot(1.0, slope) if shape == "weave" else 1.0))


def noisy(points: Array, noise: float, seed: int) -> Array:
    """Return points with white noise [m]."""
    return points + noise * np.random.default_rng(seed).standard_normal(points.shape)


@generated
@given(
    shape=st.sampled_from(["straight", "circle", "weave"]),
    spacing=st.sampled_from([0.1, 0.25, 0.5, 1.0, 2.0]),
    noise=NOISES,
    seed=SEEDS,
)
def test_noise_is_estimated_and_the_road_is_met(
    shape: str, spacing: float, noise: float, seed: int
) -> None:
    path = make_path(noisy(points_of(shape, spacing), noise, seed))
    assert path.noise == pytest.approx(noise, rel=0.3)
    error = np.abs(offsets(shape, path))
    assert np.sqrt(np.mean(error**2)) < max(0.6 * noise, 0.003)
    assert error.max() < 3.0 * noise + 0.005
    true = make_path(points_of(shape, 0.5)).curvature
    assert np.abs(path.curvature).max() < np.abs(true).max() + 0.1 * math.sqrt(noise)


@generated
@given(spacing=st.sampled_from([3.0, 5.0]), noise=st.sampled_from([0.01, 0.02, 0.05]), seed=SEEDS)
def test_points_far_apart_stay_near_the_road(spacing: float, noise: float, seed: int) -> None:
    path = make_path(noisy(points_of("weave", spacing), noise, seed))
    assert np.abs(offsets("weave", path)).max() < 4.0 * noise
    assert path.noise < 2.0 * noise


@generated
@given(seed=SEEDS)
def test_mixed_spacing_is_smoothed_as_a_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.concatenate((np.arange(0.0, 80.0, 0.1), np.arange(80.0, 250.0, 2.5)))
    points = np.column_stack((x, weave(x))) + 0.02 * rng.standard_normal((len(x), 2))
    path = make_path(points)
    assert path.noise == pytest.approx(0.02, rel=0.15)
    assert np.abs(offsets("weave", path)).max() < 0.1


@pytest.mark.parametrize("grid", [0.01, 0.05, 0.1])
def test_points_on_a_grid_are_smoothed(grid: float) -> None:
    points = np.round(points_of("weave", 0.5) / grid) * grid
    path = make_path(points)
    assert path.noise == pytest.approx(grid / math.sqrt(12), rel=0.4)
    assert np.abs(offsets("weave", path)).max() < grid / 2


@pytest.mark.parametrize("shape", ["straight", "circle", "weave"])
@pytest.mark.parametrize("spacing", [0.1, 0.5, 1.0, 3.0])
def test_clean_points_give_the_interpolating_spline_bit_for_bit(shape: str, spacing: float) -> None:
    points = points_of(shape, spacing)
    path = make_path(points)
    assert path.noise < 1e-4
    for one, other in zip(path[:6], make_path(points, path_noise=0.0)[:6], strict=True):
        np.testing.assert_array_equal(one, other)


@generated
@given(turn=st.floats(-3.0, 3.0), seed=SEEDS)
def test_turned_mirrored_and_reversed_points_give_the_same_path(turn: float, seed: int) -> None:
    points = noisy(points_of("weave", 1.0), 0.02, seed)
    path = make_path(points)
    cos, sin = math.cos(turn), math.sin(turn)
    turned = make_path(points @ np.array([[cos, sin], [-sin, cos]]) + np.array([3e5, -4e6]))
    assert turned.length == pytest.approx(path.length, abs=1e-5)
    np.testing.assert_allclose(turned.curvature, path.curvature, atol=1e-6)
    np.testing.assert_allclose(turned.heading - path.heading, turn, atol=1e-5)
    mirrored = make_path(points * np.array([1.0, -1.0]))
    np.testing.assert_allclose(mirrored.y, -path.y, atol=1e-9)
    np.testing.assert_allclose(mirrored.curvature, -path.curvature, atol=1e-9)
    back = make_path(points[::-1])
    assert back.noise == pytest.approx(path.noise, rel=0.05)
    assert np.abs(offsets("weave", back)).max() < 0.08


@generated
@given(noise=NOISES, seed=SEEDS)
def test_noisy_lap_is_continuous_where_it_closes(noise: float, seed: int) -> None:
    angle = np.linspace(0.0, math.tau, 300, endpoint=False)
    points = noisy(45.0 * np.column_stack((np.sin(angle), 1 - np.cos(angle))), noise, seed)
    path = make_path(points)
    assert path.closed
    assert math.hypot(path.x[-1] - path.x[0], path.y[-1] - path.y[0]) < 1e-3
    assert path.heading[-1] - path.heading[0] == pytest.approx(math.tau, abs=1e-3)
    assert path.curvature[-1] == pytest.approx(path.curvature[0], abs=1e-3)


def test_given_noise_decides_how_much_is_smoothed() -> None:
    points = noisy(points_of("weave", 5.0), 0.02, 4)
    rough = make_path(points, path_noise=0.0)
    smooth = make_path(points, path_noise=0.02)
    assert smooth.noise == 0.02
    assert np.abs(np.diff(smooth.curvature)).max() < 0.7 * np.abs(np.diff(rough.curvature)).max()
    for bad in (-0.01, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"path_noise = .* must be finite and not negative"):
            make_path(points, path_noise=bad)


@pytest.mark.parametrize("noise", [0.2, 0.3])
def test_estimated_noise_up_to_the_bound_is_smoothed(noise: float) -> None:
    path = make_path(noisy(points_of("weave", 1.0), noise, 7))
    assert path.noise == pytest.approx(noise, rel=0.3)
    assert np.abs(offsets("weave", path)).max() < 3.0 * noise


@pytest.mark.parametrize("width", [1.0, 2.0])
@pytest.mark.parametrize("spacing", [0.5, 1.0, 2.0])
def test_zigzag_is_no_noise(spacing: float, width: float) -> None:
    points = points_of("weave", spacing)
    points[::2, 1] += width
    assert smoothed(points, None, False) is None
    with pytest.raises(ValueError, match=r"path: curvature after .* the range of the steering"):
        check_path(
            points, load_section(ChassisParameters, find("vehicles", "paper"), "chassis"), 0.52
        )
    assert smoothed(points, width / 2, False) is not None  # the user states the noise


def test_short_paths_are_interpolated() -> None:
    for count in range(2, 11):
        points = noisy(points_of("weave", 2.0)[:count], 0.02, count)
        path = make_path(points)
        assert np.isfinite(path.curvature).all()
        assert path.noise == 0.0
        assert np.isfinite(make_path(points, path_noise=0.02).curvature).all()
    assert smoothed(points_of("weave", 0.01)[: 2 * FEWEST], None, False) is None  # 0.4 m


def test_banded_solution_equals_the_dense_one() -> None:
    """The coefficients minimise the sum of squares and the penalty, solved as a dense problem."""
    points = noisy(points_of("weave", 1.0)[:60], 0.02, 1)
    problem = Smoother(chord_parameter(points), points)
    strength = problem.density * (20.0 / math.tau) ** 6
    rows = np.vstack((problem.values.toarray(), math.sqrt(strength) * problem.bends.toarray()))
    right = np.vstack((points, np.zeros((problem.bends.shape[0], 2))))
    dense = np.linalg.lstsq(rows, right, rcond=None)[0]
    np.testing.assert_allclose(problem.fit(20.0).coefficients, dense, atol=1e-7)


def test_cut_off_wavelength_halves_an_undulation() -> None:
    """A straight road with a wave of the cut-off wavelength keeps half of its amplitude."""
    x = np.arange(0.0, 400.0, 1.0)
    points = np.column_stack((x, 0.01 * np.sin(math.tau * x / 20.0)))
    problem = Smoother(chord_parameter(points), points)
    fitted = problem.values @ problem.fit(20.0).coefficients
    assert np.abs(fitted[100:300, 1]).max() == pytest.approx(0.005, rel=0.02)


@pytest.mark.parametrize("beyond", [-0.5, 0.0, 0.0005, 0.01, 0.5])
def test_lap_whose_ends_nearly_meet_is_closed(beyond: float) -> None:
    angle = np.linspace(0.0, math.tau + beyond / 30.0, 200)
    path = make_path(30.0 * np.column_stack((np.sin(angle), 1 - np.cos(angle))))
    assert path.closed
    assert path.length == pytest.approx(math.tau * 30.0, abs=0.01)
    assert math.hypot(path.x[-1] - path.x[0], path.y[-1] - path.y[0]) < 1e-3
    assert path.heading[-1] - path.heading[0] == pytest.approx(math.tau, abs=1e-3)


def test_lap_of_thirteen_points_whose_last_is_the_first_has_no_gap() -> None:
    angle = np.linspace(0.0, math.tau, 13)
    path = make_path(40.0 * np.column_stack((np.sin(angle), 1 - np.cos(angle))))
    assert path.closed
    assert math.hypot(path.x[-1] - path.x[0], path.y[-1] - path.y[0]) < 1e-6
    assert path.heading[-1] - path.heading[0] == pytest.approx(math.tau, abs=1e-6)
    assert path.length == pytest.approx(math.tau * 40.0, rel=1e-3)


def test_open_path_states_why_it_is_not_closed() -> None:
    angle = np.linspace(0.0, math.tau, 200)
    lap = 30.0 * np.column_stack((np.sin(angle), 1 - np.cos(angle)))
    assert closure(lap).closed
    assert "4.73 m apart" in closure(lap[:-5]).reason
    more = 30.0 * np.column_stack((np.sin(angle * 1.05), 1 - np.cos(angle * 1.05)))
    assert closure(more).reason.startswith("its end passes its start by 8.95 m")
    out = np.column_stack((np.arange(50.0), np.zeros(50)))
    assert "directions differ by 180 degrees" in closure(np.concatenate((out, out[::-1]))).reason
    assert "it has 3 points" in closure(out[:3]).reason
    assert not any(closure(each).closed for each in (lap[:-5], more, out))


def test_path_in_steps_of_half_a_millimetre_keeps_its_bend() -> None:
    x = np.arange(0.0, 40.0, 0.0005)
    points = np.column_stack((x, 1.5 * (1 - np.cos(math.pi * x / 40.0))))
    path = make_path(points)
    expected = 1.5 * (1 - np.cos(math.pi * path.x / 40.0))
    assert np.abs(path.y - expected).max() < 0.001


@generated
@given(noise=st.floats(0.005, 0.02), seed=SEEDS)
def test_recorded_standstill_counts_as_one_point(noise: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    road = points_of("weave", 1.0)
    stop = road[100] + noise * rng.standard_normal((200, 2))
    points = np.concatenate((road[:100], stop, road[101:]))
    left = without_standstills(points)
    assert len(road) <= len(left) <= len(road) + 3
    path = make_path(points)
    assert np.abs(offsets("weave", path)).max() < 0.03
    assert np.abs(path.curvature).max() < 0.06


def test_a_point_away_from_a_standstill_is_kept() -> None:
    points = 0.02 * np.random.default_rng(0).standard_normal((40, 2))
    points[1] = 0.5, 0.0
    left = without_standstills(points)
    assert len(left) == 3
    np.testing.assert_array_equal(left[:2], points[:2])
    np.testing.assert_allclose(left[2], points[2:].mean(axis=0))
