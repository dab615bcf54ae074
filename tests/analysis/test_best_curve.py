"""The recommended curve: the rod beside the clamps, discrete bends between, joined smoothly, and said so."""

from dataclasses import replace

import numpy as np
import pytest
from curve_examples import Known, make_rods
from rod_examples import hold_both

from bench.analysis import ClampedEnds, CurveEstimate, estimate_best, fit_elastica, fit_menger_gp, get_estimator

NOISE_M = 2e-4


@pytest.fixture(scope="module")
def known() -> Known:
    return make_rods(0.005, 10, 12)


@pytest.fixture(scope="module")
def markers(known: Known) -> np.ndarray:
    return known.see(np.random.default_rng(400), NOISE_M)


@pytest.fixture(scope="module")
def ends(known: Known) -> ClampedEnds:
    return hold_both(known, np.random.default_rng(401))


def fit(known: Known, markers: np.ndarray, ends: ClampedEnds | None, fitter=estimate_best) -> CurveEstimate:
    return fitter(markers, known.marker_s_m, known.places_m, NOISE_M, ends=ends, with_vector=True)


def test_beside_the_clamps_it_is_the_rod_and_between_them_the_bends_of_the_markers(
    known: Known, markers: np.ndarray, ends: ClampedEnds
) -> None:
    best, rod = fit(known, markers, ends), fit(known, markers, ends, fit_elastica)
    bends = fit(known, markers, ends, fit_menger_gp)
    near, middle = known.places_m < 0.16, np.abs(known.places_m - 0.75) < 0.2
    assert np.isfinite(best.curvature_per_m).all()
    for field in ("curvature_per_m", "sigma_per_m", "vector_per_m"):
        a, b, c = (getattr(e, field) for e in (best, rod, bends))
        assert np.allclose(a[:, near], b[:, near], rtol=1e-4, atol=1e-6)
        assert np.array_equal(a[:, middle], c[:, middle])
    assert best.method == "menger_gp, elastica beside the clamps"
    assert "in 100.0% of the frames" in best.notes[-1]
    assert np.nanmax(best.residual_m) < 2 * NOISE_M


def test_the_peak_is_right_where_markers_alone_read_it_too_low_and_the_band_holds(
    known: Known, markers: np.ndarray, ends: ClampedEnds
) -> None:
    best, bends = fit(known, markers, ends), fit(known, markers, ends, fit_menger_gp)
    peak = known.curvature_per_m.max(axis=1)
    assert abs((best.curvature_per_m.max(axis=1) / peak).mean() - 1) < 0.01
    assert (bends.curvature_per_m.max(axis=1) / peak).mean() < 0.9
    inside = np.abs(best.curvature_per_m - known.curvature_per_m) <= 2 * best.sigma_per_m
    assert 0.9 <= inside.mean() <= 0.99


def test_where_the_two_join_the_curve_does_not_jump(known: Known, markers: np.ndarray, ends: ClampedEnds) -> None:
    fine = replace(known, places_m=np.linspace(0.0, 1.5, 1501))
    found = fit(fine, markers, ends)
    alone = fit(fine, markers, ends, fit_elastica)
    step = np.abs(np.diff(found.curvature_per_m, axis=1)).max(axis=1)
    assert (step <= 1.05 * np.abs(np.diff(alone.curvature_per_m, axis=1)).max(axis=1)).all()
    # Where the two turn opposite ways, about an inflection, the joined vector is shorter than the joined magnitude.
    assert (np.linalg.norm(found.vector_per_m, axis=2) <= 1.001 * found.curvature_per_m + 1e-3).all()


def test_without_clamps_it_is_the_markers_bends_and_says_why(known: Known, markers: np.ndarray) -> None:
    found, bends = fit(known, markers, None), fit(known, markers, None, fit_menger_gp)
    assert np.array_equal(found.curvature_per_m, bends.curvature_per_m, equal_nan=True)
    assert found.method == "menger_gp"
    assert "the place of the cable's anchor is not known" in found.notes[-1]
    assert "read from the markers alone" in found.notes[-1]


def test_a_cable_that_is_no_rod_is_read_from_its_markers_with_the_alarm(
    known: Known, markers: np.ndarray, ends: ClampedEnds
) -> None:
    lying = replace(ends, up=(0.0, -1.0, 0.0))
    found, bends = fit(known, markers, lying), fit(known, markers, lying, fit_menger_gp)
    assert np.array_equal(found.curvature_per_m, bends.curvature_per_m)
    assert found.method == "menger_gp"
    assert "does not fit this cable" in found.notes[-1]
    assert any("misses the markers" in text for text in found.warnings)


def test_a_frame_that_the_rod_misses_is_read_from_its_markers(
    known: Known, markers: np.ndarray, ends: ClampedEnds
) -> None:
    moved = markers.copy()
    moved[4, 5] += [0.02, 0.0, 0.0]
    found, bends = fit(known, moved, ends), fit(known, moved, ends, fit_menger_gp)
    assert np.array_equal(found.curvature_per_m[4], bends.curvature_per_m[4])
    assert found.curvature_per_m[5].max() > 1.1 * bends.curvature_per_m[5].max()
    assert "in 91.7% of the frames" in found.notes[-1]


def test_auto_is_the_recommended_curve() -> None:
    assert get_estimator("auto") is estimate_best
