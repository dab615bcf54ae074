"""The cycle's template: exact where cycles repeat, followed as it drifts, learnt anew, left where it does not fit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from take_examples import frames_of, settings_of

from bench.analysis import MarkerReason, PointFrames, SortedMarkers, SortSettings, sort_by_chain, sort_by_phase
from bench.analysis.kernels import phase_following as kernel
from bench.analysis.sorting import phase_learning as learning
from bench.analysis.sorting.phase_following import follow_frames
from bench.analysis.sorting.phase_learning import learn_cycle
from bench.simulation.made_motions import HELD_OUT, Motion
from bench.simulation.made_takes import HARD, USUAL, Conditions, MadeTake, make_take

CLEAN = Conditions(miss_share=0.0, n_ghosts=0)
LOOP = HELD_OUT["loop"][0]
QUICK = replace(LOOP, cycle_s=1.0037)
"""The same shapes in a quarter of the time and frames: 100 frames a cycle."""


def sort_take(take: MadeTake, conditions: Conditions = USUAL, **known: object) -> SortedMarkers:
    return sort_by_phase(frames_of(take, **known), settings_of(take, conditions))


@pytest.mark.parametrize(
    ("motion", "conditions", "least"),
    [
        (LOOP, USUAL, 0.9995),
        (HELD_OUT["uneven loop"][1], USUAL, 0.9995),
        (LOOP, HARD, 0.995),
        (HELD_OUT["dense"][0], USUAL, 0.99),
    ],
    ids=["crossing", "uneven", "hard", "25 markers"],
)
def test_held_out_motions_are_sorted_as_exactly_as_is_told(
    motion: Motion, conditions: Conditions, least: float
) -> None:
    take = make_take(motion, 20, conditions, seed=7)
    found = sort_take(take, conditions)
    exact, wrong = take.score(found.source)
    assert exact >= least
    assert wrong <= 1 - least
    assert "10 cycles" in " ".join(found.notes)


def test_what_is_sure_is_right_and_what_is_hidden_says_so() -> None:
    take = make_take(LOOP, 12, HARD, seed=8)
    found = sort_take(take, HARD)
    sure = found.reason == MarkerReason.FOUND
    assert np.mean(found.source[sure] == take.source[sure]) > 0.9995
    assert np.all(found.marker_confidence[sure] > 0.5)
    assert np.array_equal(found.source < 0, found.reason == MarkerReason.HIDDEN)
    assert np.all(found.marker_confidence[found.source < 0] == 0)


def test_a_template_follows_a_cable_that_settles() -> None:
    settling = replace(USUAL, drift_m=0.05)
    take = make_take(QUICK, 250, settling, seed=3)
    moved = np.linalg.norm(take.marker_m[-100:].mean(axis=0) - take.marker_m[:100].mean(axis=0), axis=1)
    assert moved.max() > 0.025  # more than any gate
    found = sort_take(take, settling)
    assert take.score(found.source)[0] > 0.99
    assert not any("anew" in note for note in found.warnings)


@pytest.mark.parametrize("jitter_m", [0.0, 0.003])
def test_a_template_follows_a_cable_that_changes_quickly(jitter_m: float) -> None:
    """Its markers leave their gates within the 25 cycles after which the template follows at the latest."""
    changing = replace(USUAL, jitter_m=jitter_m, drift_m=0.05)
    take = make_take(QUICK, 60, changing, seed=9)
    found = sort_take(take, changing)
    exact, wrong = take.score(found.source)
    assert exact > 0.995
    assert wrong < 0.001
    assert not found.warnings


def test_a_cable_that_slips_is_learnt_anew() -> None:
    take = make_take(QUICK, 30, USUAL, seed=4)
    slipped = take.cycle >= 15
    points, offsets = take.points_m.copy(), take.offsets
    points[offsets[np.flatnonzero(slipped)[0]] :] += np.float32([0.0, 0.2, 0.0])
    anchor, end = take.anchor_m.copy(), take.end_m.copy()
    anchor[slipped] += (0.0, 0.2, 0.0)
    end[slipped] += (0.0, 0.2, 0.0)
    found = sort_by_phase(
        replace(frames_of(take, anchor_m=anchor, end_m=end), points_m=points), settings_of(take, USUAL)
    )
    assert take.score(found.source)[0] > 0.99
    assert any("learnt anew at cycle 15" in note for note in found.warnings)


def poison(monkeypatch: pytest.MonkeyPatch, share: float) -> None:
    """Let the template learn from labels that are wrong in that share of the frames."""

    def poisoned(frames: PointFrames, cable: SortSettings) -> SortedMarkers:
        found = sort_by_chain(frames, cable)
        wrong = np.random.default_rng(1).random(len(frames)) < share
        source, sure = found.source.copy(), np.zeros_like(found.reason)
        source[wrong] = np.roll(source[wrong], 1, axis=1)
        return SortedMarkers.from_source(frames, source, np.ones(source.shape, np.float32), sure, "poisoned")

    monkeypatch.setattr(learning, "sort_by_chain", poisoned)


def test_wrong_labels_in_a_seventh_of_the_learnt_frames_do_not_reach_the_template(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    take = make_take(LOOP, 12, USUAL, seed=5)
    clean = learn_cycle(frames_of(take), settings_of(take, USUAL))
    poison(monkeypatch, 0.15)
    template = learn_cycle(frames_of(take), settings_of(take, USUAL))
    assert clean is not None
    assert template is not None
    assert np.mean(np.linalg.norm(template.position_m - clean.position_m, axis=2) > 0.010) < 0.002
    assert take.score(sort_take(take).source)[0] > 0.995


def test_a_template_learnt_from_wrong_labels_is_told_by_the_chain_search(monkeypatch: pytest.MonkeyPatch) -> None:
    take = make_take(LOOP, 6, USUAL, seed=5)
    assert sort_take(take).warnings == []
    poison(monkeypatch, 0.35)
    poisoned = sort_take(take)
    assert take.score(poisoned.source)[0] < 0.9
    assert any("may have been learnt from wrongly sorted cycles" in text for text in poisoned.warnings)


@pytest.mark.parametrize("missing", ["cycles", "whole cycles", "phase"])
def test_without_cycles_each_frame_is_sorted_by_itself(missing: str) -> None:
    take = make_take(QUICK, 6, USUAL)
    nowhere, unknown = np.full_like(take.cycle, -1), np.full_like(take.phase, np.nan)
    known = {
        "cycles": {"cycle": None, "phase": None},
        "whole cycles": {"cycle": nowhere, "phase": unknown},
        "phase": {"phase": unknown},
    }[missing]
    frames, cable = frames_of(take, **known), settings_of(take, USUAL)
    found = sort_by_phase(frames, cable)
    assert np.array_equal(found.source, sort_by_chain(frames, cable).source)
    assert "sorted by itself" in found.notes[0]


def test_one_cycle_is_not_enough_to_learn_from() -> None:
    take = make_take(LOOP, 1, USUAL)
    assert learn_cycle(frames_of(take), settings_of(take, USUAL)) is None
    assert take.score(sort_take(take).source)[0] > 0.9


def test_frames_outside_cycles_are_sorted_by_the_chain_search() -> None:
    take = make_take(QUICK, 10, USUAL, seed=6)
    outside = (take.phase > 0.9) & (take.phase < 0.95)
    found = sort_take(take, cycle=np.where(outside, -1, take.cycle), phase=np.where(outside, np.nan, take.phase))
    assert (found.source[outside] >= 0).mean() > 0.9
    assert any(f"{outside.sum()} frames outside any cycle" in note for note in found.notes)


def test_markers_hidden_for_a_second_are_found_again_at_once() -> None:
    take = make_take(LOOP, 10, CLEAN, seed=2)
    dark = (np.arange(len(take.phase)) >= 1500) & (np.arange(len(take.phase)) < 1600)
    found = sort_take(take, CLEAN, usable=~np.repeat(dark, np.diff(take.offsets)))
    assert np.all(found.source[dark] == -1)
    assert np.array_equal(found.source[1600:1620], take.source[1600:1620])


def test_a_robot_that_stops_in_its_cycle_leaves_the_frames_to_the_chain_search() -> None:
    take = make_take(LOOP, 12, CLEAN, seed=2)
    stops = (take.cycle == 8) & (take.phase > 0.4)
    phase = np.where(stops, np.minimum(take.phase + 0.3, 0.999), take.phase)  # the clock runs on and the cable does not
    found = sort_take(take, CLEAN, phase=phase)
    assert (found.source[stops] == take.source[stops]).all(axis=1).mean() > 0.9
    assert any("less than half of the markers in sight" in note for note in found.warnings)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=3, deadline=None)
def test_order_of_points_and_frames_and_a_moved_bench_change_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    take = make_take(QUICK, 8, USUAL, seed=seed % 1000)
    frames, cable = frames_of(take), settings_of(take, USUAL)
    order = rng.permutation(len(frames))
    turn, shift = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.uniform(-3, 3, 3)

    def moved(place: np.ndarray) -> np.ndarray:
        return place @ turn.T + shift

    elsewhere = replace(
        frames,
        points_m=moved(frames.points_m).astype(np.float32),
        anchor_m=moved(frames.anchor_m),
        end_m=moved(frames.end_m),
    ).take(order)
    same = (sort_by_phase(elsewhere, cable).source == sort_by_phase(frames, cable).source[order]).all(axis=1)
    assert same.mean() > 0.995  # a mirrored, turned bench is rounded otherwise to float32


def test_a_clock_that_stands_still_costs_exactness_and_nothing_else() -> None:
    take = make_take(QUICK, 8, CLEAN, seed=1)
    found = sort_by_phase(replace(frames_of(take), time_ns=np.zeros_like(take.time_ns)), settings_of(take, CLEAN))
    assert take.score(found.source)[0] > 0.95


def test_points_without_a_place_are_nobodys() -> None:
    take = make_take(QUICK, 8, USUAL, seed=1)
    points = take.points_m.copy()
    gone = np.random.default_rng(1).random(len(points)) < 0.02
    points[gone] = np.nan
    found = sort_by_phase(replace(frames_of(take), points_m=points), settings_of(take, USUAL))
    given_points = take.offsets[:-1, None] + found.source
    assert not gone[given_points[found.source >= 0]].any()


def test_the_compiled_loop_agrees_with_plain_python(monkeypatch: pytest.MonkeyPatch) -> None:
    take = make_take(QUICK, 7, HARD, seed=3)
    frames, cable = frames_of(take), settings_of(take, HARD)
    template = learn_cycle(frames, cable)
    assert template is not None
    rows = np.arange(100, 220)
    compiled = follow_frames(frames, rows, template)
    for name in ("_expect", "_compare_neighbours", "_list_pairs", "_insert", "_give", "_distance", "follow_phase"):
        monkeypatch.setattr(kernel, name, getattr(kernel, name).py_func)
    plain = follow_frames(frames, rows, template)
    assert np.array_equal(compiled.source, plain.source)
    np.testing.assert_allclose(compiled.misfit, plain.misfit, rtol=1e-5)
    np.testing.assert_allclose(compiled.rival, plain.rival, rtol=1e-5)
