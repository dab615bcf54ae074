"""Eq. (6): what it says of equal, shifted, late and turned motions, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bench.analysis import (
    RigidTransform,
    align_in_space,
    align_in_time,
    compare_motions,
    draw_motion,
    median_cycle,
    shift_motion,
)
from bench.errors import AnalysisError

ARC_M = np.linspace(0.1, 0.9, 25)
PHASE = (np.arange(60) + 0.5) / 60


def swing(phase, arc=ARC_M, back=True):
    """Return a cable (P, G, 3) whose bend opens and closes, and that ends where it began if it swings back."""
    opened = np.sin(np.pi * phase) ** 2 if back else phase**2
    radius = (0.4 - 0.2 * opened)[:, None]
    angle = arc / radius
    side = 0.1 * np.sin(2 * np.pi * phase)[:, None] * arc if back else 0.1 * phase[:, None] * arc
    return np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), side], axis=2)


MOTION = swing(PHASE)


def test_a_motion_is_no_distance_from_itself():
    same = compare_motions(MOTION, MOTION, ARC_M)
    assert same.e_m == 0.0
    assert same.compared == 1.0


@given(shift=st.tuples(*[st.floats(-0.1, 0.1)] * 3))
def test_a_shift_is_its_own_length_and_its_parts_are_the_coordinates(shift):
    moved = compare_motions(MOTION, MOTION + np.array(shift), ARC_M)
    assert moved.e_m == pytest.approx(np.linalg.norm(shift), abs=1e-12)
    assert moved.e2_m2 == pytest.approx(np.square(shift).sum(), abs=1e-12)
    np.testing.assert_allclose(moved.coordinate_m, np.abs(shift), atol=1e-12)
    np.testing.assert_allclose(moved.distance_m, np.linalg.norm(shift), atol=1e-12)


def test_it_is_an_integral_and_not_a_mean_over_uneven_places():
    uneven = np.concatenate([np.linspace(0, 0.1, 50), np.linspace(0.12, 1, 10)])
    other = np.zeros((3, 60, 3))
    other[:, uneven <= 0.1, 0] = 1.0
    assert compare_motions(other, np.zeros_like(other), uneven).e2_m2 == pytest.approx(0.11, abs=1e-9)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_order_does_not_matter_nor_the_frame_of_reference(seed):
    rng = np.random.default_rng(seed)
    other = MOTION + rng.normal(0, 0.01, MOTION.shape)
    turn = RigidTransform(Rotation.random(random_state=seed).as_matrix(), rng.normal(0, 1, 3))
    one, swapped = compare_motions(MOTION, other, ARC_M), compare_motions(other, MOTION, ARC_M)
    moved = compare_motions(turn.apply(MOTION), turn.apply(other), ARC_M)
    assert one.e_m == pytest.approx(swapped.e_m)
    assert one.e_m == pytest.approx(moved.e_m)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_alignment_in_space_takes_a_rigid_motion_out(seed):
    turn = RigidTransform(Rotation.random(random_state=seed).as_matrix(), np.array([0.3, -1.0, 2.0]))
    moved = turn.apply(MOTION)
    moved[3, 5:9] = np.nan
    back = align_in_space(MOTION, moved).apply(moved)
    assert compare_motions(MOTION, back, ARC_M).e_m < 1e-12


@settings(max_examples=15, deadline=None)
@given(late=st.floats(-0.45, 0.45))
def test_alignment_in_time_finds_how_late_a_cycle_is(late):
    found = align_in_time(MOTION, swing(PHASE - late), repeats=True)
    assert found == pytest.approx(late, abs=2e-3)
    back = shift_motion(swing(PHASE - late), found, repeats=True)
    assert compare_motions(MOTION, back, ARC_M).e_m < 1e-3


@pytest.mark.parametrize("late", [-0.2, 0.013, 0.3])
def test_a_motion_that_does_not_repeat_is_compared_where_it_overlaps(late):
    one, other = swing(PHASE, back=False), swing(PHASE - late, back=False)
    found = align_in_time(one, other, repeats=False)
    assert found == pytest.approx(late, abs=2e-3)
    compared = compare_motions(one, shift_motion(other, found, repeats=False), ARC_M)
    assert compared.compared == pytest.approx(1 - abs(late), abs=0.04)
    assert compared.e_m < 1e-3


def test_both_alignments_work_together():
    turn = RigidTransform(Rotation.from_euler("xyz", [0.4, -1.0, 0.2]).as_matrix(), np.array([0.3, -1.0, 2.0]))
    late = align_in_time(MOTION, turn.apply(swing(PHASE - 0.11)), repeats=True, in_space=True)
    assert late == pytest.approx(0.11, abs=2e-3)


def test_where_one_is_not_seen_nothing_is_compared():
    hidden = MOTION.copy()
    hidden[:30] = np.nan
    half = compare_motions(hidden, MOTION + 0.005, ARC_M)
    assert half.compared == 0.5
    np.testing.assert_allclose(half.coordinate_m, 0.005)
    opposite = np.flip(hidden, 0)
    with pytest.raises(AnalysisError, match="no phase and no place on the cable in common"):
        compare_motions(hidden, opposite, ARC_M)
    with pytest.raises(AnalysisError, match="no phase and no place on the cable in common"):
        align_in_space(hidden, opposite)


def frames_of(n_cycles, per_cycle, offset):
    """Return frames of cycles in which the cable swings, taken at phases that no grid has."""
    phase = np.tile((np.arange(per_cycle) + offset) / per_cycle, n_cycles)
    cycle = np.repeat(np.arange(n_cycles), per_cycle)
    time_ns = (np.arange(len(phase)) * 1e7).astype(np.int64)
    return swing(phase, np.linspace(0.1, 0.9, 6)).astype(np.float32), cycle, phase, time_ns, np.ones(len(phase), bool)


def test_the_usual_cycle_does_not_depend_on_when_its_frames_were_taken():
    truth = swing(PHASE, np.linspace(0.1, 0.9, 6))
    inside = (PHASE > 0.02) & (PHASE < 0.98)
    for offset in (0.1, 0.7):
        usual = median_cycle(*frames_of(3, 150, offset), PHASE)
        np.testing.assert_allclose(usual[inside], truth[inside], atol=2e-4)


def test_one_wild_cycle_of_many_changes_nothing_and_untrusted_frames_neither():
    position, cycle, phase, time_ns, trusted = frames_of(5, 150, 0.5)
    quiet = median_cycle(position, cycle, phase, time_ns, trusted, PHASE)
    position[cycle == 2] += 0.5
    np.testing.assert_allclose(median_cycle(position, cycle, phase, time_ns, trusted, PHASE), quiet, atol=1e-6)
    position[cycle == 1] += 0.5
    trusted[cycle == 1] = False
    np.testing.assert_allclose(median_cycle(position, cycle, phase, time_ns, trusted, PHASE), quiet, atol=0.02)


def test_nothing_is_made_up_in_a_gap_or_without_frames():
    position, cycle, phase, time_ns, trusted = frames_of(1, 150, 0.5)
    gone = (phase < 0.4) | (phase > 0.5)
    left = median_cycle(position[gone], cycle[gone], phase[gone], time_ns[gone], trusted[gone], PHASE)
    assert np.isnan(left[(PHASE > 0.41) & (PHASE < 0.49)]).all()
    assert np.isfinite(left[(PHASE > 0.05) & (PHASE < 0.39)]).all()
    assert np.isnan(median_cycle(position, cycle - 1, phase, time_ns, trusted, PHASE)).all()
    assert np.isnan(median_cycle(position[:1], cycle[:1], phase[:1], time_ns[:1], trusted[:1], PHASE)).all()


def test_motions_with_other_markers_are_drawn_at_the_same_places():
    few, many = np.linspace(0.05, 0.95, 9), np.linspace(0.0, 1.0, 14)
    one, other = draw_motion(swing(PHASE, few), few, ARC_M), draw_motion(swing(PHASE, many), many, ARC_M)
    assert compare_motions(one, other, ARC_M).e_m < 1e-3
