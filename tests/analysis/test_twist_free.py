"""Curvature has a sign: the frame does not twist along the cable, does not jump in time, and comes back."""

import numpy as np
import pytest
from cable_examples import bend_cable, make_rotation
from curve_examples import clamp, make_rods
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import fit_menger_gp, resolve_curvature
from bench.analysis.kernels.transport import carry_frames

S_M = np.linspace(0.0, 1.0, 9)
PLACES = np.linspace(0.0, 1.0, 40)


def fit_vector(markers: np.ndarray) -> np.ndarray:
    found = fit_menger_gp(markers.astype(np.float32), S_M, PLACES, 1e-4, with_vector=True).vector_per_m
    assert found is not None
    return found


def test_a_planar_swing_from_one_side_to_the_other_changes_sign() -> None:
    curvature = np.linspace(-2.0, 2.0, 40)
    markers = bend_cable(1 / curvature, S_M)
    turn, _ = make_rotation(np.random.default_rng(301))
    markers = markers @ turn.T
    components = resolve_curvature(fit_vector(markers), markers.astype(np.float32), S_M, PLACES)
    # The plane is some plane to the frame; in it the cable's two components keep one ratio and change their sign.
    axis = components[-1].mean(axis=0) / np.linalg.norm(components[-1].mean(axis=0))
    assert np.allclose(components @ axis, curvature[:, None], atol=5e-3)
    assert np.allclose(components @ [-axis[1], axis[0]], 0.0, atol=1e-3)


@pytest.mark.parametrize("torsion_per_m", [-2.0, 0.0, 3.0])
def test_along_a_helix_the_components_turn_as_fast_as_the_curve_twists(torsion_per_m: float) -> None:
    curvature = 2.0
    squared = curvature**2 + torsion_per_m**2
    angle = np.sqrt(squared) * np.linspace(0.0, 1.0, 60)
    r, pitch = curvature / squared, torsion_per_m / squared
    s = np.linspace(0.0, 1.0, 60)
    markers = np.stack([r * np.cos(angle), r * np.sin(angle), pitch * angle], axis=1)[None].astype(np.float32)
    vector = fit_menger_gp(markers, s, PLACES, 1e-5, with_vector=True).vector_per_m
    assert vector is not None
    components = resolve_curvature(vector, markers, s, PLACES)[0].astype(float)
    inner = slice(2, -2)
    assert np.allclose(np.linalg.norm(components, axis=1)[inner], curvature, rtol=0.01)
    turned = np.unwrap(np.arctan2(components[:, 1], components[:, 0]))
    assert np.polyfit(PLACES[inner], turned[inner], 1)[0] == pytest.approx(torsion_per_m, abs=0.1)


def test_the_frame_does_not_jump_while_the_anchor_swings_and_is_the_same_after_a_cycle() -> None:
    way = np.linspace(0, 2 * np.pi, 200)
    markers = bend_cable(np.full(200, 0.5), S_M)
    leaning = np.array([_tilt(0.8 * np.cos(p), 0.8 * np.sin(p)) for p in way])
    markers = np.einsum("fij,fkj->fki", leaning, markers)
    ends = clamp(np.repeat((leaning @ [1.0, 0.0, 0.0])[:, None], 2, axis=1), 1e-3, 1.0)
    for known in (ends, None):
        components = resolve_curvature(fit_vector(markers), markers.astype(np.float32), S_M, PLACES, ends=known)
        assert np.abs(np.diff(components, axis=0)).max() < 0.1
        assert np.allclose(components[0], components[-1], atol=1e-3)


def test_components_have_the_vectors_length_and_missing_markers_hardly_turn_the_frame() -> None:
    rng = np.random.default_rng(302)
    known = make_rods(0.1, 16).repeat(2)
    markers = known.see(rng, 1e-4)
    found = fit_menger_gp(markers, known.marker_s_m, known.places_m, 1e-4, with_vector=True)
    assert found.vector_per_m is not None
    whole = resolve_curvature(found.vector_per_m, markers, known.marker_s_m, known.places_m)
    assert np.allclose(np.linalg.norm(whole, axis=2), found.curvature_per_m, rtol=0.02, atol=0.02)
    markers[rng.random(markers.shape[:2]) < 0.1] = np.nan
    gapped = resolve_curvature(found.vector_per_m, markers, known.marker_s_m, known.places_m)
    assert np.allclose(whole, gapped, atol=0.1)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_where_nothing_is_known_there_is_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    markers = bend_cable(rng.uniform(0.3, 2, 6), S_M).astype(np.float32)
    vector = fit_vector(markers)
    markers[0], markers[1, 1:] = np.nan, np.nan
    vector[2, :5] = np.nan
    components = resolve_curvature(vector, markers, S_M, PLACES)
    expected = np.ones((6, 40), dtype=bool)
    expected[:2], expected[2, :5] = False, False
    assert np.array_equal(np.isfinite(components).all(axis=2), expected)
    assert resolve_curvature(vector[:0], markers[:0], S_M, PLACES).shape == (0, 40, 2)


def test_plain_python_and_the_compiled_kernel_agree() -> None:
    rng = np.random.default_rng(303)
    markers = rng.normal(size=(4, 5, 3)).astype(np.float32)
    markers[1, 2], markers[2] = np.nan, np.nan
    markers[3, 1] = markers[3, 0]
    tangent = np.full((4, 3), np.nan)
    tangent[0] = [0.0, 1.0, 0.0]
    known = (markers, np.arange(5.0), tangent, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    vector, places = rng.normal(size=(4, 7, 3)).astype(np.float32), np.linspace(0, 4, 7)
    results = []
    for carry in (carry_frames, carry_frames.py_func):
        components = np.zeros((4, 7, 2), dtype=np.float32)
        carry(*known, vector, places, components)
        results.append(components)
    assert np.allclose(*results, rtol=1e-5, atol=1e-6, equal_nan=True)
    assert np.isnan(results[0][2]).all()


def _tilt(y: float, z: float) -> np.ndarray:
    """Return the turn (3, 3) of the x axis by the shortest way towards a vector across it."""
    angle = np.hypot(y, z)
    axis = np.array([0.0, -z, y]) / angle
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
