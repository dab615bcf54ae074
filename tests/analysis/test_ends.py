"""The cable's end: where its holder puts it, how well, and which way the clamp points."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.analysis import ClampDirection, RigidTransform, estimate_clamp_direction, place_end
from bench.errors import AnalysisError

DIRECTION = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])


def bend_beside_clamp(rng: np.random.Generator, bends_per_m: np.ndarray, noise_m: float = 2e-4) -> np.ndarray:
    """Return markers (F, 3, 3) beside a clamp whose cable bends in planes of its own, less with each step outwards."""
    arc = np.linspace(0, 0.32, 129)
    turning = 0.05 * np.arange(len(bends_per_m))
    side = np.cross(DIRECTION, np.stack([np.cos(turning), np.sin(turning), 0 * turning], axis=1))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    angle = np.cumsum(bends_per_m[:, None] * np.exp(-arc / 0.15), axis=1) * arc[1]
    way = np.cos(angle)[:, :, None] * DIRECTION + np.sin(angle)[:, :, None] * side[:, None]
    nodes = np.cumsum((way[:, 1:] + way[:, :-1]) / 2, axis=1) * arc[1]
    return nodes[:, [23, 71, 119]] + rng.normal(scale=noise_m, size=(len(bends_per_m), 3, 3))


def test_the_clamps_direction_is_what_is_left_of_a_straight_cable() -> None:
    rng = np.random.default_rng(1)
    found = estimate_clamp_direction(bend_beside_clamp(rng, 3 + 3 * np.sin(0.03 * np.arange(500))))
    away = np.arccos(found.direction @ DIRECTION)
    assert away < 4 * found.sigma_rad
    assert away < np.deg2rad(1)
    assert found.sigma_rad < np.deg2rad(2)


def test_a_bend_that_never_changes_does_not_tell_the_direction() -> None:
    rng = np.random.default_rng(2)
    always = np.tile(bend_beside_clamp(rng, np.full(1, 5.0), 0.0), (200, 1, 1))
    with pytest.raises(AnalysisError, match="alike in all frames"):
        estimate_clamp_direction(always + rng.normal(scale=2e-4, size=always.shape))


def test_too_few_frames_do_not_tell_the_direction() -> None:
    with pytest.raises(AnalysisError, match="known in 0 frames"):
        estimate_clamp_direction(np.full((100, 3, 3), np.nan))


def test_the_end_is_where_the_pose_puts_it_and_no_better_known_than_the_map() -> None:
    rng = np.random.default_rng(3)
    turn = Rotation.random(50, rng=rng)
    place = rng.uniform(-1, 1, (50, 3))
    place[7] = np.nan
    lab_turn, shift, clamp_m = Rotation.random(rng=rng), rng.normal(size=3), np.array([0.01, 0.0, 0.12])
    root = rng.normal(scale=1e-3, size=(6, 6))
    lab, clamp = RigidTransform(lab_turn.as_matrix(), shift), ClampDirection(DIRECTION, 0.01)
    end = place_end(turn.as_matrix(), place, clamp_m, clamp, lab, root @ root.T)
    expected = lab_turn.apply(place + turn.apply(clamp_m)) + shift
    assert end.position_m == pytest.approx(expected, nan_ok=True)
    assert np.isnan(end.position_sigma_m[7])
    steps = (root @ rng.normal(size=(6, 4000))).T
    moved = np.array([lab.changed_by(step).apply(place[3] + turn[3].apply(clamp_m)) for step in steps])
    worst = np.sqrt(np.linalg.eigvalsh(np.cov(moved.T))[-1])
    assert end.position_sigma_m[3] == pytest.approx(worst, rel=0.1)
    assert end.tangent[3] == pytest.approx(lab_turn.apply(turn[3].apply(DIRECTION)))
    assert 0.01 < end.tangent_sigma_rad[3] < 0.02


def test_without_a_direction_there_is_no_tangent() -> None:
    pose = np.eye(3)[None], np.zeros((1, 3))
    end = place_end(*pose, np.zeros(3), None, RigidTransform(np.eye(3), np.zeros(3)), np.zeros((6, 6)))
    assert np.isnan(end.tangent).all()
    assert np.isnan(end.tangent_sigma_rad).all()
    assert end.position_m.tolist() == [[0, 0, 0]]
