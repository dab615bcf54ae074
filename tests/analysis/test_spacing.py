"""Markers' places from chords: what was taped wrongly is found, bent cables or not."""

import numpy as np
import pytest

from bench.analysis import measure_marker_places
from bench.errors import AnalysisError

PLACES_M = np.array([0.061, 0.178, 0.3005, 0.42, 0.5425])


def bend(curvature_per_m: np.ndarray, noise_m: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return markers (F, k, 3) and anchors (F, 3) of circular cables, one curvature for each frame."""
    rng = np.random.default_rng(seed)
    angle = curvature_per_m[:, None] * np.concatenate([[0.0], PLACES_M])
    nodes = np.stack([np.sin(angle), 1 - np.cos(angle), 0 * angle], axis=2) / curvature_per_m[:, None, None]
    nodes += rng.normal(scale=noise_m, size=nodes.shape)
    return nodes[:, 1:].astype(np.float32), nodes[:, 0]


@pytest.mark.parametrize("tightest_per_m", [0.5, 8.0])
def test_places_are_found_within_their_standard_deviation(tightest_per_m: float) -> None:
    markers, anchor = bend(np.linspace(0.2, tightest_per_m, 400), 2e-4)
    found = measure_marker_places(markers, np.ones(400, dtype=bool), anchor, 0.0)
    assert np.abs((found.arc_length_m - PLACES_M) / found.sigma_m).max() < 3
    assert found.sigma_m.max() < 5e-4


def test_without_an_anchor_they_count_from_the_first_marker() -> None:
    markers, _ = bend(np.linspace(0.2, 2.0, 100), 2e-4)
    found = measure_marker_places(markers, np.ones(100, dtype=bool), None, 0.05)
    assert found.arc_length_m[0] == 0.05
    assert found.arc_length_m[1:] == pytest.approx(0.05 + PLACES_M[1:] - PLACES_M[0], abs=3e-4)


def test_frames_in_doubt_do_not_enter_and_those_with_hidden_markers_tell_of_the_others() -> None:
    markers, anchor = bend(np.linspace(0.2, 2.0, 100), 0.0)
    usable = np.arange(100) % 2 == 0
    markers[~usable] += np.random.default_rng(1).normal(scale=0.05, size=(50, 5, 3)).astype(np.float32)
    markers[np.arange(0, 100, 2), np.arange(50) % 5] = np.nan
    found = measure_marker_places(markers, usable, anchor, 0.0)
    assert found.arc_length_m == pytest.approx(PLACES_M, abs=1e-4)


def test_too_few_frames_are_refused() -> None:
    markers, anchor = bend(np.linspace(0.2, 2.0, 10), 0.0)
    with pytest.raises(AnalysisError, match="in 10 frames"):
        measure_marker_places(markers, np.ones(10, dtype=bool), anchor, 0.0)


def test_two_places_have_no_bend_between_them() -> None:
    markers, anchor = bend(np.linspace(0.2, 2.0, 100), 0.0)
    with pytest.raises(AnalysisError, match="three places"):
        measure_marker_places(markers[:, :1], np.ones(100, dtype=bool), anchor, 0.0)
