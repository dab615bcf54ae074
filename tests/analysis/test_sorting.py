"""The paper's chain: exact where nothing is missing, silent where it cannot know, one point for one marker."""

import numpy as np
import pytest
from cable_examples import ARC_LENGTH_M, N_MARKERS, SPACING_M, Scene, bend_cable, make_rotation, make_scene, swing_cable
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import SORTERS, SortSettings, gather_positions, get_sorter, make_gates, sort_by_paper
from bench.errors import AnalysisError

SEEDS = st.integers(0, 2**32 - 1)
CABLE = SortSettings(ARC_LENGTH_M, stretch=0.02, shorten=0.25, tolerance_m=0.004)
MODERATE = settings(max_examples=25, deadline=None)


@given(SEEDS)
@MODERATE
def test_without_misses_and_ghosts_every_frame_is_exact(seed: int) -> None:
    scene = make_scene(np.random.default_rng(seed), swing_cable(40), noise_m=2e-4)
    found = sort_by_paper(scene.frames(np.zeros((40, 3))), CABLE)
    assert np.array_equal(found.source, scene.source)
    assert np.all(found.confidence == 1.0)


@given(SEEDS, st.floats(0.0, 0.3), st.integers(0, 4))
@MODERATE
def test_a_point_is_used_once_and_the_chain_has_no_hole(seed: int, miss: float, n_ghosts: int) -> None:
    rng = np.random.default_rng(seed)
    scene = make_scene(rng, swing_cable(30), rng.uniform(-0.3, 0.8, (30, n_ghosts, 3)), miss)
    found = sort_by_paper(scene.frames(np.zeros((30, 3))), CABLE)
    n_points = np.diff(scene.offsets)
    for row, count in zip(found.source, n_points, strict=True):
        named = row[row >= 0]
        assert len(set(named.tolist())) == len(named)
        assert np.all(named < count)
        assert np.all(row[len(named) :] == -1)
    assert np.all((found.confidence >= 0) & (found.confidence <= 1))


@given(SEEDS)
@MODERATE
def test_every_distance_of_a_chain_lies_in_its_gate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = make_scene(rng, swing_cable(30), rng.uniform(-0.3, 0.8, (30, 3, 3)), 0.1)
    found = sort_by_paper(scene.frames(np.zeros((30, 3))), CABLE)
    gates = make_gates(CABLE)
    chain = np.concatenate([np.zeros((30, 1, 3)), found.position_m.astype(float)], axis=1)
    distance = np.linalg.norm(np.diff(chain, axis=1), axis=2)
    seen = np.isfinite(distance)
    assert np.all((distance >= gates.low_m - 1e-6)[seen])
    assert np.all((distance <= gates.high_m + 1e-6)[seen])


@given(SEEDS)
@MODERATE
def test_moving_the_whole_scene_changes_no_label(seed: int) -> None:
    rng = np.random.default_rng(seed)
    markers, ghosts = swing_cable(20), rng.uniform(-0.3, 0.8, (20, 2, 3))
    matrix, _ = make_rotation(rng)
    shift = rng.uniform(-3, 3, 3)
    scene = make_scene(np.random.default_rng(seed), markers, ghosts, 0.05)
    moved = make_scene(np.random.default_rng(seed), markers @ matrix.T + shift, ghosts @ matrix.T + shift, 0.05)
    a = sort_by_paper(scene.frames(np.zeros((20, 3))), CABLE)
    b = sort_by_paper(moved.frames(np.broadcast_to(shift, (20, 3))), CABLE)
    assert np.array_equal(a.source, b.source)


def test_the_chain_ends_at_a_hidden_marker_as_in_the_paper() -> None:
    markers = swing_cable(10)
    markers[:, 4] = np.nan
    scene = make_scene(np.random.default_rng(0), markers)
    found = sort_by_paper(scene.frames(np.zeros((10, 3))), CABLE)
    assert np.array_equal(found.source[:, :4], scene.source[:, :4])
    assert np.all(found.source[:, 4:] == -1)
    assert np.isnan(found.position_m[:, 4:]).all()
    assert found.confidence == pytest.approx(4 / N_MARKERS)


