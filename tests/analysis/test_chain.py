"""The chain search: exact on clean scenes, through hidden markers and ghosts, and never sure where it cannot be."""

from dataclasses import fields, replace

import numpy as np
import pytest
from cable_examples import ARC_LENGTH_M, N_MARKERS, Floats, Scene, bend_cable, make_rotation, make_scene, swing_cable
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import (
    MarkerReason,
    PointFrames,
    SortSettings,
    calibrate_spacing,
    get_sorter,
    sort_by_chain,
    sort_by_paper,
)
from bench.analysis.sorting.chain_costs import ChainPrior, make_costs
from bench.errors import TooFewMarkersError

SEEDS = st.integers(0, 2**32 - 1)
CABLE = SortSettings(ARC_LENGTH_M, stretch=0.02, shorten=0.25, tolerance_m=0.004, length_m=ARC_LENGTH_M[-1] + 0.05)
UNEVEN_M = (0.05, 0.12, 0.23, 0.31, 0.47, 0.60)
UNEVEN = SortSettings(UNEVEN_M, stretch=0.02, shorten=0.25, tolerance_m=0.004, length_m=0.66)
MODERATE = settings(max_examples=6, deadline=None)


def anchor(n_frames: int) -> Floats:
    return np.zeros((n_frames, 3))


def uneven_cable(n_frames: int) -> Floats:
    return bend_cable(0.5 + 0.2 * np.cos(np.linspace(0, 6, n_frames)), np.array(UNEVEN_M))


@given(SEEDS)
@MODERATE
def test_without_misses_and_ghosts_every_frame_is_exact_and_sure(seed: int) -> None:
    scene = make_scene(np.random.default_rng(seed), swing_cable(40), noise_m=2e-4)
    found = sort_by_chain(scene.frames(anchor(40)), CABLE)
    assert np.array_equal(found.source, scene.source)
    assert found.confidence.min() > 0.95
    assert np.all(found.reason == MarkerReason.FOUND)


def test_hidden_markers_end_the_papers_chain_and_not_this_one() -> None:
    rng = np.random.default_rng(7)
    scene = make_scene(rng, swing_cable(300), rng.uniform(-0.3, 0.8, (300, 2, 3)), 0.08, 2e-4)
    frames = scene.frames(anchor(300))
    exact = [float((sort(frames, CABLE).source == scene.source).all(axis=1).mean()) for sort in SORT_BOTH]
    assert exact[0] > 0.97
    assert exact[1] < 0.6


SORT_BOTH = (sort_by_chain, sort_by_paper)


@given(SEEDS, st.floats(0.0, 0.3), st.integers(0, 4))
@MODERATE
def test_a_point_is_used_once_and_every_hidden_marker_has_a_reason(seed: int, miss: float, n_ghosts: int) -> None:
    rng = np.random.default_rng(seed)
    scene = make_scene(rng, swing_cable(30), rng.uniform(-0.3, 0.8, (30, n_ghosts, 3)), miss)
    found = sort_by_chain(scene.frames(anchor(30)), CABLE)
    for row, count in zip(found.source, np.diff(scene.offsets), strict=True):
        named = row[row >= 0]
        assert len(set(named.tolist())) == len(named)
        assert np.all(named < count)
    assert np.all(found.reason[found.source < 0] != MarkerReason.FOUND)
    assert np.all(found.marker_confidence[found.source < 0] == 0)
    assert np.all((found.marker_confidence >= 0) & (found.marker_confidence <= 1))


@given(SEEDS)
@MODERATE
def test_moving_the_whole_scene_changes_no_label(seed: int) -> None:
    rng = np.random.default_rng(seed)
    markers, ghosts = swing_cable(20), rng.uniform(-0.3, 0.8, (20, 2, 3))
    matrix, _ = make_rotation(rng)
    shift = rng.uniform(-1, 1, 3)
    scene = make_scene(np.random.default_rng(seed), markers, ghosts, 0.05)
    moved = make_scene(np.random.default_rng(seed), markers @ matrix.T + shift, ghosts @ matrix.T + shift, 0.05)
    a = sort_by_chain(scene.frames(anchor(20)), CABLE)
    b = sort_by_chain(moved.frames(np.broadcast_to(shift, (20, 3))), CABLE)
    assert np.array_equal(a.source, b.source)


@given(SEEDS)
@MODERATE
def test_the_order_of_the_points_changes_no_marker(seed: int) -> None:
    rng = np.random.default_rng(seed)
    markers, ghosts = swing_cable(20), rng.uniform(-0.3, 0.8, (20, 2, 3))
    markers[rng.random(markers.shape[:2]) < 0.1] = np.nan
    a, b = (make_scene(np.random.default_rng(other), markers, ghosts) for other in (1, 2))
    found = [sort_by_chain(scene.frames(anchor(20)), CABLE).position_m for scene in (a, b)]
    assert np.array_equal(found[0], found[1], equal_nan=True)


