"""The paper's error analysis: its two figures come out, and what is done to the markers is what was asked for."""

from __future__ import annotations

import numpy as np
import pytest

from bench.analysis import (
    Catenary,
    Circle,
    Condition,
    CurveEstimate,
    fit_spline,
    make_ends,
    make_frames,
    measure_errors,
)

CIRCLE, AROUND_M = Circle(0.4), np.arange(8.0) * (2 * np.pi * 0.4 / 8)
CATENARY, HUNG_M = Catenary(0.5, 1.0), np.linspace(0, 2, 12)


def study(shape, markers, condition=None, n_frames=1):
    condition = condition or Condition()
    places = np.linspace(markers[0], markers[-1], 2001)
    frames = make_frames(shape, markers, condition, n_frames, np.random.default_rng(1))
    curve = fit_spline(frames, markers, places, condition.told_noise_m)
    return measure_errors(curve, shape.curvature(places))


@pytest.mark.parametrize(("shape", "markers", "percent"), [(CIRCLE, AROUND_M, 15.5), (CATENARY, HUNG_M, 12.0)])
def test_the_papers_spline_has_the_papers_errors(shape, markers, percent):
    assert 100 * study(shape, markers).max_radius_error == pytest.approx(percent, abs=0.1)


def test_the_spline_waves_inside_the_circle_by_the_closed_form():
    figures = study(CIRCLE, AROUND_M)
    at_fourth, at_fifth = figures.radius_quantiles_m[1][[round(2000 * 3 / 7), round(2000 * 4 / 7)]]
    assert at_fourth / 0.4 - 1 == pytest.approx(-((AROUND_M[1] / 0.4) ** 2) / 12, rel=0.05)
    assert at_fifth == pytest.approx(at_fourth, rel=1e-3)


def test_noise_and_placement_are_as_large_as_asked_for():
    frames = make_frames(CIRCLE, AROUND_M, Condition(1e-3), 2000, np.random.default_rng(2))
    assert (frames - CIRCLE.place(AROUND_M)).std() == pytest.approx(1e-3, rel=0.03)
    moved = make_frames(CIRCLE, AROUND_M, Condition(placement_m=5e-3), 2000, np.random.default_rng(3))
    off = moved - CIRCLE.place(AROUND_M)
    along = np.einsum("fki,ki->fk", off, CIRCLE.tangent(AROUND_M))
    assert along.std() == pytest.approx(5e-3, rel=0.03)
    assert np.abs(np.linalg.norm(moved, axis=2) - 0.4).max() < 1e-6


def test_as_many_markers_are_hidden_as_asked_for_and_never_the_outermost():
    frames = make_frames(CIRCLE, AROUND_M, Condition(1e-4, n_hidden=2), 300, np.random.default_rng(4))
    hidden = np.isnan(frames[:, :, 0])
    assert (hidden.sum(axis=1) == 2).all()
    assert not hidden[:, [0, -1]].any()
    assert hidden[:, 1:-1].any(axis=0).all()


def test_ends_point_into_the_cable_and_scatter_as_told():
    ends = make_ends(CATENARY, (0.0, 2.0), 0.01, Condition(2e-4), 3000, 5)
    for end, at, sign in ((ends.anchor, 0.0, 1.0), (ends.end, 2.0, -1.0)):
        truth = sign * CATENARY.tangent(np.array(at))
        np.testing.assert_allclose(end.tangent.mean(axis=0), truth, atol=1e-3)
        np.testing.assert_allclose(end.position_m.mean(axis=0), CATENARY.place(np.array(at)), atol=2e-5)
        across = end.tangent @ np.cross(truth, [0.0, 0.0, 1.0])
        assert across.std() == pytest.approx(0.01, rel=0.05)
        assert (end.tangent_sigma_rad == 0.01).all()
    assert ends.length_m == 2.0


def test_ideal_ends_are_exact():
    ends = make_ends(CIRCLE, (0.0, 1.0), 0.01, Condition(), 2, 6)
    np.testing.assert_allclose(ends.anchor.tangent, np.broadcast_to([0.0, 1.0, 0.0], (2, 3)), atol=1e-12)
    assert (ends.anchor.tangent_sigma_rad > 0).all()


def test_an_error_is_measured_as_it_is():
    truth = np.full(50, 2.0)
    value = np.full((4, 50), 2.0 / 1.1, dtype=np.float32)
    value[:, 20:30] = np.nan
    figures = measure_errors(CurveEstimate(value, np.full_like(value, 0.1)), truth)
    assert figures.max_radius_error == pytest.approx(0.1, rel=1e-5)
    assert figures.rms_radius_error == pytest.approx(0.1, rel=1e-5)
    assert figures.peak_bias == pytest.approx(1 / 1.1 - 1, rel=1e-5)
    assert figures.peak_sd == pytest.approx(0, abs=1e-6)
    assert figures.inside_band == 1.0
    assert figures.peak_inside_band == 1.0
    certain = measure_errors(CurveEstimate(value, np.full_like(value, 0.09)), truth)
    assert certain.peak_inside_band == certain.inside_band == 0.0
    assert figures.unknown == pytest.approx(0.2)


def test_the_band_of_the_spline_holds_its_own_scatter():
    assert study(CATENARY, HUNG_M, Condition(2e-4), 300).scatter == pytest.approx(1.0, abs=0.1)


def test_nothing_known_is_no_error_but_unknown():
    nothing = np.full((3, 10), np.nan, dtype=np.float32)
    figures = measure_errors(CurveEstimate(nothing, nothing), np.full(10, 2.0))
    assert figures.unknown == 1.0
    assert np.isnan(figures.max_radius_error)
