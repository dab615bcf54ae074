"""What no cable can do is found and taken away, and the report is told; a wrong configuration is told from it."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from take_examples import frames_of, settings_of

from bench.analysis import MarkerReason, PointFrames, SortedMarkers, SortSettings, take_broken_away, tell_broken
from bench.analysis.sorting.gates import make_gates
from bench.analysis.sorting.invariants import find_leaps, find_shared_points, find_wrong_spacings
from bench.simulation.made_motions import HELD_OUT
from bench.simulation.made_takes import USUAL, make_take

LOOP = HELD_OUT["loop"][0]
CONDITIONS = replace(USUAL, n_ghosts=0)
TAKE = make_take(LOOP, 1, CONDITIONS, seed=1)
FRAMES, CABLE = frames_of(TAKE), settings_of(TAKE, CONDITIONS)
SEEDS = st.integers(0, 2**32 - 1)


def as_sorted(source: np.ndarray, sure: float | np.ndarray = 1.0, frames: PointFrames = FRAMES) -> SortedMarkers:
    confidence = np.where(source >= 0, sure, 0.0).astype(np.float32)
    reason = np.where(source >= 0, MarkerReason.FOUND, MarkerReason.HIDDEN).astype(np.uint8)
    return SortedMarkers.from_source(frames, source.astype(np.int16), confidence, reason, "made", ["first"])


def complete_frame(rng: np.random.Generator) -> int:
    """Return a frame in which all markers are seen, as in those beside it."""
    seen = (TAKE.source >= 0).all(axis=1)
    return int(rng.choice(np.flatnonzero(seen[1:-1] & seen[:-2] & seen[2:]) + 1))


def test_the_truth_breaks_nothing() -> None:
    found = take_broken_away(FRAMES, as_sorted(TAKE.source), CABLE)
    assert np.array_equal(found.source, TAKE.source)
    assert found.notes == ["first"]
    assert found.method == "made"


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_labels_exchanged_in_one_frame_are_taken_away_there_and_nowhere_else(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frame, marker = complete_frame(rng), int(rng.integers(0, 9))
    source = TAKE.source.copy()
    source[frame, [marker, marker + 1]] = source[frame, [marker + 1, marker]]
    found = take_broken_away(FRAMES, as_sorted(source), CABLE)
    assert np.all(found.source[frame, [marker, marker + 1]] == -1)
    assert np.all(found.reason[frame, [marker, marker + 1]] == MarkerReason.BROKEN)
    assert np.all(found.marker_confidence[frame, [marker, marker + 1]] == 0)
    assert np.array_equal(np.delete(found.source, frame, axis=0), np.delete(TAKE.source, frame, axis=0))
    assert f"In 1 of {len(source)} frames" in found.warnings[-1]


def test_what_breaks_an_invariant_is_counted_and_left_where_it_shall_not_be_taken_away() -> None:
    source, frame = TAKE.source.copy(), complete_frame(np.random.default_rng(5))
    source[frame, [2, 3]] = source[frame, [3, 2]]
    told = tell_broken(FRAMES, as_sorted(source), CABLE)
    assert np.array_equal(told.source, source)
    assert f"In 1 of {len(source)} frames" in told.warnings[0]
    assert tell_broken(FRAMES, as_sorted(TAKE.source), CABLE).warnings == []


def test_a_marker_too_far_from_both_neighbours_is_the_one_to_blame() -> None:
    far = TAKE.points_m.copy()
    frame = complete_frame(np.random.default_rng(2))
    point = TAKE.offsets[frame] + TAKE.source[frame, 4]
    far[point] += np.float32([0.0, 0.3, 0.0])
    frames = replace(FRAMES, points_m=far)
    pairs = find_wrong_spacings(frames, as_sorted(TAKE.source, frames=frames).position_m, CABLE, make_gates(CABLE))
    assert sorted(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)) == [(3, 4), (4, 5)]
    blamed = pairs.blame(np.ones(TAKE.source.shape, dtype=np.float32))
    assert np.argwhere(blamed).tolist() == [[frame, 4]]


def test_without_a_third_to_ask_the_less_sure_one_goes_and_both_of_equals() -> None:
    frame = complete_frame(np.random.default_rng(3))
    source = np.full_like(TAKE.source, -1)
    source[frame, [3, 4]] = TAKE.source[frame, [0, 4]]
    bare = replace(FRAMES, anchor_m=None, end_m=None)
    sure = np.ones(source.shape)
    assert take_broken_away(bare, as_sorted(source, sure), CABLE).source[frame].max() == -1
    sure[frame, 4] = 0.6
    kept = take_broken_away(bare, as_sorted(source, sure), CABLE).source[frame]
    assert np.flatnonzero(kept >= 0).tolist() == [3]


def test_the_anchor_and_the_cables_other_end_are_never_to_blame() -> None:
    beyond = CABLE.length_m - CABLE.arc_length_m[-1]
    end = FRAMES.end_m.copy()
    end[5] += (2 * beyond + 0.1, 0.0, 0.0)
    anchor = FRAMES.anchor_m.copy()
    anchor[7] += (0.4, 0.0, 0.0)
    found = take_broken_away(replace(FRAMES, end_m=end, anchor_m=anchor), as_sorted(TAKE.source), CABLE)
    assert np.flatnonzero((found.reason == MarkerReason.BROKEN).any(axis=1)).tolist() == [5, 7]


def test_a_wrong_arc_length_is_told_as_such_and_takes_nothing_away() -> None:
    arc = np.array(CABLE.arc_length_m)
    arc[5:] -= 0.04
    found = take_broken_away(FRAMES, as_sorted(TAKE.source), replace(CABLE, arc_length_m=tuple(arc), length_m=np.nan))
    assert np.array_equal(found.source, TAKE.source)
    assert any("from marker 4 to marker 5 is not 70 mm" in note for note in found.warnings)


def test_an_end_where_no_cable_reaches_takes_no_marker_away() -> None:
    astray = replace(FRAMES, end_m=FRAMES.end_m + np.array([0.0, 0.0, 0.3]))
    found = take_broken_away(astray, as_sorted(TAKE.source, frames=astray), CABLE)
    assert np.array_equal(found.source, TAKE.source)
    assert "other end is farther from its last marker than the cable is long" in found.warnings[-1]


def test_of_two_markers_with_one_point_the_surer_one_keeps_it() -> None:
    source = np.array([[3, 1, 3, -1], [-1, -1, 0, 2]], dtype=np.int16)
    sure = np.array([[0.7, 1.0, 0.9, 0.0], [0.0, 0.0, 1.0, 1.0]], dtype=np.float32)
    assert find_shared_points(source, sure).tolist() == [[True, False, False, False], [False] * 4]


def test_a_cable_that_moves_as_a_whole_does_not_leap() -> None:
    shift = np.where(np.arange(len(FRAMES)) % 2, 0.2, 0.0)[:, None]
    points = (FRAMES.points_m + np.repeat(shift, np.diff(FRAMES.offsets), axis=0)).astype(np.float32)
    shaken = replace(FRAMES, points_m=points)
    assert len(find_leaps(shaken, as_sorted(TAKE.source, frames=shaken).position_m, CABLE).first) == 0


def test_a_first_marker_at_arc_length_zero_has_no_anchor_to_be_exchanged_with() -> None:
    places = CABLE.arc_length_m
    free, headless = replace(FRAMES, anchor_m=None), replace(CABLE, arc_length_m=tuple(s - places[0] for s in places))
    assert len(find_leaps(free, as_sorted(TAKE.source).position_m, headless).first) == 0


def test_no_frames_and_one_marker_break_nothing() -> None:
    none = FRAMES.take(np.zeros(0, dtype=np.int64))
    assert len(take_broken_away(none, as_sorted(np.zeros((0, 10)), frames=none), CABLE).source) == 0
    single = SortSettings(CABLE.arc_length_m[:1])
    found = take_broken_away(FRAMES, as_sorted(TAKE.source[:, :1]), single)
    assert np.array_equal(found.source, TAKE.source[:, :1])
