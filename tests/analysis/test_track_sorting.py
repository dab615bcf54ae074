"""Sorting by tracks: exact where the motion tells, the same however the frames are listed, and never led astray."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from cable_examples import Floats, make_rotation
from hypothesis import given, settings
from hypothesis import strategies as st
from motion_examples import CABLE, PLACES_M, Recording, list_frames, move_cable, record

from bench.analysis import (
    MarkerReason,
    PointFrames,
    SortedMarkers,
    SortSettings,
    SpacingCalibration,
    get_sorter,
    sort_by_chain,
)
from bench.analysis.sorting import track_sorting
from bench.analysis.sorting.point_tracks import LinkGates, PointTracks, link_tracks
from bench.analysis.sorting.track_sorting import sort_by_track

SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=6, deadline=None)
NONE_HIDDEN: dict[str, float] = {"miss": 0.0, "bursts": 0.0, "ghosts": 0.0}
STEADY_S = np.arange(0, 2, 0.01)


def sort(recording: Recording) -> SortedMarkers:
    return sort_by_track(recording.frames, CABLE)


def as_points(frames: PointFrames, source: npt.NDArray[np.int16]) -> Floats:
    """Return the positions that the labels name, -1 where there is none: comparable between orders of points."""
    named = frames.points_m[np.minimum(frames.offsets[:-1, None] + np.maximum(source, 0), len(frames.points_m) - 1)]
    return np.where(source[..., None] >= 0, named, -1.0)


@pytest.mark.parametrize("rate_hz", [100.0, 50.0, 33.0])
def test_nearly_every_frame_is_exact_at_any_rate(rate_hz: float) -> None:
    recordings = [record(seed, np.arange(0, 6, 1 / rate_hz)) for seed in (1001, 1002, 1003)]
    found = [sort(one).source for one in recordings]
    assert np.mean([one.exact(row).mean() for one, row in zip(recordings, found, strict=True)]) > 0.99
    assert np.mean([one.wrong(row).mean() for one, row in zip(recordings, found, strict=True)]) < 0.003


@given(SEEDS)
@FEW
def test_the_order_in_which_a_frame_lists_its_points_changes_no_label(seed: int) -> None:
    frames, rng = record(seed, STEADY_S).frames, np.random.default_rng(seed)
    frame = np.repeat(np.arange(len(frames)), np.diff(frames.offsets))
    order = np.lexsort((rng.random(len(frame)), frame))
    shuffled = replace(frames, points_m=frames.points_m[order])
    there = as_points(shuffled, sort_by_track(shuffled, CABLE).source)
    assert np.array_equal(as_points(frames, sort_by_track(frames, CABLE).source), there)


@given(SEEDS)
@FEW
def test_moving_the_whole_recording_changes_no_label(seed: int) -> None:
    frames = record(seed, STEADY_S).frames
    matrix, _ = make_rotation(np.random.default_rng(seed))
    shift = np.array([0.4, -1.2, 0.7])
    points = (frames.points_m.astype(np.float64) @ matrix.T + shift).astype(np.float32)
    moved = replace(frames, points_m=points, anchor_m=np.broadcast_to(shift, (len(frames), 3)))
    assert np.array_equal(sort_by_track(frames, CABLE).source, sort_by_track(moved, CABLE).source)


@given(SEEDS)
@FEW
def test_a_recording_played_backwards_has_the_same_labels(seed: int) -> None:
    frames = record(seed, STEADY_S, ghosts=0.3).frames
    backwards = replace(frames, time_ns=frames.time_ns[-1] - frames.time_ns)
    assert np.array_equal(sort_by_track(frames, CABLE).source, sort_by_track(backwards, CABLE).source)


def test_frames_may_come_in_any_order_of_time() -> None:
    recording = record(3, STEADY_S)
    order = np.random.default_rng(3).permutation(len(STEADY_S))
    found = sort_by_track(recording.frames.take(order), CABLE)
    assert np.array_equal(found.source, sort(recording).source[order])
    assert np.array_equal(found.reason, sort(recording).reason[order])


def test_after_a_second_without_any_marker_the_cable_is_found_again() -> None:
    time_s = np.arange(0, 4, 0.01)
    hidden = np.zeros((len(time_s), len(PLACES_M)), dtype=bool)
    hidden[(time_s > 1.5) & (time_s < 2.5)] = True
    recording = list_frames(np.random.default_rng(4), time_s, move_cable(time_s), hidden, [[] for _ in time_s], 2e-4)
    found = sort(recording)
    assert np.array_equal(found.source, recording.source)
    assert np.all(found.reason[200] == MarkerReason.HIDDEN)
    assert np.all(found.confidence[200] == 0)


def test_a_pause_and_a_change_of_rate_need_no_setting() -> None:
    time_s = np.concatenate([np.arange(0, 2, 0.01), np.arange(7, 10, 0.03), np.arange(10, 11, 0.005)])
    recording = record(5, time_s)
    found = sort(recording)
    assert recording.exact(found.source).mean() > 0.99
    assert recording.wrong(found.source).mean() < 0.005


def test_two_frames_of_one_time_are_sorted_both() -> None:
    time_s = np.sort(np.concatenate([STEADY_S, STEADY_S[50:60], STEADY_S[120:121]]))
    recording = record(6, time_s, **NONE_HIDDEN)
    assert np.array_equal(sort(recording).source, recording.source)


def test_points_listed_twice_and_points_without_a_place_are_no_ambiguity() -> None:
    recording = record(7, STEADY_S, ghosts=0.0)
    n_points = np.diff(recording.frames.offsets)
    rows = np.split(recording.frames.points_m, recording.frames.offsets[1:-1])
    none = np.array([[np.nan] * 3, [np.inf, 0, 0]], dtype=np.float32)
    listed = np.concatenate([np.concatenate([row, none, row]) for row in rows])
    offsets = np.concatenate([[0], np.cumsum(2 * n_points + len(none))])
    frames = replace(recording.frames, points_m=listed, offsets=offsets, usable=np.ones(len(listed), dtype=bool))
    assert np.array_equal(sort_by_track(frames, CABLE).source, sort(recording).source)


@pytest.mark.parametrize("n_frames", [1, 2, 3])
def test_a_few_frames_alone_are_sorted_as_the_chain_search_does(n_frames: int) -> None:
    recording = record(8, STEADY_S[:n_frames], **NONE_HIDDEN)
    found = sort(recording)
    assert np.array_equal(found.source, recording.source)


def test_recordings_without_frames_or_points_or_anchor_are_no_error() -> None:
    recording = record(9, STEADY_S, **NONE_HIDDEN)
    assert sort_by_track(recording.frames.take(np.zeros(0, dtype=np.int64)), CABLE).source.shape == (0, len(PLACES_M))
    unseen = replace(recording.frames, usable=np.zeros(len(recording.frames.points_m), dtype=bool))
    assert np.all(sort_by_track(unseen, CABLE).source == -1)
    lost = replace(unseen, anchor_m=np.full((len(STEADY_S), 3), np.nan))
    assert np.all(sort_by_track(lost, CABLE).reason == MarkerReason.NO_START)
    assert np.array_equal(sort_by_track(replace(recording.frames, anchor_m=None), CABLE).source, recording.source)


def test_frames_that_the_chain_search_gets_wrong_are_outvoted(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = record(10, np.arange(0, 4, 0.01))
    expected = sort(recording).source

    def stumble(frames: PointFrames, cable: SortSettings, known: SpacingCalibration | None) -> SortedMarkers:
        found = sort_by_chain(frames, cable, known)
        source = found.source.copy()
        source[::4] = np.roll(source[::4], 1, axis=1)
        return replace(found, source=source)

    monkeypatch.setattr(track_sorting, "sort_by_chain", stumble)
    assert np.array_equal(sort(recording).source, expected)


def ride_along(apart_m: list[tuple[float, float, float]]) -> Recording:
    """Hide marker 4 for 0.3 s, while ghosts ride along beside it for 0.1 s."""
    markers, hidden = move_cable(STEADY_S), np.zeros((len(STEADY_S), len(PLACES_M)), dtype=bool)
    hidden[80:110, 4] = True
    further: list[list[Floats]] = [[] for _ in STEADY_S]
    for frame in range(90, 100):
        further[frame] = [markers[frame, 4] + apart for apart in apart_m]
    return list_frames(np.random.default_rng(11), STEADY_S, markers, hidden, further, 1e-4)


def test_a_ghost_that_rides_along_beside_a_hidden_marker_is_not_taken_for_it() -> None:
    recording = ride_along([(0.0, 0.012, 0.0)])
    assert np.array_equal(sort(recording).source, recording.source)


def test_of_two_points_that_fit_alike_none_is_taken() -> None:
    recording = ride_along([(0.0, 0.0006, 0.0), (0.0, -0.0006, 0.0)])
    found = sort(recording)
    assert np.array_equal(found.source, recording.source)
    assert np.all(found.reason[90:100, 4] == MarkerReason.AMBIGUOUS)
    assert np.all(found.reason[101:110, 4] == MarkerReason.HIDDEN)


def test_a_marker_that_comes_back_for_a_moment_is_filled_in() -> None:
    recording = ride_along([(0.0, 0.0, 0.0)])
    found = sort(recording)
    assert np.all(found.source[90:100, 4] >= 0)
    assert np.all(found.reason[90:100, 4] == MarkerReason.FILLED)
    assert np.all(found.marker_confidence[90:100, 4] > 0.7)
    assert np.all(found.reason[:80] == MarkerReason.FOUND)
    assert get_sorter("track") is sort_by_track


def test_a_long_recording_is_sorted_in_stretches_that_agree_with_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = record(11, np.arange(0, 12, 0.01))
    whole, lengths = sort(recording), []

    def look(frames: PointFrames, gates: LinkGates) -> PointTracks:
        lengths.append(len(frames))
        return link_tracks(frames, gates)

    monkeypatch.setattr(track_sorting, "STRETCH", 500)
    monkeypatch.setattr(track_sorting, "AROUND_S", 2.0)
    monkeypatch.setattr(track_sorting, "link_tracks", look)
    shuffled = np.random.default_rng(11).permutation(len(recording.frames))
    found = sort_by_track(recording.frames.take(shuffled), CABLE)
    assert [round(n, -1) for n in lengths] == [700, 900, 400]
    assert recording.exact(found.source[np.argsort(shuffled)]).mean() > 0.995
    assert (found.source[np.argsort(shuffled)] != whole.source).any(axis=1).mean() < 0.005
    assert found.warnings == whole.warnings
    without_ends = replace(recording.frames, anchor_m=None)
    alike = replace(CABLE, arc_length_m=tuple(np.arange(1, 9) * 0.09))
    lengths.clear()
    sort_by_track(without_ends, alike)  # each stretch would choose a direction of its own
    assert lengths == [1200]