@given(SEEDS)
@MODERATE
def test_a_cable_numbered_from_its_other_end_is_sorted_the_other_way_round(seed: int) -> None:
    rng = np.random.default_rng(seed)
    whole = bend_cable(rng.uniform(0.4, 0.9, 20), np.array([0.0, *UNEVEN_M, UNEVEN.length_m]))
    scene = make_scene(rng, whole[:, 1:-1], rng.uniform(-0.3, 0.8, (20, 1, 3)), 0.05)
    mirrored = replace(UNEVEN, arc_length_m=tuple(UNEVEN.length_m - s for s in reversed(UNEVEN_M)))
    start, end = whole[:, 0], whole[:, -1]
    forward = sort_by_chain(scene.frames(start, end_m=end), UNEVEN)
    backward = sort_by_chain(scene.frames(end, end_m=start), mirrored)
    agree = (forward.source == backward.source[:, ::-1]).all(axis=1)
    doubtful = (forward.reason == MarkerReason.AMBIGUOUS).any(axis=1)
    assert np.all(agree | doubtful)
    assert agree.mean() >= 0.9


def test_the_other_end_finds_markers_beyond_a_gap_and_forgives_a_wrong_calibration() -> None:
    whole = bend_cable(0.5 + 0.1 * np.cos(np.linspace(0, 6, 60)), np.array([*ARC_LENGTH_M, CABLE.length_m]))
    markers, end = whole[:, :-1].copy(), whole[:, -1]
    markers[:, 5] = np.nan
    scene = make_scene(np.random.default_rng(3), markers, noise_m=2e-4)
    for error_m in (0.0, 0.005, 0.02, 0.1):
        found = sort_by_chain(scene.frames(anchor(60), end_m=end + error_m, end_sigma_m=np.full(60, 1e-3)), CABLE)
        assert np.array_equal(found.source, scene.source)
        assert np.all(found.reason[:, 5] == MarkerReason.HIDDEN)


def test_a_ghost_beside_a_marker_makes_that_marker_ambiguous_and_no_other() -> None:
    markers = swing_cable(30)
    ghost = markers[:, 4:5] + np.array([0.0, 0.0, 0.002])
    scene = make_scene(np.random.default_rng(5), markers, ghost)
    found = sort_by_chain(scene.frames(anchor(30)), CABLE)
    assert np.all(found.reason[:, 4] == MarkerReason.AMBIGUOUS)
    assert np.all(found.marker_confidence[:, 4] < 0.95)
    others = np.delete(np.arange(N_MARKERS), 4)
    assert np.array_equal(found.source[:, others], scene.source[:, others])
    assert np.all(found.reason[:, [0, 1, 7]] == MarkerReason.FOUND)


def test_frames_without_an_anchor_are_sorted_by_unequal_spacings_or_by_the_other_end() -> None:
    unknown = np.full((40, 3), np.nan)
    scene = make_scene(np.random.default_rng(6), uneven_cable(40), noise_m=1e-4)
    assert np.array_equal(sort_by_chain(scene.frames(unknown), UNEVEN).source, scene.source)
    assert np.array_equal(sort_by_chain(scene.frames(None), UNEVEN).source, scene.source)
    alike = make_scene(np.random.default_rng(6), swing_cable(40), noise_m=1e-4)
    lost = sort_by_chain(alike.frames(unknown), CABLE)
    assert np.all(lost.source == -1)
    assert np.all(lost.reason == MarkerReason.NO_START)
    end = bend_cable(0.45 + 0.15 * np.cos(np.linspace(0, 7, 40)), np.array([CABLE.length_m]))[:, 0]
    assert np.array_equal(sort_by_chain(alike.frames(unknown, end_m=end), CABLE).source, alike.source)


@given(SEEDS)
@settings(max_examples=5, deadline=None)
def test_equal_spacings_without_an_anchor_give_one_direction_to_all_frames(seed: int) -> None:
    scene = make_scene(np.random.default_rng(seed), swing_cable(30), noise_m=1e-4)
    found = sort_by_chain(scene.frames(None), CABLE)
    assert np.array_equal(found.source, scene.source) or np.array_equal(found.source, scene.source[:, ::-1])
    assert found.confidence.min() > 0.9


def list_frames(frames: list[Floats]) -> PointFrames:
    offsets = np.concatenate([[0], np.cumsum([len(points) for points in frames])]).astype(np.int64)
    points = np.concatenate([np.zeros((0, 3)), *frames]).astype(np.float32)
    source = np.zeros((0, 0), dtype=np.int16)
    return Scene(points, offsets, source, source).frames(anchor(len(frames)))