def test_of_two_points_in_the_gate_the_one_nearest_to_the_known_distance_is_taken() -> None:
    markers = np.array([[[SPACING_M, 0, 0], [2 * SPACING_M, 0, 0]]])
    ghost = np.array([[[0, 0.8 * SPACING_M, 0]]])
    scene = make_scene(np.random.default_rng(1), markers, ghost)
    found = sort_by_paper(scene.frames(np.zeros((1, 3))), SortSettings(ARC_LENGTH_M[:2], tolerance_m=0.004))
    assert np.array_equal(found.source, scene.source)
    assert found.confidence[0] == pytest.approx(0.75)  # one ambiguous step of two


def test_points_that_may_not_be_used_and_frames_without_anchor_stay_unsorted() -> None:
    scene = make_scene(np.random.default_rng(2), swing_cable(6))
    anchor = np.zeros((6, 3))
    anchor[2] = np.nan
    nothing = sort_by_paper(scene.frames(anchor, usable=~scene.usable), CABLE)
    assert np.all(nothing.source == -1)
    assert np.all(nothing.confidence == 0)
    found = sort_by_paper(scene.frames(anchor), CABLE)
    assert np.all(found.source[2] == -1)
    assert np.array_equal(np.delete(found.source, 2, axis=0), np.delete(scene.source, 2, axis=0))


def test_frames_without_points_and_recordings_without_frames_are_sorted_too() -> None:
    none = np.zeros((0, 3), dtype=np.float32)
    source = np.full((0, N_MARKERS), -1, dtype=np.int16)
    unseen = Scene(none, np.zeros(4, dtype=np.int64), source, source)
    empty = sort_by_paper(Scene(none, np.zeros(1, dtype=np.int64), source, source).frames(np.zeros((0, 3))), CABLE)
    assert empty.source.shape == (0, N_MARKERS)
    blind = sort_by_paper(unseen.frames(np.zeros((3, 3))), CABLE)
    assert np.all(blind.source == -1)
    free = sort_by_paper(unseen.frames(None), CABLE)
    assert np.all(free.source == -1)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_without_an_anchor_unequal_spacings_tell_the_chain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.array([0.05, 0.12, 0.23, 0.31, 0.47, 0.60])
    markers = bend_cable(np.full(15, 0.8), places)
    scene = make_scene(rng, markers, rng.uniform(1.5, 2.5, (15, 2, 3)), noise_m=1e-4)
    cable = SortSettings(tuple(places.tolist()), 0.02, 0.25, 0.004)
    found = sort_by_paper(scene.frames(None), cable)
    assert np.array_equal(found.source, scene.source)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_equal_spacings_without_an_anchor_give_one_direction_to_all_frames(seed: int) -> None:
    markers = swing_cable(20)
    markers[7, 3] = np.nan
    scene = make_scene(np.random.default_rng(seed), markers, noise_m=1e-4)
    found = sort_by_paper(scene.frames(None), CABLE).source
    assert np.all(found[7] == -1)
    others = np.delete(np.arange(20), 7)
    assert np.array_equal(found[others], scene.source[others]) or np.array_equal(
        found[others], scene.source[others, ::-1]
    )


def test_positions_are_those_of_the_named_points() -> None:
    scene = make_scene(np.random.default_rng(3), swing_cable(9), miss_probability=0.2)
    position = gather_positions(scene.points_m, scene.offsets, scene.source)
    seen = scene.source >= 0
    assert np.allclose(position[seen], swing_cable(9)[seen], atol=1e-6)
    assert np.isnan(position[~seen]).all()


def test_more_points_than_an_index_can_name_are_refused() -> None:
    points = np.zeros((40_000, 3), dtype=np.float32)
    with pytest.raises(AnalysisError, match="40000 points"):
        Scene(points, np.array([0, 40_000]), np.zeros((1, 0)), np.zeros((1, 0))).frames(np.zeros((1, 3)))


def test_sorters_are_chosen_by_name() -> None:
    assert get_sorter("paper") is SORTERS["paper"]
    assert get_sorter("auto") not in SORTERS.values()
    with pytest.raises(AnalysisError, match="no sorting method 'guess'"):
        get_sorter("guess")
