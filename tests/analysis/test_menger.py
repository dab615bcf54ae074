"""Discrete bends with a band: exact on circles, honest where markers are dense, silent where nothing is known."""

from dataclasses import replace

import numpy as np
import pytest
from cable_examples import make_rotation
from curve_examples import Known, clamp, make_catenary, make_circle, make_rods
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import ESTIMATORS, CableEnd, ClampedEnds, CurveEstimate, fit_menger_gp, fit_spline, get_estimator
from bench.analysis.curvature.menger_chain import make_chain
from bench.analysis.curvature.menger_prior import Layout, integrate_matern, make_prior
from bench.analysis.curvature.menger_smoothness import Sighting, learn_smoothness, measure_widening
from bench.analysis.kernels.menger import apply_weights, measure_bends

SEEDS = st.integers(0, 2**32 - 1)
NOISE_M = 2e-4
TANGENT_RAD = float(np.deg2rad(0.3))


def fit(known: Known, markers: np.ndarray, ends: ClampedEnds | None = None, noise_m: float = NOISE_M) -> CurveEstimate:
    return fit_menger_gp(markers.astype(np.float32), known.marker_s_m, known.places_m, noise_m, ends=ends)


def radius_error(known: Known, found: CurveEstimate) -> np.ndarray:
    """Return the largest and the root mean square error (F,), in per cent of the radius."""
    error = 100 * np.abs(known.curvature_per_m / found.curvature_per_m.astype(float) - 1)
    return np.array([error.max(axis=1), np.sqrt(np.mean(error**2, axis=1))])


def coverage(known: Known, found: CurveEstimate) -> float:
    inside = np.abs(found.curvature_per_m - known.curvature_per_m) <= 2 * found.sigma_per_m
    return float(inside[np.isfinite(found.sigma_per_m)].mean())


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_circles_are_exact_whatever_the_spacing_and_whatever_is_missing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k, radius = int(rng.integers(4, 12)), float(rng.uniform(0.2, 2.0))
    s = np.cumsum(rng.uniform(0.2, 1.0, k))
    s -= s[0]
    known = make_circle(s * rng.uniform(1.0, 3.0) * radius / np.ptp(s), radius)  # no chord beyond a half circle
    markers = known.markers_m.repeat(5, axis=0)
    markers[rng.random(markers.shape[:2]) < 0.2] = np.nan
    ends = clamp(known.repeat(5).tangents, 1e-3, known.marker_s_m[-1]) if rng.random() < 0.5 else None
    found = fit(known, markers, ends)
    drawn = np.isfinite(found.curvature_per_m)
    assert np.array_equal(drawn.any(axis=1), np.isfinite(markers[:, :, 0]).sum(axis=1) >= 3)
    assert np.allclose(found.curvature_per_m[drawn] * radius, 1, atol=2e-3)
    assert np.array_equal(drawn, np.isfinite(found.sigma_per_m))


def test_on_a_noisy_circle_the_radius_errs_by_a_small_part_of_the_splines_error() -> None:
    rng = np.random.default_rng(101)
    known = make_circle().repeat(200)
    markers = known.see(rng, NOISE_M)
    largest, _ = np.median(radius_error(known, fit(known, markers, known.hold(rng, TANGENT_RAD))), axis=1)
    spline = fit_spline(markers, known.marker_s_m, known.places_m, NOISE_M)
    assert largest < 0.6
    assert np.median(radius_error(known, spline)[0]) > 15


@pytest.mark.parametrize(
    ("noise_m", "held", "most"), [(2e-4, True, 15.5), (1e-3, True, 20), (2e-4, False, 18), (1e-3, False, 35)]
)
def test_on_a_noisy_catenary_the_radius_errs_as_documented(noise_m: float, held: bool, most: float) -> None:
    rng = np.random.default_rng(102)
    known = make_catenary().repeat(200)
    found = fit(known, known.see(rng, noise_m), known.hold(rng, TANGENT_RAD) if held else None, noise_m)
    assert np.median(radius_error(known, found)[0]) < most
    assert 0.9 < coverage(known, found) <= 0.998


