"""A rigid body's markers are found by its pose, and its centre of gravity from them."""

import numpy as np
from cable_examples import make_rotation, make_scene, swing_cable
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis import bridge_poses, centre_of_labeled, match_body

BODY = np.array([[-0.0375, -0.002, 0.026], [0.0375, -0.004, 0.011], [0.0025, 0.011, -0.044], [-0.0025, -0.004, 0.006]])


def make_poses(rng: np.random.Generator, n_frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    position = rng.uniform(2.0, 3.0, (n_frames, 3))
    turned = [make_rotation(rng) for _ in range(n_frames)]
    quaternion = np.array([q for _, q in turned])
    markers = position[:, None] + np.array([BODY @ matrix.T for matrix, _ in turned])
    return position, quaternion, markers


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_a_bodys_markers_are_told_from_the_cables_in_every_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    position, quaternion, markers = make_poses(rng, 25)
    scene = make_scene(rng, swing_cable(25), markers, noise_m=2e-4)
    found = match_body(scene.points_m, scene.offsets, position, quaternion * rng.uniform(0.5, 2), BODY)
    own = (scene.offsets[:-1, None] + scene.extra_source).ravel()
    assert np.flatnonzero(found.is_body).tolist() == sorted(own.tolist())
    assert np.abs(found.centre_m - markers.mean(axis=1)).max() < 1e-3


def test_where_one_of_its_markers_is_hidden_the_centre_comes_from_the_pose() -> None:
    rng = np.random.default_rng(1)
    position, quaternion, markers = make_poses(rng, 10)
    shown = markers.copy()
    shown[:, 2] = np.nan
    scene = make_scene(rng, swing_cable(10), shown, noise_m=2e-4)
    found = match_body(scene.points_m, scene.offsets, position, quaternion, BODY)
    assert found.is_body.sum() == 30
    assert np.abs(found.centre_m - markers.mean(axis=1)).max() < 1e-6


def test_a_body_that_is_not_tracked_has_no_centre_and_no_markers() -> None:
    rng = np.random.default_rng(2)
    position, quaternion, markers = make_poses(rng, 8)
    position[3] = np.nan
    quaternion[5] = 0.0
    scene = make_scene(rng, swing_cable(8), markers)
    found = match_body(scene.points_m, scene.offsets, position, quaternion, BODY)
    assert np.flatnonzero(np.isnan(found.centre_m[:, 0])).tolist() == [3, 5]
    assert found.is_body.sum() == 6 * 4


def test_labels_give_the_centre_and_the_pose_where_some_are_hidden() -> None:
    rng = np.random.default_rng(3)
    _, _, markers = make_poses(rng, 6)
    shown = markers.copy()
    shown[4, 0] = np.nan
    scene = make_scene(rng, swing_cable(6), shown)
    own = np.zeros(len(scene.points_m), dtype=bool)
    rows = scene.offsets[:-1, None] + scene.extra_source
    own[rows[scene.extra_source >= 0]] = True
    fallback = np.arange(18.0).reshape(6, 3)
    centre = centre_of_labeled(scene.points_m, scene.offsets, own, fallback)
    assert np.array_equal(centre[4], fallback[4])
    assert np.allclose(np.delete(centre, 4, axis=0), np.delete(markers.mean(axis=1), 4, axis=0), atol=1e-6)
    nobody = centre_of_labeled(scene.points_m, scene.offsets, ~scene.usable, fallback)
    assert np.array_equal(nobody, fallback)


def test_a_body_that_moves_and_is_lost_for_a_moment_keeps_its_markers_and_not_for_longer() -> None:
    rng, n_frames = np.random.default_rng(4), 60
    time_ns, angle = np.arange(n_frames) * 10_000_000, np.linspace(0, 1.2, n_frames)
    quaternion = np.stack([0 * angle, 0 * angle, np.sin(angle / 2), np.cos(angle / 2)], axis=1)
    quaternion *= rng.choice([-1.0, 1.0], n_frames)[:, None]
    position = 2.0 + 0.3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    c, s, z = np.cos(angle), np.sin(angle), 0 * angle
    turn = np.moveaxis(np.array([[c, -s, z], [s, c, z], [z, z, z + 1]]), 2, 0)
    scene = make_scene(rng, swing_cable(n_frames), position[:, None] + np.einsum("fij,mj->fmi", turn, BODY), 0.0, 1e-4)
    lost = np.isin(np.arange(n_frames), [0, 10, 11, 12, 13, *range(30, 45), 59])
    position[lost], quaternion[lost] = np.nan, np.nan
    bridged = bridge_poses(time_ns, position, quaternion)
    assert np.flatnonzero(np.isnan(bridged[0][:, 0])).tolist() == [0, *range(30, 45), 59]
    found = match_body(scene.points_m, scene.offsets, *bridged, BODY)
    rows = scene.offsets[:-1, None] + scene.extra_source
    assert found.is_body[rows[np.isfinite(bridged[0][:, 0])]].all()
    assert found.is_body.sum() == 4 * (n_frames - 17)
