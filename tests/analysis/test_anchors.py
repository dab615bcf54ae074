"""The static marker is found among everything that stands still, and taken out of the cable's points."""

import numpy as np
import pytest
from cable_examples import ARC_LENGTH_M, make_scene, swing_cable
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import SortSettings, exclude_near, find_static_marker, locate_static_marker, spread_frames
from bench.errors import AnalysisError

CABLE = SortSettings(ARC_LENGTH_M, 0.02, 0.25, 0.004)
POLE = np.zeros(3)


def still(place: tuple[float, float, float], n_frames: int) -> np.ndarray:
    return np.broadcast_to(np.array(place, dtype=float), (n_frames, 1, 3))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_the_pole_is_found_and_not_a_permanent_reflection(seed: int) -> None:
    rng = np.random.default_rng(seed)
    reflection = still(tuple(rng.uniform(0.5, 1.5, 3).tolist()), 100)
    further = np.concatenate([still((0, 0, 0), 100), reflection], axis=1)
    scene = make_scene(rng, swing_cable(100), further, 0.05, 2e-4)
    found = find_static_marker(scene.points_m, scene.offsets, scene.usable, spread_frames(0, 100), CABLE)
    assert np.linalg.norm(found.position_m - POLE) < 5e-4
    assert found.presence > 0.9


def test_at_rest_where_everything_stands_still_the_chain_decides() -> None:
    at_rest = np.broadcast_to(swing_cable(1), (50, len(ARC_LENGTH_M), 3))
    scene = make_scene(np.random.default_rng(1), at_rest, still((0, 0, 0), 50), noise_m=1e-4)
    found = find_static_marker(scene.points_m, scene.offsets, scene.usable, spread_frames(0, 50), CABLE)
    assert np.linalg.norm(found.position_m - POLE) < 5e-4
    assert found.chain_fraction == 1.0


def test_a_pole_hidden_in_some_frames_is_still_found() -> None:
    pole = still((0, 0, 0), 200).copy()
    pole[np.random.default_rng(2).random(200) < 0.1] = np.nan
    scene = make_scene(np.random.default_rng(2), swing_cable(200), pole, noise_m=2e-4)
    found = find_static_marker(scene.points_m, scene.offsets, scene.usable, spread_frames(0, 200), CABLE)
    assert np.linalg.norm(found.position_m - POLE) < 5e-4


def test_where_nothing_stands_still_the_user_is_told_what_to_do() -> None:
    scene = make_scene(np.random.default_rng(3), swing_cable(100) + np.linspace(0, 1, 100)[:, None, None])
    with pytest.raises(AnalysisError, match=r"No static marker was found.*position_m"):
        find_static_marker(scene.points_m, scene.offsets, scene.usable, spread_frames(0, 100), CABLE)


def test_a_position_measured_by_hand_is_refined_by_the_marker_that_is_there() -> None:
    scene = make_scene(np.random.default_rng(4), swing_cable(60), still((0, 0, 0), 60), noise_m=1e-4)
    frames = spread_frames(0, 60)
    near = locate_static_marker(scene.points_m, scene.offsets, scene.usable, frames, np.array([0.01, 0, 0.005]))
    assert np.linalg.norm(near.position_m - POLE) < 2e-4
    assert near.presence == 1.0
    far = locate_static_marker(scene.points_m, scene.offsets, scene.usable, frames, np.array([5.0, 5.0, 5.0]))
    assert far.position_m.tolist() == [5.0, 5.0, 5.0]
    assert far.presence == 0.0


def test_the_static_marker_itself_is_no_marker_of_the_cable() -> None:
    scene = make_scene(np.random.default_rng(5), swing_cable(60), still((0, 0, 0), 60), noise_m=1e-4)
    usable = exclude_near(scene.points_m, scene.offsets, scene.usable, POLE)
    poles = scene.offsets[:-1] + scene.extra_source[:, 0]
    assert not usable[poles].any()
    assert usable.sum() == len(usable) - 60


def test_frames_to_scan_are_spread_over_the_whole_stretch() -> None:
    frames = spread_frames(100, 1_100, 10)
    assert (frames[0], frames[-1], len(frames)) == (100, 1_099, 10)
    assert spread_frames(3, 5, 10).tolist() == [3, 4]
    assert len(spread_frames(4, 4)) == 0
