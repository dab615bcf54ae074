"""Where markers are missing, and whether they are hidden there or out of the cameras' view."""

from __future__ import annotations

import numpy as np
import pytest
from cable_examples import bend_cable
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import find_hidden_stretches

N_FRAMES = 300
PLACES = 0.12 * np.arange(1, 9)
ANCHOR = np.zeros((N_FRAMES, 3))
TRUSTED = np.zeros(N_FRAMES, dtype=bool)


def swing() -> np.ndarray:
    """Return a cable that bends up and down again once, and sways sideways, (F, k, 3)."""
    turn = np.linspace(0, 2 * np.pi, N_FRAMES)
    cable = bend_cable(0.6 + 0.2 * np.cos(turn), PLACES)
    cable[:, :, 2] += 0.3 * np.sin(turn)[:, None] * PLACES
    return cable


def test_a_marker_hidden_among_the_others_is_hidden() -> None:
    cable = swing()
    cable[100:130, 3] = np.nan
    (stretch,) = find_hidden_stretches(cable, ANCHOR, TRUSTED, 5)
    assert (stretch.marker_index, stretch.start, stretch.stop, stretch.n_frames) == (3, 100, 130, 30)
    np.testing.assert_array_equal(stretch.edge_m, cable[99, 3])
    assert np.linalg.norm(stretch.outside_m) < 0.01


@settings(deadline=None, max_examples=10)
@given(st.floats(-0.18, -0.05), st.booleans())
def test_markers_beyond_a_plane_have_left_the_view_through_it(limit_m: float, is_seen_from_below: bool) -> None:
    sign = -1.0 if is_seen_from_below else 1.0
    cable = swing() * np.array([1.0, 1.0, sign])
    true = cable.copy()
    cable[sign * cable[:, :, 2] < limit_m] = np.nan
    stretches = find_hidden_stretches(cable, ANCHOR, TRUSTED, 5)
    gone = np.isnan(cable[:, :, 0]).sum(axis=0) >= 5
    assert {stretch.marker_index for stretch in stretches} == set(np.flatnonzero(gone))
    far = [s for s in stretches if np.median(limit_m - sign * true[s.start : s.stop, s.marker_index, 2]) > 0.02]
    assert far
    for stretch in far:
        assert sign * stretch.outside_m[2] < -0.01


@pytest.mark.parametrize(("rows", "edge"), [(slice(0, 40), 40), (slice(260, N_FRAMES), 259)])
def test_a_marker_missing_at_an_end_of_the_cycle_is_told_by_the_one_side_that_is_known(rows: slice, edge: int) -> None:
    cable = swing()
    cable[rows, 4] = np.nan
    (stretch,) = find_hidden_stretches(cable, ANCHOR, TRUSTED, 5)
    np.testing.assert_array_equal(stretch.edge_m, cable[edge, 4])
    assert np.linalg.norm(stretch.outside_m) < 0.01


def test_a_point_that_takes_a_markers_place_as_it_goes_does_not_say_where_it_was() -> None:
    cable = swing()
    before = cable[98, 7].copy()
    cable[100:130, 7] = np.nan
    cable[99, 7] += np.array([0.0, 0.0, 0.3])
    trusted = np.ones(N_FRAMES, dtype=bool)
    trusted[99:130] = False
    (stretch,) = find_hidden_stretches(cable, ANCHOR, trusted, 5)
    np.testing.assert_array_equal(stretch.edge_m, before)
    assert (stretch.start, stretch.stop) == (100, 130)


def test_a_marker_that_is_never_seen_is_nowhere() -> None:
    cable = swing()
    cable[:, 7] = np.nan
    (stretch,) = find_hidden_stretches(cable, ANCHOR, TRUSTED, 5)
    assert stretch.n_frames == N_FRAMES
    assert np.isnan(stretch.edge_m).all()
    assert np.isnan(stretch.outside_m).all()


def test_single_misses_are_no_stretch() -> None:
    cable = swing()
    cable[::7, 2] = np.nan
    cable[50:54, 6] = np.nan
    assert find_hidden_stretches(cable, ANCHOR, TRUSTED, 5) == []


def test_a_cable_in_a_plane_and_without_anchor_has_a_space_too() -> None:
    cable = swing() * np.array([1.0, 1.0, 0.0])
    whole = cable.copy()
    cable[100:130, 3] = np.nan
    cable[cable[:, :, 1] > 0.5] = np.nan
    stretches = find_hidden_stretches(cable, None, TRUSTED, 5)
    hidden = [stretch for stretch in stretches if stretch.marker_index == 3]
    assert [np.linalg.norm(stretch.outside_m) < 0.01 for stretch in hidden] == [True]
    far = max(stretches, key=lambda stretch: float(np.linalg.norm(stretch.outside_m)))
    assert far.outside_m[1] > 0.01
    assert whole[far.start : far.stop, far.marker_index, 1].max() > 0.5


def test_a_cable_that_stands_still_and_one_that_nobody_sees_are_no_fault() -> None:
    still = np.repeat(swing()[:1], N_FRAMES, axis=0)
    still[100:120, 3] = np.nan
    (stretch,) = find_hidden_stretches(still, None, TRUSTED, 5)
    assert np.linalg.norm(stretch.outside_m) < 1e-6
    unseen = np.full((N_FRAMES, 2, 3), np.nan)
    assert len(find_hidden_stretches(unseen, None, TRUSTED, 5)) == 2
