"""A robot's flange that turns about three axes, and what a tracker sees of a body on it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from bench.analysis import FlangeSightings, PoseTrack

LAB_TURN = Rotation.from_rotvec([1.2, -0.4, 2.0])
LAB_SHIFT_M = np.array([1.3, 1.6, -0.5])
BODY_TURN = Rotation.from_rotvec([-0.4, 0.3, 1.0])
BODY_POINT_M = np.array([0.03, -0.02, 0.08])
OFFSET_S = -0.0046


@dataclass(frozen=True)
class FlangeScene:
    track: PoseTrack
    seen: FlangeSightings


def turn_about_three_axes(time_s: np.ndarray) -> np.ndarray:
    """Return poses (n, 6) in the base frame, at speeds that change all the time."""
    place = np.stack(
        [
            0.4 + 0.12 * np.sin(2 * time_s + 0.3 * np.sin(time_s)),
            0.2 + 0.1 * np.sin(1.3 * time_s + 1),
            0.5 + 0.1 * np.sin(1.7 * time_s + 2),
        ],
        axis=1,
    )
    turn = np.stack(
        [0.5 * np.sin(1.1 * time_s), 1.0 + 0.5 * np.sin(0.9 * time_s + 0.5), 0.6 * np.sin(1.5 * time_s + 2)], axis=1
    )
    return np.hstack([place, turn])


def turn_about_one_axis(time_s: np.ndarray) -> np.ndarray:
    """Return poses in one plane, which turn about its normal only."""
    poses = turn_about_three_axes(time_s)
    poses[:, 2] = 0.5
    poses[:, 3:] = np.stack([0 * time_s, 0 * time_s, 0.5 * np.sin(0.9 * time_s)], axis=1)
    return poses


def make_flange(
    rng: np.random.Generator,
    n_frames: int = 400,
    motion=turn_about_three_axes,
    noise_m: float = 2e-4,
    noise_rad: float = 3e-3,
    rate_hz: float = 50.0,
) -> FlangeScene:
    robot_s = np.arange(-1.0, n_frames / rate_hz + 1.0, 1 / 125)
    true_s = np.arange(n_frames) / rate_hz
    pose = motion(true_s)
    turn = Rotation.from_rotvec(pose[:, 3:])
    place = LAB_TURN.apply(pose[:, :3] + turn.apply(BODY_POINT_M)) + LAB_SHIFT_M
    shaken = Rotation.from_rotvec(rng.normal(scale=noise_rad, size=(n_frames, 3)))
    quaternion = (LAB_TURN * turn * BODY_TURN * shaken).as_quat()
    seen = FlangeSightings(true_s - OFFSET_S, place + rng.normal(scale=noise_m, size=(n_frames, 3)), quaternion)
    return FlangeScene(PoseTrack(robot_s, motion(robot_s)), seen)