def test_points_that_are_none_or_too_few_or_doubled_break_nothing() -> None:
    whole = swing_cable(1)[0]
    broken = np.concatenate([whole, [[np.nan] * 3, [np.inf, 0, 0]]])
    frames = [np.zeros((0, 3)), whole[:1], whole[:2], whole[:3], broken, np.concatenate([whole, whole]), whole]
    found = sort_by_chain(list_frames(frames), CABLE)
    assert (found.source >= 0).sum(axis=1).tolist() == [0, 1, 2, 3, N_MARKERS, N_MARKERS, N_MARKERS]
    assert np.all(found.reason[0] == MarkerReason.HIDDEN)
    assert np.all(found.reason[5] == MarkerReason.AMBIGUOUS)
    assert found.source[4].tolist() == list(range(N_MARKERS))


def test_a_second_cable_in_view_is_not_taken_for_the_first() -> None:
    markers = swing_cable(40)
    scene = make_scene(np.random.default_rng(8), markers, markers + np.array([0.0, 0.0, 0.3]), noise_m=2e-4)
    assert np.array_equal(sort_by_chain(scene.frames(anchor(40)), CABLE).source, scene.source)


def test_a_room_full_of_points_is_left_unsorted_and_marked() -> None:
    rng = np.random.default_rng(9)
    found = sort_by_chain(list_frames([rng.uniform(-0.5, 0.5, (300, 3)), rng.uniform(-0.3, 0.3, (190, 3))]), CABLE)
    assert np.all(found.reason == MarkerReason.AMBIGUOUS)
    assert np.all(found.source[0] == -1)


def test_what_was_learnt_of_the_whole_take_sorts_a_few_frames_of_it() -> None:
    scene = make_scene(np.random.default_rng(12), swing_cable(200), swing_cable(200)[:, :2] + 0.02, 0.1, 2e-4)
    frames, few = scene.frames(anchor(200)), np.arange(40, 60)
    known = calibrate_spacing(frames, CABLE)
    assert np.array_equal(
        sort_by_chain(frames.take(few), CABLE, known).source, sort_by_chain(frames, CABLE).source[few]
    )


@pytest.mark.parametrize("n_markers", [1, 2, 3])
def test_cables_of_few_markers_are_sorted_from_their_anchor(n_markers: int) -> None:
    cable = replace(CABLE, arc_length_m=ARC_LENGTH_M[:n_markers], length_m=ARC_LENGTH_M[n_markers])
    still = np.broadcast_to(swing_cable(1)[:, :n_markers], (30, n_markers, 3))
    scene = make_scene(np.random.default_rng(11), still)
    found = sort_by_chain(scene.frames(anchor(30)), cable)
    assert np.array_equal(found.source, scene.source)
    assert found.warnings == []


def test_recordings_without_frames_and_cables_without_order() -> None:
    none = list_frames([])
    assert sort_by_chain(none, CABLE).source.shape == (0, N_MARKERS)
    with pytest.raises(TooFewMarkersError, match="at least 3"):
        sort_by_chain(replace(list_frames([swing_cable(1)[0]]), anchor_m=None), replace(CABLE, arc_length_m=(0.1, 0.2)))
    assert get_sorter("chain") is sort_by_chain


def test_the_compiled_search_does_what_its_python_does(monkeypatch: pytest.MonkeyPatch) -> None:
    from bench.analysis.kernels import chain_search

    rng = np.random.default_rng(10)
    scene = make_scene(rng, uneven_cable(4), rng.uniform(-0.2, 0.4, (4, 2, 3)), 0.1, 2e-4)
    costs = make_costs(UNEVEN, ChainPrior.guess(UNEVEN))
    given_start, free = anchor(4), np.array([False, False, True, False])
    given_start[2:] = np.nan
    end = np.full((4, 3), np.nan)
    end[1:3] = 0.3
    plain, results = chain_search.search_chains.py_func, []
    for loop in (chain_search.search_chains, plain):
        if loop is plain:
            for name, helper in list(vars(chain_search).items()):
                if hasattr(helper, "py_func"):
                    monkeypatch.setattr(chain_search, name, helper.py_func)
        slot, margin = np.empty((4, len(UNEVEN_M)), dtype=np.int16), np.empty((4, len(UNEVEN_M)), dtype=np.float32)
        tables = [getattr(costs, table.name) for table in fields(costs)]
        loop(scene.points_m, scene.offsets, scene.usable, given_start, free, end, *tables, slot, margin)
        results.append((slot, margin))
    assert np.array_equal(results[0][0], results[1][0])
    assert results[0][1] == pytest.approx(results[1][1], abs=1e-5)


def test_an_even_ring_without_ends_is_sorted_as_the_paper_does_where_that_finds_more_whole_cables() -> None:
    angle = np.arange(8) * 0.75
    ring = 0.4 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    known = SortSettings(tuple(0.3 * (i + 1) for i in range(8)), stretch=0.02, shorten=0.4, tolerance_m=0.004)
    scene = make_scene(np.random.default_rng(7), np.repeat(ring[None], 30, axis=0), noise_m=1e-4)
    found = sort_by_chain(scene.frames(None), known)
    assert found.method == "paper"
    assert "paper's chain finds more whole cables" in found.notes[0]
    assert np.array_equal(found.source, scene.source) or np.array_equal(found.source, scene.source[:, ::-1])
