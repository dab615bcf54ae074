import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.simulation.kinematics import flange_poses, flange_transforms, jacobians, solve_joints


def test_the_stretched_arm_is_where_the_published_parameters_put_it():
    pose = flange_poses(np.zeros(6))
    np.testing.assert_allclose(pose[:3], [-0.8172, -0.2329, 0.0628], atol=1e-12)
    np.testing.assert_allclose(pose[3:], [np.pi / 2, 0.0, 0.0], atol=1e-12)


def test_the_upright_arm_is_as_high_as_its_links_are_long():
    pose = flange_poses(np.radians([0.0, -90.0, 0.0, -90.0, 0.0, 0.0]))
    np.testing.assert_allclose(pose[:3], [0.0, -0.2329, 0.1625 + 0.425 + 0.3922 + 0.0997], atol=1e-12)


def test_the_base_joint_turns_the_pose_about_the_vertical():
    q = np.radians([0.0, -70.0, 80.0, -40.0, 30.0, 20.0])
    turned = q + np.array([0.7, 0, 0, 0, 0, 0])
    turn = Rotation.from_euler("z", 0.7)
    np.testing.assert_allclose(flange_poses(turned)[:3], turn.apply(flange_poses(q)[:3]), atol=1e-12)
    together = turn * Rotation.from_rotvec(flange_poses(q)[3:])
    np.testing.assert_allclose(Rotation.from_rotvec(flange_poses(turned)[3:]).as_matrix(), together.as_matrix())


def test_many_joints_give_what_each_of_them_gives():
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (2, 5, 6))
    poses = flange_poses(q)
    assert poses.shape == (2, 5, 6)
    np.testing.assert_allclose(poses[1, 3], flange_poses(q[1, 3]))


def test_every_pose_is_a_rotation_and_a_shift():
    transforms = flange_transforms(np.random.default_rng(4).uniform(-np.pi, np.pi, (20, 6)))
    turns = transforms[:, :3, :3]
    np.testing.assert_allclose(turns @ np.swapaxes(turns, 1, 2), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12)
    assert np.linalg.det(turns) == pytest.approx(np.ones(20))


def test_the_jacobian_is_the_derivative_of_the_pose():
    q = np.random.default_rng(6).uniform(-2.0, 2.0, (4, 6))
    step = 1e-6
    for joint in range(6):
        turned = q.copy()
        turned[:, joint] += step
        before, after = flange_transforms(q), flange_transforms(turned)
        shift = (after[:, :3, 3] - before[:, :3, 3]) / step
        turn = Rotation.from_matrix(after[:, :3, :3] @ np.swapaxes(before[:, :3, :3], 1, 2)).as_rotvec() / step
        np.testing.assert_allclose(jacobians(q)[:, :, joint], np.concatenate([shift, turn], axis=1), atol=1e-5)


def test_joints_are_found_for_poses_near_a_start():
    rng = np.random.default_rng(7)
    start = np.radians([[20.0, -70.0, 80.0, -40.0, -80.0, 20.0]]) + rng.uniform(-0.2, 0.2, (20, 6))
    wanted = start + rng.uniform(-0.1, 0.1, start.shape)
    found = solve_joints(flange_transforms(wanted), start)
    np.testing.assert_allclose(found, wanted, atol=1e-9)
