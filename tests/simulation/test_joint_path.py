import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.simulation.kinematics import flange_poses, flange_transforms
from bench.simulation.path import BASE_JOINT_RAD, JointPath, Swing, place_at_phase, rate_at_phase

PLACES = np.linspace(0.0, 1.0, 257)


@pytest.fixture(scope="module", params=[0.25, 1.0])
def path(request):
    return JointPath(request.param)


def joints(path):
    return np.array([path.at(place).q_rad for place in PLACES])


def test_the_time_law_begins_and_ends_at_rest():
    assert [place_at_phase(0.0), place_at_phase(0.5), place_at_phase(1.0)] == [0.0, 0.5, 1.0]
    assert [rate_at_phase(0.0), rate_at_phase(0.5), rate_at_phase(1.0)] == [0.0, 1.875, 0.0]


def test_the_rate_is_the_derivative_of_the_place():
    phases = np.linspace(0.01, 0.99, 50)
    step = 1e-6
    numeric = (place_at_phase(phases + step) - place_at_phase(phases - step)) / (2 * step)
    np.testing.assert_allclose(rate_at_phase(phases), numeric, rtol=1e-6, atol=1e-9)


def test_the_path_is_closed(path):
    np.testing.assert_allclose(path.at(1.0).q_rad, path.at(0.0).q_rad, atol=1e-12)


def test_only_shoulder_elbow_and_wrist_1_move(path):
    moved = np.ptp(joints(path), axis=0)
    np.testing.assert_allclose(moved[[0, 4, 5]], 0.0, atol=1e-12)
    assert np.all(moved[1:4] > 0.05)


def test_the_elbow_stays_above_the_shoulder(path):
    assert np.all(np.sin(joints(path)[:, 1]) < 0.0)


def test_the_flange_and_its_tool_axis_stay_in_one_vertical_plane(path):
    transforms = flange_transforms(joints(path))
    normal = np.array([np.sin(BASE_JOINT_RAD), -np.cos(BASE_JOINT_RAD), 0.0])
    assert np.ptp(transforms[:, :3, 3] @ normal) < 1e-9
    np.testing.assert_allclose(transforms[:, :3, 2] @ normal, 0.0, atol=1e-9)


def test_the_flange_is_where_the_plane_coordinates_say(path):
    transforms = flange_transforms(joints(path))
    along = np.array([np.cos(BASE_JOINT_RAD), np.sin(BASE_JOINT_RAD), 0.0])
    x, y, tool = path.flange_in_plane(PLACES).T
    np.testing.assert_allclose(np.stack([transforms[:, :3, 3] @ along, transforms[:, 2, 3]]), [x, y], atol=1e-7)
    np.testing.assert_allclose(transforms[:, 2, 2], np.sin(tool), atol=1e-6)


def test_pose_and_joints_agree_at_places_between_the_table_rows(path):
    for place in np.random.default_rng(5).random(50):
        point = path.at(place)
        np.testing.assert_allclose(point.pose, flange_poses(np.array(point.q_rad)), atol=1e-6)


def test_the_derivatives_are_those_of_the_values(path):
    step = 1e-3
    for place in (0.1, 0.33, 0.8):
        before, here, after = path.at(place - step), path.at(place), path.at(place + step)
        q_rate = (np.array(after.q_rad) - before.q_rad) / (2 * step)
        pose_rate = (np.array(after.pose) - before.pose) / (2 * step)
        np.testing.assert_allclose(here.q_rate, q_rate, atol=1e-3)
        np.testing.assert_allclose(here.pose_rate[:3], pose_rate[:3], atol=1e-4)


def test_the_turning_speed_is_about_the_normal_of_the_plane(path):
    place, step = 0.4, 1e-4
    turns = flange_transforms(np.array([path.at(place - step).q_rad, path.at(place + step).q_rad]))[:, :3, :3]
    skew = (turns[1] - turns[0]) / (2 * step) @ ((turns[0] + turns[1]) / 2).T
    omega = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    np.testing.assert_allclose(path.at(place).pose_rate[3:], omega, rtol=1e-3, atol=1e-9)


def test_the_rotation_vector_never_jumps(path):
    poses = np.array([path.at(place).pose for place in PLACES])
    assert np.abs(np.diff(poses, axis=0)).max() < 0.03
    assert np.linalg.norm(poses[:, 3:], axis=1).max() < np.pi


SWING = Swing((-1.1, -0.2), 0.25)


@pytest.fixture(scope="module")
def swinging():
    return JointPath(1.0, SWING)


def test_a_calibration_begins_and_ends_where_the_path_does(swinging, path):
    for place in (0.0, 1.0):
        np.testing.assert_allclose(swinging.at(place).q_rad, JointPath(1.0).at(0.0).q_rad, atol=1e-9)


def test_a_calibration_turns_the_flange_about_three_axes_and_moves_it_in_space(swinging):
    turns = flange_transforms(joints(swinging))
    rotations = Rotation.from_matrix(turns[0, :3, :3].T @ turns[:, :3, :3]).as_rotvec()
    spread = np.linalg.svd(rotations - rotations.mean(axis=0), compute_uv=False) / np.sqrt(len(PLACES))
    assert spread.min() > 0.2
    positions = turns[:, :3, 3] - turns[:, :3, 3].mean(axis=0)
    assert np.linalg.svd(positions, compute_uv=False).min() / np.sqrt(len(PLACES)) > 0.03


def test_a_swinging_flange_keeps_its_height_and_its_distance_from_the_axis(swinging):
    plain, swung = (flange_transforms(joints(path))[:, :3, 3] for path in (JointPath(1.0), swinging))
    np.testing.assert_allclose(swung[:, 2], plain[:, 2], atol=1e-6)
    radii = [np.linalg.norm(points[:, :2] - SWING.pivot_m, axis=1) for points in (plain, swung)]
    np.testing.assert_allclose(*radii, atol=1e-6)


def test_a_calibrations_pose_and_derivatives_agree_with_its_joints(swinging):
    step = 1e-4
    for place in (0.07, 0.35, 0.81):
        point = swinging.at(place)
        np.testing.assert_allclose(point.pose, flange_poses(np.array(point.q_rad)), atol=5e-6)
        before, after = swinging.at(place - step), swinging.at(place + step)
        np.testing.assert_allclose(point.q_rate, (np.array(after.q_rad) - before.q_rad) / (2 * step), atol=0.02)
        first, last = (Rotation.from_rotvec(p.pose[3:]) for p in (before, after))
        np.testing.assert_allclose(point.pose_rate[3:], (last * first.inv()).as_rotvec() / (2 * step), atol=0.02)


def test_a_calibrations_rotation_vector_never_jumps(swinging):
    poses = np.array([swinging.at(place).pose for place in PLACES])
    assert np.abs(np.diff(poses, axis=0)).max() < 0.1
    assert np.linalg.norm(poses[:, 3:], axis=1).max() < np.pi