@pytest.mark.parametrize("noise_m", [2e-4, 1e-3])
@pytest.mark.parametrize("held", [True, False])
def test_the_band_holds_the_truth_on_circles(noise_m: float, held: bool) -> None:
    rng = np.random.default_rng(103)
    known = make_circle().repeat(200)
    found = fit(known, known.see(rng, noise_m), known.hold(rng, TANGENT_RAD) if held else None, noise_m)
    assert 0.9 <= coverage(known, found) <= 0.998


@pytest.mark.parametrize(("stiffness_nm2", "n_markers"), [(0.1, 11), (0.05, 16), (0.02, 24)])
@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_the_band_holds_the_truth_on_clamped_rods_with_dense_markers(
    stiffness_nm2: float, n_markers: int, missing: float
) -> None:
    rng = np.random.default_rng(104)
    known = make_rods(stiffness_nm2, n_markers).repeat(8)
    markers = known.see(rng, NOISE_M)
    markers[rng.random(markers.shape[:2]) < missing] = np.nan
    found = fit(known, markers, known.hold(rng, TANGENT_RAD))
    assert 0.9 <= coverage(known, found) <= 0.998
    assert "Learnt from the frames" in found.notes[0]
    assert found.warnings == []


@pytest.mark.parametrize(("stiffness_nm2", "n_markers"), [(0.02, 10), (0.005, 10), (0.002, 20)])
def test_the_band_widens_beside_clamps_where_markers_are_sparse(stiffness_nm2: float, n_markers: int) -> None:
    rng = np.random.default_rng(115)
    known = make_rods(stiffness_nm2, n_markers).repeat(8)
    found = fit(known, known.see(rng, NOISE_M), known.hold(rng, TANGENT_RAD))
    assert 0.9 <= coverage(known, found) <= 0.998


@pytest.mark.parametrize(("stiffness_nm2", "n_markers"), [(0.3, 10), (0.05, 10), (0.02, 10), (0.01, 15)])
def test_the_band_holds_the_truth_up_to_ends_whose_direction_is_unknown(stiffness_nm2: float, n_markers: int) -> None:
    known = make_rods(stiffness_nm2, n_markers).repeat(8)
    found = fit(known, known.see(np.random.default_rng(118), NOISE_M))
    beside = (known.places_m < known.marker_s_m[1]) | (known.places_m > known.marker_s_m[-2])
    inside = np.abs(found.curvature_per_m - known.curvature_per_m) <= 2 * found.sigma_per_m
    assert inside[:, beside].mean() > 0.9
    held = fit(known, known.markers_m, clamp(known.tangents, TANGENT_RAD, known.marker_s_m[-1]))
    middle = len(known.places_m) // 2
    assert held.sigma_per_m[0, 0] < found.sigma_per_m[0, 0]
    assert found.sigma_per_m[0, middle] < 0.5 * found.sigma_per_m[0, 0]


def test_a_cable_that_is_alike_all_along_has_no_wider_band_anywhere() -> None:
    rng = np.random.default_rng(116)
    s, frames = np.linspace(0, 1.5, 16), 400
    layout = Layout(s, s[[0, -1]], np.full(18, NOISE_M**2))
    chain = make_chain(layout, np.ones(16, dtype=bool), np.array([False, False]))
    prior = make_prior(layout, s[:0], 2.0, 0.5)
    covariance = chain.difference @ prior.node_covariance @ chain.difference.T + chain.noise
    bends = 3.0 + rng.multivariate_normal(np.zeros(14), covariance, frames)
    sighting = Sighting(chain, bends[:, :, None] * [0.0, 0.0, 1.0])
    smoothness = learn_smoothness([sighting], layout)
    assert smoothness.amplitude_per_m == pytest.approx(2.0, rel=0.35)
    assert smoothness.length_m == pytest.approx(0.5, rel=0.25)
    assert np.all(measure_widening(sighting, layout, smoothness).factor < 1.2)


