"""'auto' takes the sorter that suits the recording, says why, and lets nothing through that no cable can do."""

from dataclasses import replace

import numpy as np
import pytest
from take_examples import frames_of, settings_of

from bench.analysis import (
    MarkerReason,
    PointFrames,
    SortedMarkers,
    SortSettings,
    get_sorter,
    sort_automatically,
    sort_by_chain,
)
from bench.analysis.sorting import sorters as choice
from bench.simulation.made_motions import HELD_OUT
from bench.simulation.made_takes import USUAL, make_take

QUICK = replace(HELD_OUT["loop"][1], cycle_s=1.0037)
IRREGULAR = replace(HELD_OUT["not repeating"][0], cycle_s=1.5037)


def test_cycles_that_repeat_are_sorted_by_the_cycle() -> None:
    take = make_take(QUICK, 8, USUAL, seed=2)
    found = get_sorter("auto")(frames_of(take), settings_of(take, USUAL))
    assert found.method == "phase"
    assert found.notes[0].startswith("Sorted by the robot's cycle ('phase'), which repeats: a cycle strays")
    assert take.score(found.source)[0] > 0.995


def test_cycles_that_do_not_repeat_are_not() -> None:
    take = make_take(IRREGULAR, 8, USUAL, seed=2)
    cycles = np.arange(len(take.phase)) / 150.0
    frames = frames_of(take, cycle=cycles.astype(np.int64), phase=cycles % 1.0)
    found = sort_automatically(frames, settings_of(take, USUAL))
    assert found.method == "track"
    assert "no cycle repeats: a cycle strays from the median by" in found.notes[0]
    assert take.score(found.source)[0] > 0.9


def test_a_take_without_cycles_says_so() -> None:
    take = make_take(IRREGULAR, 2, USUAL, seed=2)
    found = sort_automatically(frames_of(take), settings_of(take, USUAL))
    assert "fewer than 5 whole cycles" in found.notes[0]


def test_a_window_of_the_live_view_is_sorted_frame_by_frame() -> None:
    take = make_take(QUICK, 8, USUAL, seed=2)
    window = frames_of(take, cycle=None, phase=None).take(np.arange(100, 120))
    found = sort_automatically(window, settings_of(take, USUAL))
    assert found.method == "chain"
    assert found.notes[0] == "Sorted each frame by itself ('chain'): there are only 20 frames."


def test_no_frames_at_all_are_no_trouble() -> None:
    take = make_take(QUICK, 1, USUAL)
    found = sort_automatically(frames_of(take).take(np.zeros(0, dtype=np.int64)), settings_of(take, USUAL))
    assert found.source.shape == (0, 10)


def test_what_breaks_an_invariant_is_taken_away(monkeypatch: pytest.MonkeyPatch) -> None:
    def swapped(frames: PointFrames, cable: SortSettings) -> SortedMarkers:
        found = sort_by_chain(frames, cable)
        source = found.source.copy()
        source[7, [2, 6]] = source[7, [6, 2]]
        return SortedMarkers.from_source(frames, source, found.marker_confidence, found.reason, "chain", found.notes)

    take = make_take(QUICK, 1, replace(USUAL, miss_share=0.0, n_ghosts=0), seed=1)
    frames = frames_of(take).take(np.arange(30))
    monkeypatch.setattr(choice, "sort_by_chain", swapped)
    found = sort_automatically(frames, settings_of(take, USUAL))
    assert np.flatnonzero((found.reason == MarkerReason.BROKEN).any(axis=1)).tolist() == [7]
    assert np.flatnonzero(found.reason[7] == MarkerReason.BROKEN).tolist() == [2, 6]
    assert "In 1 of 30 frames a marker broke an invariant" in found.warnings[-1]
