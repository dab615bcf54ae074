"""The chain from the cable's other end gives what lies beyond a hidden marker its name."""

import numpy as np
from cable_examples import ARC_LENGTH_M, bend_cable, make_scene
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import SortSettings, fill_from_end, sort_by_paper

LENGTH_M = ARC_LENGTH_M[-1] + 0.06
CABLE = SortSettings(ARC_LENGTH_M, stretch=0.02, shorten=0.25, tolerance_m=0.004, length_m=LENGTH_M)
N_FRAMES = 40
RADIUS_M = 0.45 + 0.15 * np.cos(np.linspace(0, 7, N_FRAMES))
END_M = bend_cable(RADIUS_M, np.array([LENGTH_M]))[:, 0]
ANCHOR_M = np.zeros((N_FRAMES, 3))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_one_hidden_marker_costs_one_marker(seed: int) -> None:
    rng = np.random.default_rng(seed)
    markers = bend_cable(RADIUS_M, np.array(ARC_LENGTH_M))
    hidden = rng.integers(0, len(ARC_LENGTH_M), N_FRAMES)
    markers[np.arange(N_FRAMES), hidden] = np.nan
    scene = make_scene(rng, markers, noise_m=2e-4)
    once = sort_by_paper(scene.frames(ANCHOR_M), CABLE)
    both = fill_from_end(scene.frames(ANCHOR_M, end_m=END_M), once, CABLE)
    assert np.array_equal(both.source, scene.source)
    assert np.array_equal(np.isfinite(both.position_m[:, :, 0]), scene.source >= 0)
    assert np.all(both.confidence >= once.confidence)
    assert np.allclose(both.confidence, 7 / 8)


@given(st.integers(0, 2**32 - 1), st.floats(0, 0.4))
@settings(max_examples=15, deadline=None)
def test_no_point_is_given_to_two_markers(seed: int, miss: float) -> None:
    rng = np.random.default_rng(seed)
    markers = bend_cable(RADIUS_M, np.array(ARC_LENGTH_M))
    scene = make_scene(rng, markers, rng.uniform(-0.3, 0.8, (N_FRAMES, 3, 3)), miss)
    once = sort_by_paper(scene.frames(ANCHOR_M), CABLE)
    both = fill_from_end(scene.frames(ANCHOR_M, end_m=END_M), once, CABLE)
    for row in both.source:
        named = row[row >= 0]
        assert len(set(named.tolist())) == len(named)
    assert np.array_equal(both.source[once.source >= 0], once.source[once.source >= 0])
    assert np.all(both.confidence <= 1)


def test_where_the_end_is_unknown_nothing_changes() -> None:
    rng = np.random.default_rng(1)
    scene = make_scene(rng, bend_cable(RADIUS_M, np.array(ARC_LENGTH_M)), miss_probability=0.2)
    once = sort_by_paper(scene.frames(ANCHOR_M), CABLE)
    unknown = np.full((N_FRAMES, 3), np.nan)
    both = fill_from_end(scene.frames(ANCHOR_M, end_m=unknown), once, CABLE)
    assert np.array_equal(both.source, once.source)
