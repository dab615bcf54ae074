"""The paper's spline: its own figures, its exactness, its uncertainty, and silence where it knows nothing."""

import numpy as np
import pytest
from cable_examples import make_rotation
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from bench.analysis import ESTIMATORS, estimate_best, fit_spline, get_estimator, interpolate_curve
from bench.errors import AnalysisError

SEEDS = st.integers(0, 2**32 - 1)
NOISE_M = 2e-4


def circle_markers() -> tuple[np.ndarray, np.ndarray]:
    """Return the paper's circle: r = 0.4 m, 8 markers, and their arc lengths."""
    angle = np.arange(8) * np.pi / 4
    return np.stack([0.4 * np.cos(angle), 0.4 * np.sin(angle), 0 * angle], axis=1), 0.4 * angle


def catenary_markers() -> tuple[np.ndarray, np.ndarray]:
    """Return the paper's catenary: a = 0.5 m, L = 2 m, 12 markers, and their arc lengths."""
    a, s = 0.5, np.linspace(0.0, 2.0, 12)
    return np.stack([a * np.arcsinh((s - 1) / a), np.hypot(a, s - 1), 0 * s], axis=1), s


def test_on_the_papers_circle_the_radius_errs_by_15_5_percent() -> None:
    markers, s = circle_markers()
    found = fit_spline(markers[None], s, np.linspace(0, s[-1], 20_001), NOISE_M)
    error = 100 * np.abs(1 / found.curvature_per_m.astype(float) - 0.4).max() / 0.4
    assert error == pytest.approx(15.5, abs=0.1)


def test_on_the_papers_catenary_the_radius_errs_by_12_percent() -> None:
    markers, s = catenary_markers()
    places = np.linspace(0, 2, 20_001)
    radius = 0.5 + (places - 1) ** 2 / 0.5  # eq. (5) as it must read
    found = fit_spline(markers[None], s, places, NOISE_M)
    error = 100 * np.abs(1 / found.curvature_per_m.astype(float) - radius) / radius
    assert error.max() == pytest.approx(12.0, abs=0.1)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_every_pattern_of_seen_markers_agrees_with_scipys_spline(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = int(rng.integers(4, 12))
    s = np.cumsum(rng.uniform(0.03, 0.2, k))
    position = rng.normal(size=(6, k, 3)).astype(np.float32)
    hidden = rng.random((6, k)) < 0.3
    position[hidden] = np.nan
    places = np.linspace(s[0], s[-1], 37)
    found = fit_spline(position, s, places, NOISE_M)
    for frame in range(6):
        seen = ~hidden[frame]
        if seen.sum() < 4:
            assert np.isnan(found.curvature_per_m[frame]).all()
            continue
        spline = CubicSpline(s[seen], position[frame, seen].astype(float))
        first, second = spline(places, 1), spline(places, 2)
        expected = np.linalg.norm(np.cross(first, second), axis=1) / np.linalg.norm(first, axis=1) ** 3
        inside = (places >= s[seen][0] - 1e-12) & (places <= s[seen][-1] + 1e-12)
        assert np.allclose(found.curvature_per_m[frame, inside], expected[inside], rtol=1e-4, atol=1e-5)
        assert np.isnan(found.curvature_per_m[frame, ~inside]).all()
        assert np.isnan(found.sigma_per_m[frame, ~inside]).all()
        curve = interpolate_curve(position[frame], s, places)
        assert np.allclose(curve[inside], spline(places[inside]), atol=1e-9)
        assert np.isnan(curve[~inside]).all()


@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_moving_the_cable_as_a_whole_changes_no_curvature_and_turns_its_vector(seed: int) -> None:
    rng = np.random.default_rng(seed)
    markers, s = catenary_markers()
    markers = markers + rng.normal(0, 0.01, markers.shape)
    matrix, _ = make_rotation(rng)
    moved = markers @ matrix.T + rng.uniform(-5, 5, 3)
    places = np.linspace(0, 2, 50)
    a = fit_spline(markers[None], s, places, NOISE_M, with_vector=True)
    b = fit_spline(moved[None], s, places, NOISE_M, with_vector=True)
    assert np.allclose(a.curvature_per_m, b.curvature_per_m, rtol=1e-5, atol=1e-6)
    assert np.allclose(a.sigma_per_m, b.sigma_per_m, rtol=1e-5)
    assert a.vector_per_m is not None
    assert b.vector_per_m is not None
    assert np.allclose(a.vector_per_m @ matrix.T, b.vector_per_m, atol=1e-5)
    assert np.allclose(np.linalg.norm(a.vector_per_m, axis=2), a.curvature_per_m, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("noise_m", [2e-4, 1e-3])
def test_the_stated_standard_deviation_is_what_noise_does(noise_m: float) -> None:
    markers, s = circle_markers()
    places = np.linspace(0, s[-1], 40)
    noisy = markers + np.random.default_rng(5).normal(0, noise_m, (8_000, 8, 3))
    found = fit_spline(noisy, s, places, noise_m)
    ratio = found.curvature_per_m.std(axis=0) / found.sigma_per_m.mean(axis=0)
    assert np.all(np.abs(ratio - 1) < 0.05)


def test_a_straight_cable_has_no_curvature_but_an_uncertainty() -> None:
    s = np.linspace(0.1, 1.0, 7)
    found = fit_spline(np.stack([s, 0 * s, 0 * s], axis=1)[None], s, s, NOISE_M)
    assert np.allclose(found.curvature_per_m, 0, atol=1e-6)
    assert np.all(found.sigma_per_m > 0)


def test_fewer_than_four_markers_and_no_frames_give_no_curve() -> None:
    s = np.linspace(0.1, 1.0, 7)
    position = np.full((1, 7, 3), np.nan, dtype=np.float32)
    position[0, :3] = np.arange(9).reshape(3, 3)
    found = fit_spline(position, s, s, NOISE_M, with_vector=True)
    assert np.isnan(found.curvature_per_m).all()
    assert np.isnan(interpolate_curve(position[0], s, s)).all()
    assert fit_spline(position[:0], s, s, NOISE_M).curvature_per_m.shape == (0, 7)


def test_estimators_are_chosen_by_name() -> None:
    assert get_estimator("spline") is ESTIMATORS["spline"]
    assert get_estimator("auto") is estimate_best
    with pytest.raises(AnalysisError, match="no curvature method 'ruler'"):
        get_estimator("ruler")
