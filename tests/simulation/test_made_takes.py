"""Made takes are what they say: inextensible cables, bursts of the wanted share, ghosts where they belong, a truth."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.simulation.made_motions import ANCHOR_M, DEVELOPMENT, HELD_OUT, Motion
from bench.simulation.made_takes import HARD, USUAL, Conditions, make_take

LOOP = DEVELOPMENT["loop"][0]
CLEAN = Conditions(noise_m=0.0, jitter_m=0.0, end_error_m=0.0)
EVERY_MOTION = [motion for group in (DEVELOPMENT, HELD_OUT) for motions in group.values() for motion in motions]


def hidden_bursts(hidden: np.ndarray) -> np.ndarray:
    edges = np.diff(np.pad(hidden.astype(int), ((1, 1), (0, 0))), axis=0)
    return np.concatenate([np.flatnonzero(down == -1) - np.flatnonzero(down == 1) for down in edges.T])


@pytest.mark.parametrize("motion", EVERY_MOTION, ids=lambda motion: motion.name)
def test_no_cable_stretches_or_goes_through_itself(motion: Motion) -> None:
    arc = np.linspace(0.0, motion.length_m, 106)
    points = motion.points_at(np.linspace(0, 1, 60), np.broadcast_to(arc, (60, 106)))
    assert_allclose(points[:, 0], np.broadcast_to(ANCHOR_M, (60, 3)))
    step = np.linalg.norm(np.diff(points, axis=1), axis=2)
    assert step.max() <= arc[1] * (1 + 1e-9)
    assert step.min() > 0.98 * arc[1]
    far = np.abs(np.subtract.outer(arc, arc)) > 0.25
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=3)[:, far]
    assert apart.min() > 0.010


def test_development_and_held_out_motions_share_nothing_but_their_kinds() -> None:
    assert DEVELOPMENT.keys() == HELD_OUT.keys()
    for kind, motions in DEVELOPMENT.items():
        others = HELD_OUT[kind]
        assert not {motion.seed for motion in motions} & {motion.seed for motion in others}
        for parameter in ("length_m", "start_rad", "turn_rad", "tightness", "tilt_rad", "swing_rad", "cycle_s"):
            assert getattr(motions[0], parameter) != getattr(others[0], parameter)


def test_the_truth_names_the_markers_among_the_points() -> None:
    take = make_take(LOOP, 2, replace(USUAL, noise_m=0.0))
    frame, marker = np.nonzero(take.source >= 0)
    points = take.points_m[take.offsets[frame] + take.source[frame, marker]]
    assert_allclose(points, take.marker_m[frame, marker], atol=1e-6)
    n_seen = (take.source >= 0).sum(axis=1)
    assert_array_equal(np.diff(take.offsets), n_seen + USUAL.n_ghosts)
    assert take.score(take.source) == (1.0, 0.0)
    wrong = take.source.copy()
    wrong[0] = np.roll(wrong[0], 1)
    assert take.score(wrong) == (1 - 1 / len(wrong), 1 / len(wrong))
    assert take.score(np.full_like(wrong, -1)) == (0.0, 0.0)


def test_markers_are_hidden_in_bursts_of_the_wanted_share() -> None:
    take = make_take(LOOP, 50, Conditions(miss_share=0.10))
    hidden = take.source < 0
    assert hidden.mean() == pytest.approx(0.10, abs=0.02)
    assert hidden_bursts(hidden).mean() == pytest.approx(8.0, rel=0.1)


def test_ghosts_lie_beside_the_cable_and_the_reflection_never_moves() -> None:
    take = make_take(LOOP, 5, replace(HARD, miss_share=0.0, noise_m=0.0, near_share=1.0))
    counts = np.diff(take.offsets)
    assert np.all(counts == 10 + 4)
    points = take.points_m.reshape(len(counts), 14, 3).astype(float)
    is_ghost = np.ones(points.shape[:2], dtype=bool)
    np.put_along_axis(is_ghost, take.source.astype(int), False, axis=1)
    ghosts = points[is_ghost].reshape(len(counts), 4, 3)
    moved = np.linalg.norm(ghosts[:, :, None] - ghosts[0], axis=3).min(axis=1).max(axis=0)
    assert np.sum(moved < 1e-6) == 1
    arc = np.linspace(0, LOOP.length_m, 400)
    cable = LOOP.points_at(np.zeros(1), arc[None])[0]
    apart = np.linalg.norm(ghosts[0][:, None] - cable, axis=2).min(axis=1)
    assert np.sum(apart < 0.020 + 0.015) == 3  # within 20 mm of a cable that jitters by 3 mm


def test_cycles_are_alike_and_other_motions_are_not() -> None:
    def spread_at_phase(motion: Motion, conditions: Conditions) -> float:
        motion = replace(motion, cycle_s=4.0)
        markers = make_take(motion, 10, conditions).marker_m
        by_cycle = markers.reshape(10, 400, -1, 3)
        deviation = by_cycle - by_cycle.mean(axis=0)
        return float(np.sqrt(np.square(deviation).sum(axis=3).mean()))

    assert spread_at_phase(LOOP, CLEAN) < 1e-9
    assert spread_at_phase(LOOP, replace(CLEAN, jitter_m=0.010)) == pytest.approx(0.010, rel=0.4)
    assert spread_at_phase(LOOP, replace(CLEAN, drift_m=0.030)) == pytest.approx(0.030 * np.sqrt(1 / 12), rel=0.6)
    assert spread_at_phase(DEVELOPMENT["not repeating"][0], CLEAN) > 0.02


def test_phase_and_cycle_follow_time_and_the_same_arguments_give_the_same_take() -> None:
    take, again = make_take(LOOP, 3, seed=5), make_take(LOOP, 3, seed=5)
    assert_array_equal(take.points_m, again.points_m)
    assert not np.array_equal(take.points_m[:50], make_take(LOOP, 3, seed=6).points_m[:50])
    assert_array_equal(np.unique(take.cycle), [0, 1, 2])
    assert take.phase.min() >= 0
    assert take.phase.max() < 1
    assert np.all(np.diff(take.time_ns) == 10_000_000)
    whole = make_take(DEVELOPMENT["not repeating"][0], 3)
    assert np.all(whole.cycle == 0)
    assert np.all(np.diff(whole.phase) > 0)


def test_the_known_end_is_wrong_by_a_constant() -> None:
    take = make_take(LOOP, 2, replace(CLEAN, end_error_m=0.002))
    true = LOOP.points_at(take.cycle + take.phase, np.full((len(take.phase), 1), LOOP.length_m))[:, 0]
    error = take.end_m - true
    assert_allclose(error, np.broadcast_to(error[0], error.shape), atol=1e-9)
    assert 0 < np.linalg.norm(error[0]) < 0.010
