"""Lab frame, flange body and time offset come out of what both devices saw, with honest standard deviations."""

from dataclasses import replace

import numpy as np
import pytest
from flange_examples import (
    BODY_POINT_M,
    BODY_TURN,
    LAB_SHIFT_M,
    LAB_TURN,
    OFFSET_S,
    FlangeScene,
    make_flange,
    turn_about_one_axis,
    turn_about_three_axes,
)
from scipy.spatial.transform import Rotation

from bench.analysis import FlangeSightings, HandEye, PoseTrack, estimate_motion_offset, fit_hand_eye
from bench.errors import AnalysisError


def errors_of(found: HandEye) -> np.ndarray:
    """Return what is to be added to each of the thirteen unknowns."""
    return np.concatenate(
        [
            (LAB_TURN * Rotation.from_matrix(found.lab_from_base.rotation).inv()).as_rotvec(),
            LAB_SHIFT_M - found.lab_from_base.shift_m,
            (BODY_TURN * Rotation.from_matrix(found.tcp_from_body.rotation).inv()).as_rotvec(),
            BODY_POINT_M - found.tcp_from_body.shift_m,
            [OFFSET_S - found.offset_s],
        ]
    )


def calibrate(scene: FlangeScene) -> HandEye:
    return fit_hand_eye(scene.track, scene.seen, estimate_motion_offset(scene.track, scene.seen).offset_s)


def test_everything_is_found_within_its_standard_deviation_from_an_unknown_start() -> None:
    scores = np.array(
        [errors_of(f) / f.sigma for f in (calibrate(make_flange(np.random.default_rng(s))) for s in range(25))]
    )
    # the mean of 325 squares of standard normal numbers has a standard deviation of 0.08
    assert 0.75 < np.mean(scores**2) < 1.3
    assert np.abs(scores).max() < 4.5


def test_with_noise_of_a_fifth_of_a_millimetre_the_frames_are_good_to_a_fraction_of_it() -> None:
    error = errors_of(calibrate(make_flange(np.random.default_rng(1), n_frames=1500)))
    assert np.linalg.norm(error[3:6]) < 3e-4
    assert np.linalg.norm(error[:3]) < np.deg2rad(0.1)
    assert abs(error[12]) < 3e-4


def test_wrong_poses_are_left_out() -> None:
    rng = np.random.default_rng(2)
    scene = make_flange(rng)
    wrong = rng.random(400) < 0.2
    scene.seen.position_m[wrong] += rng.normal(scale=0.05, size=(wrong.sum(), 3))
    assert scene.seen.quaternion_xyzw is not None
    scene.seen.quaternion_xyzw[wrong] = Rotation.random(int(wrong.sum()), rng=rng).as_quat()
    found = calibrate(scene)
    assert not (found.used & wrong).any()
    assert found.used.sum() > 0.97 * (~wrong).sum()
    assert np.abs(errors_of(found) / found.sigma).max() < 4.5


def test_frames_without_the_body_are_not_compared() -> None:
    scene = make_flange(np.random.default_rng(3))
    scene.seen.position_m[100:150] = np.nan
    found = calibrate(scene)
    assert np.isnan(found.residual_m[100:150]).all()
    assert np.isfinite(found.residual_m[200:300]).all()
    assert not found.used[100:150].any()


def test_errors_that_last_make_the_standard_deviation_larger() -> None:
    rng = np.random.default_rng(4)
    slow = np.repeat(rng.normal(scale=5e-4, size=(40, 3)), 10, axis=0)
    scene = make_flange(rng)
    alone = calibrate(scene)
    together = calibrate(replace(scene, seen=replace(scene.seen, position_m=scene.seen.position_m + slow)))
    assert alone.correlation < 1.5
    assert together.correlation > 3
    assert (together.sigma > alone.sigma).all()
    assert np.abs(errors_of(together) / together.sigma).max() < 4.5


def test_a_single_marker_gives_the_lab_frame_and_its_own_place() -> None:
    scene = make_flange(np.random.default_rng(5))
    found = fit_hand_eye(scene.track, replace(scene.seen, quaternion_xyzw=None))
    error, told = errors_of(found), [0, 1, 2, 3, 4, 5, 9, 10, 11, 12]
    assert np.abs(error[told] / found.sigma[told]).max() < 4.5
    assert np.isnan(found.sigma[6:9]).all()
    assert np.isnan(found.residual_rad).all()


def test_a_motion_that_turns_about_one_axis_is_refused_with_what_to_do() -> None:
    scene = make_flange(np.random.default_rng(6), motion=turn_about_one_axis)
    with pytest.raises(AnalysisError, match=r"standard deviation .*three axes"):
        calibrate(scene)


def test_a_flange_that_stands_still_is_refused() -> None:
    scene = make_flange(
        np.random.default_rng(7), motion=lambda time_s: np.tile([0.4, 0, 0.5, 0, 1, 0], (len(time_s), 1))
    )
    with pytest.raises(AnalysisError, match="The flange moved by"):
        fit_hand_eye(scene.track, scene.seen)


def test_poses_at_rest_tell_the_space_but_no_time() -> None:
    scene = make_flange(
        np.random.default_rng(9), n_frames=2000, motion=lambda time_s: turn_about_three_axes(7.3 * np.floor(time_s))
    )
    moving = np.abs((scene.seen.time_s + 0.5) % 1.0 - 0.5) < 0.3
    scene.seen.position_m[moving] = np.nan
    with pytest.raises(AnalysisError, match="The time offset cannot be told"):
        fit_hand_eye(scene.track, scene.seen)


def test_too_few_poses_are_refused() -> None:
    scene = make_flange(np.random.default_rng(8))
    few = FlangeSightings(scene.seen.time_s[:12], scene.seen.position_m[:12], scene.seen.quaternion_xyzw[:12])
    with pytest.raises(AnalysisError, match="tracked in 12 frames"):
        fit_hand_eye(scene.track, few)


def test_a_robot_that_tells_no_pose_is_refused() -> None:
    with pytest.raises(AnalysisError, match="TCP pose is known in 0 samples"):
        PoseTrack(np.arange(10.0), np.full((10, 6), np.nan))


def test_nothing_is_interpolated_over_a_gap_of_the_robots_stream() -> None:
    time_s = np.concatenate([np.arange(0, 1, 0.01), np.arange(2, 3, 0.01)])
    track = PoseTrack(time_s, np.zeros((200, 6)))
    assert track.covers(np.array([-0.1, 0.5, 0.995, 1.5, 2.5, 3.1])).tolist() == [
        False,
        True,
        False,
        False,
        True,
        False,
    ]
