"""A marker is followed through noise, ghosts and gaps, and not taken for another."""

import numpy as np
from cable_examples import make_scene

from bench.analysis import follow_marker

TIME_S = np.arange(600) / 100.0


def fly(time_s: np.ndarray) -> np.ndarray:
    return np.stack([0.3 * np.sin(2 * time_s), 0.2 * np.cos(3 * time_s), 0.1 * time_s], axis=1)


def test_a_marker_is_followed_through_ghosts_and_other_markers() -> None:
    rng = np.random.default_rng(1)
    truth = fly(TIME_S)
    others = np.concatenate([truth[:, None] + [0.06, 0.0, 0.0], rng.uniform(-0.5, 0.5, (600, 3, 3))], axis=1)
    scene = make_scene(rng, truth[:, None], others, noise_m=2e-4)
    found = follow_marker(scene.points_m, scene.offsets, TIME_S, truth[0] + 0.01)
    wrong = np.linalg.norm(found - truth, axis=1) > 2e-3
    assert wrong.mean() < 0.02
    assert not wrong[-1]


def test_a_hidden_marker_is_unknown_and_found_again() -> None:
    rng = np.random.default_rng(2)
    shown = fly(TIME_S)[:, None].copy()
    shown[100:105] = np.nan
    scene = make_scene(rng, shown, np.full((600, 1, 3), 2.0))
    found = follow_marker(scene.points_m, scene.offsets, TIME_S, shown[0, 0])
    assert np.isnan(found[100:105]).all()
    assert np.abs(np.delete(found - shown[:, 0], np.arange(100, 105), axis=0)).max() < 1e-6


def test_frames_out_of_order_are_followed_in_time() -> None:
    order = np.random.default_rng(3).permutation(600)
    truth = fly(TIME_S)
    points, offsets = truth[order].astype(np.float32), np.arange(601)
    assert np.isfinite(follow_marker(points, offsets, TIME_S[order], truth[0])).all()


def test_nothing_near_the_start_is_nothing_followed() -> None:
    points = fly(TIME_S).astype(np.float32)
    assert np.isnan(follow_marker(points, np.arange(601), TIME_S, np.array([5.0, 5.0, 5.0]))).all()
