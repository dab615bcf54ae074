"""Markers beyond a hidden one are followed from frame to frame, and none is taken for another."""

from __future__ import annotations

import numpy as np
from cable_examples import ARC_LENGTH_M, N_MARKERS, Scene, make_scene, swing_cable
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import SortSettings, follow_beyond_gaps, sort_by_paper

SETTINGS = SortSettings(ARC_LENGTH_M, stretch=0.02, shorten=0.25, tolerance_m=0.004)
N_FRAMES = 200


def sort(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return what the chain finds, and what following adds to it."""
    anchor = np.zeros((len(scene.source), 3))
    chain = sort_by_paper(scene.frames(anchor), SETTINGS).source
    places = np.array(ARC_LENGTH_M)
    return chain, follow_beyond_gaps(scene.points_m, scene.offsets, scene.usable, chain, anchor, places)


def test_a_hidden_marker_does_not_hide_those_beyond_it() -> None:
    cable = swing_cable(N_FRAMES)
    cable[60:120, 3] = np.nan
    scene = make_scene(np.random.default_rng(1), cable, noise_m=1e-4)
    chain, followed = sort(scene)
    assert (chain[60:120, 3:] == -1).all()
    np.testing.assert_array_equal(followed, scene.source)


def test_markers_hidden_at_the_beginning_are_followed_backward() -> None:
    cable = swing_cable(N_FRAMES)
    cable[:50, 2] = np.nan
    scene = make_scene(np.random.default_rng(2), cable)
    np.testing.assert_array_equal(sort(scene)[1], scene.source)


def test_two_markers_that_go_and_come_at_different_times_are_each_found_again() -> None:
    cable = swing_cable(N_FRAMES)
    cable[40:150, 1] = np.nan
    cable[60:90, 5] = np.nan  # comes back while the chain still ends before it
    scene = make_scene(np.random.default_rng(3), cable)
    np.testing.assert_array_equal(sort(scene)[1], scene.source)


def test_a_marker_that_was_never_seen_is_not_invented() -> None:
    cable = swing_cable(N_FRAMES)
    cable[:, -1] = np.nan
    ghosts = np.random.default_rng(4).uniform(1.0, 2.0, (N_FRAMES, 2, 3))
    scene = make_scene(np.random.default_rng(4), cable, ghosts)
    assert (sort(scene)[1][:, -1] == -1).all()


def test_points_that_may_not_be_the_cables_are_not_taken() -> None:
    cable = swing_cable(N_FRAMES)
    cable[60:120, 3] = np.nan
    scene = make_scene(np.random.default_rng(5), cable, swing_cable(N_FRAMES)[:, 3:4] + 0.005)
    usable = scene.usable
    shown = scene.extra_source >= 0
    usable[(scene.offsets[:-1, None] + scene.extra_source)[shown]] = False
    anchor = np.zeros((N_FRAMES, 3))
    chain = sort_by_paper(scene.frames(anchor, usable=usable), SETTINGS).source
    followed = follow_beyond_gaps(scene.points_m, scene.offsets, usable, chain, anchor, np.array(ARC_LENGTH_M))
    np.testing.assert_array_equal(followed, scene.source)


def test_without_an_anchor_the_first_marker_is_followed_too() -> None:
    cable = swing_cable(N_FRAMES)
    scene = make_scene(np.random.default_rng(6), cable)
    known = scene.source.copy()
    known[20:40, 0] = -1
    followed = follow_beyond_gaps(scene.points_m, scene.offsets, scene.usable, known, None, np.array(ARC_LENGTH_M))
    np.testing.assert_array_equal(followed, scene.source)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000), st.floats(0.0, 0.15))
def test_whatever_is_missing_no_marker_is_taken_for_another(seed: int, miss_probability: float) -> None:
    scene = make_scene(np.random.default_rng(seed), swing_cable(N_FRAMES), miss_probability=miss_probability)
    chain, followed = sort(scene)
    wrong = (followed >= 0) & (followed != scene.source)
    wrong_by_chain = (chain >= 0) & (chain != scene.source)
    assert not (wrong & ~wrong_by_chain).any()
    assert (followed >= 0).sum() >= (chain >= 0).sum()
    ever = (chain >= 0).any(axis=0)
    assert ever.sum() >= N_MARKERS - 1
    np.testing.assert_array_equal(followed[:, ever] >= 0, scene.source[:, ever] >= 0)