def test_markers_too_far_apart_for_the_clamps_are_told() -> None:
    known = make_rods(0.005, 8).repeat(8)
    found = fit(known, known.see(np.random.default_rng(105), NOISE_M))
    assert "may be read too low" in found.warnings[0]
    assert found.curvature_per_m.max() < 0.7 * known.curvature_per_m.max()


@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_moving_the_cable_as_a_whole_changes_no_curvature_and_turns_its_vector(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = make_catenary().repeat(10)
    markers, ends = known.see(rng, 5e-3).astype(float), known.hold(rng, TANGENT_RAD)
    matrix, _ = make_rotation(rng)
    assert ends.anchor is not None
    assert ends.end is not None
    turned = [replace(end, tangent=end.tangent @ matrix.T) for end in (ends.anchor, ends.end)]
    moved = markers @ matrix.T + rng.uniform(-2, 2, 3)
    a = fit_menger_gp(markers.astype(np.float32), known.marker_s_m, known.places_m, 5e-3, ends=ends, with_vector=True)
    b = fit_menger_gp(
        moved.astype(np.float32),
        known.marker_s_m,
        known.places_m,
        5e-3,
        ends=replace(ends, anchor=turned[0], end=turned[1]),
        with_vector=True,
    )
    assert np.allclose(a.curvature_per_m, b.curvature_per_m, atol=1e-4)
    assert np.allclose(a.sigma_per_m, b.sigma_per_m, rtol=1e-4)
    assert a.vector_per_m is not None
    assert b.vector_per_m is not None
    assert np.allclose(a.vector_per_m @ matrix.T, b.vector_per_m, atol=1e-4)
    assert np.allclose(np.linalg.norm(a.vector_per_m, axis=2), a.curvature_per_m, rtol=1e-4)


@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_nominal_arc_lengths_may_be_offset_or_scaled_and_a_circle_stays_a_circle(seed: int) -> None:
    """Offset: nothing changes. Scale: no weight's shape changes, only what noise means, so a circle stays exact."""
    rng = np.random.default_rng(seed)
    known = make_catenary().repeat(5)
    markers, offset = known.see(rng, NOISE_M), float(rng.uniform(0, 3))
    a = fit(known, markers)
    b = fit_menger_gp(markers, known.marker_s_m + offset, known.places_m + offset, NOISE_M)
    assert np.allclose(a.curvature_per_m, b.curvature_per_m, atol=1e-5)
    assert np.allclose(a.sigma_per_m, b.sigma_per_m, rtol=1e-4)
    circle, scale = make_circle(), float(rng.uniform(0.7, 1.4))
    c = fit_menger_gp(circle.markers_m.astype(np.float32), circle.marker_s_m * scale, circle.places_m * scale, NOISE_M)
    assert np.allclose(c.curvature_per_m, 2.5, rtol=1e-4)


def test_a_cable_twice_as_large_has_half_the_curvature_and_half_the_band() -> None:
    known = make_catenary().repeat(20)
    markers = known.see(np.random.default_rng(106), NOISE_M)
    a = fit(known, markers)
    b = fit_menger_gp(2 * markers, 2 * known.marker_s_m, 2 * known.places_m, 2 * NOISE_M)
    assert np.allclose(a.curvature_per_m, 2 * b.curvature_per_m, rtol=1e-4)
    assert np.allclose(a.sigma_per_m, 2 * b.sigma_per_m, rtol=1e-4)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_the_band_grows_with_the_noise(seed: int) -> None:
    known = make_catenary().repeat(50)
    clean = known.markers_m
    scatter = np.random.default_rng(seed).normal(0, 1, clean.shape)
    bands = [
        float(np.median(fit(known, clean + noise_m * scatter, noise_m=noise_m).sigma_per_m))
        for noise_m in (1e-4, 2e-4, 5e-4, 1e-3)
    ]
    growth = np.diff(np.log(bands)) / np.diff(np.log([1e-4, 2e-4, 5e-4, 1e-3]))
    assert np.all(growth > 0.2)  # a smooth cable is smoothed the more, the noisier it is
    assert np.all(growth < 1.05)


def test_a_gap_widens_the_band_and_nothing_is_said_beyond_the_seen_markers() -> None:
    known = make_catenary().repeat(100)
    markers = known.see(np.random.default_rng(107), NOISE_M)
    gapped = markers.copy()
    gapped[::2, 4:7] = np.nan
    gapped[1::2, :2] = np.nan
    whole, found = fit(known, markers), fit(known, gapped)
    middle = np.abs(known.places_m - 1.0) < 0.05
    assert np.all(found.sigma_per_m[0, middle] > 2 * whole.sigma_per_m[0, middle])
    before = known.places_m < known.marker_s_m[2]
    assert np.isnan(found.curvature_per_m[1::2, before]).all()
    assert np.isfinite(found.curvature_per_m[1::2, ~before]).all()
    assert coverage(known, found) > 0.9


def test_frames_without_three_nodes_have_no_curve_and_no_frames_give_none() -> None:
    known = make_catenary()
    markers = np.full((3, 12, 3), np.nan)
    markers[1, :2] = known.markers_m[0, :2]
    markers[2, [0, 4, 9]] = known.markers_m[0, [0, 4, 9]]
    found = fit(known, markers)
    assert np.isfinite(found.curvature_per_m).any(axis=1).tolist() == [False, False, True]
    assert fit(known, markers[:0]).curvature_per_m.shape == (0, 100)
    nothing = fit(known, markers[:1])
    assert np.isnan(nothing.curvature_per_m).all()
    assert nothing.notes == nothing.warnings == []


def test_two_markers_at_one_place_have_no_curve_and_spoil_no_other_frame() -> None:
    known = make_catenary().repeat(30)
    markers = known.see(np.random.default_rng(108), NOISE_M)
    doubled = markers.copy()
    doubled[7, 3] = doubled[7, 4]
    found, usual = fit(known, doubled), fit(known, markers)
    assert np.isnan(found.curvature_per_m[7]).all()
    assert np.isnan(found.sigma_per_m[7]).all()
    rest = np.arange(30) != 7
    assert np.allclose(found.curvature_per_m[rest], usual.curvature_per_m[rest], atol=0.05)


def test_wrongly_sorted_frames_do_not_roughen_the_others() -> None:
    known = make_catenary().repeat(200)
    markers = known.see(np.random.default_rng(109), NOISE_M)
    wrong = markers.copy()
    wrong[::20, [5, 8]] = wrong[::20, [8, 5]]
    rest = np.arange(200) % 20 != 0
    a, b = fit(known, markers), fit(known, wrong)
    assert a.residual_m is not None
    assert b.residual_m is not None
    assert 0.1 * NOISE_M < np.median(a.residual_m) < NOISE_M
    assert a.residual_m.max() < 3 * NOISE_M
    assert b.residual_m[~rest].min() > 20 * NOISE_M
    assert np.median(b.sigma_per_m[rest]) < 1.5 * np.median(a.sigma_per_m[rest])


def test_markers_that_go_to_and_fro_on_a_line_are_no_straight_cable() -> None:
    known = make_catenary().repeat(40)
    markers = known.see(np.random.default_rng(114), NOISE_M)
    to_and_fro = np.array([0, 0.11, 0.01, 0.12, 0.02, 0.13, 0.03, 0.14, 0.04, 0.15, 0.05, 0.16])
    markers[7] = np.stack([to_and_fro, 1e-3 * np.arange(12.0) ** 2, 0 * to_and_fro], axis=1)
    found = fit(known, markers)
    assert found.curvature_per_m[7].max() > 5 * np.delete(found.curvature_per_m, 7, axis=0).max()


def test_a_straight_cable_reads_no_more_than_noise() -> None:
    s = np.linspace(0.1, 1.0, 7)
    known = Known(np.stack([s, 0 * s, 0 * s], axis=1)[None], s, s, np.zeros((1, 7)), np.zeros((1, 2, 3))).repeat(300)
    found = fit(known, known.see(np.random.default_rng(110), NOISE_M))
    assert coverage(known, found) > 0.85
    exact = fit(known, known.markers_m)
    assert np.allclose(exact.curvature_per_m, 0, atol=1e-4)
    assert np.all(exact.sigma_per_m > 0)


def test_a_clamps_place_is_one_more_node_and_its_tangent_reaches_beyond_the_markers() -> None:
    rng = np.random.default_rng(111)
    whole = make_circle().repeat(100)
    inner = slice(1, -1)
    markers, s = whole.see(rng, NOISE_M), whole.marker_s_m
    held = whole.hold(rng, TANGENT_RAD)
    sigma = np.full(100, 1e-3)
    placed = CableEnd(whole.markers_m[:, 0], sigma, np.full((100, 3), np.nan), np.full(100, np.nan))
    for anchor, from_m in ((None, s[1]), (held.anchor, 0.0), (placed, 0.0)):
        ends = ClampedEnds(anchor, None, float(s[-1]))
        found = fit_menger_gp(markers[:, inner], s[inner], whole.places_m, NOISE_M, ends=ends)
        drawn = (whole.places_m >= from_m) & (whole.places_m <= s[-2])
        assert np.array_equal(np.isfinite(found.curvature_per_m[0]), drawn)
        assert np.allclose(found.curvature_per_m[:, drawn], 2.5, rtol=0.01)
    both = fit_menger_gp(markers[:, inner], s[inner], whole.places_m, NOISE_M, ends=held)
    assert np.isfinite(both.curvature_per_m).all()
    assert np.allclose(both.curvature_per_m, 2.5, rtol=0.005)


def test_an_unsure_clamp_is_weighed_away() -> None:
    rng = np.random.default_rng(112)
    known = make_circle().repeat(200)
    markers, tilted = known.see(rng, NOISE_M), known.tangents.copy()
    tilted[:, 0] += 0.1 * np.array([0.0, 1.0, 0.0])
    sure, unsure = (fit(known, markers, clamp(tilted, sd, known.marker_s_m[-1])) for sd in (TANGENT_RAD, 0.1))
    assert np.median(radius_error(known, unsure)[0]) < 1
    assert np.median(radius_error(known, sure)[0]) > 2


def test_plain_python_and_the_compiled_kernels_agree() -> None:
    rng = np.random.default_rng(113)
    nodes = rng.normal(size=(3, 5, 3)).astype(np.float32)
    nodes[2, 2] = nodes[2, 1]
    tangent = rng.normal(size=(3, 2, 3)).astype(np.float32)
    known = (nodes, tangent, np.arange(3), np.array([0, 1, 2, 4]), np.array([True, True]), np.array([0.1, 0.0]))
    made_of = rng.normal(size=(4, 6)).astype(np.float32), rng.random(6).astype(np.float32), rng.normal(size=(4, 4))
    results = []
    for bends, curve in ((measure_bends, apply_weights), (measure_bends.py_func, apply_weights.py_func)):
        measured, made = np.zeros((3, 4, 3)), [np.zeros((3, 6, 3)[:n], dtype=np.float32) for n in (2, 2, 1, 3)]
        bends(*known, np.array([0.5, 1.0]), measured)
        curve(*known, np.array([0.5, 1.0]), *made_of, *made)
        results.append([measured, *made])
    for compiled, plain in zip(*results, strict=True):
        assert np.allclose(compiled, plain, rtol=1e-5, atol=1e-5, equal_nan=True)
        assert np.isnan(compiled[2]).any()
        assert np.isfinite(compiled[:2]).all()


def test_the_integrals_of_the_process_are_each_others_derivatives() -> None:
    x, step = np.linspace(-2, 2, 81), 1e-4
    r = np.sqrt(5) * np.abs(x) / 0.7
    chain = [(1 + r + r**2 / 3) * np.exp(-r), *(integrate_matern(x, 0.7, times) for times in (1, 2, 3, 4))]
    for times in (1, 2, 3, 4):
        slope = (integrate_matern(x + step, 0.7, times) - integrate_matern(x - step, 0.7, times)) / (2 * step)
        assert np.allclose(slope, chain[times - 1], atol=1e-5)


def test_the_estimator_is_chosen_by_name() -> None:
    assert get_estimator("menger_gp") is ESTIMATORS["menger_gp"] is fit_menger_gp
