"""Forward kinematics of a UR5e from its published Denavit-Hartenberg parameters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

__all__ = ["ALPHA_RAD", "A_M", "D_M", "flange_poses", "flange_transforms", "jacobians", "joint_frames", "solve_joints"]

Floats = npt.NDArray[np.float64]

# Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR5e
D_M = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
A_M = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
ALPHA_RAD = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)

N_NEWTON_STEPS = 12
"""Each step squares the error: from a start 0.3 rad off, six are enough for 1e-12."""


def flange_transforms(q_rad: Floats) -> Floats:
    """Return the flange's pose in the base frame as homogeneous matrices.

    Parameters
    ----------
    q_rad : (..., 6) float
        Joint angles, base to wrist 3.

    Returns
    -------
    (..., 4, 4) float
        Maps flange coordinates to base frame coordinates, metres.
    """
    return np.asarray(joint_frames(q_rad)[..., -1, :, :])


def joint_frames(q_rad: Floats) -> Floats:
    """Return the base and the end of each of the six links, (..., 7, 4, 4), as `flange_transforms` does the last."""
    q = np.asarray(q_rad, dtype=np.float64)
    frames = [np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))]
    for joint in range(6):
        frames.append(frames[-1] @ _link(q[..., joint], D_M[joint], A_M[joint], ALPHA_RAD[joint]))
    return np.stack(frames, axis=-3)


def jacobians(q_rad: Floats) -> Floats:
    """Return (..., 6, 6): the flange's speed and turning speed in the base frame per joint speed, m and rad per rad."""
    frames = joint_frames(q_rad)
    axes, origins = frames[..., :6, :3, 2], frames[..., :6, :3, 3]
    levers = frames[..., 6:, :3, 3] - origins
    return np.swapaxes(np.concatenate([np.cross(axes, levers), axes], axis=-1), -1, -2)


def solve_joints(transforms: Floats, start_rad: Floats) -> Floats:
    """Return joint angles that bring the flange to given poses, those nearest to a start, by Newton's method.

    Parameters
    ----------
    transforms : (n, 4, 4) float
        As `flange_transforms` gives them.
    start_rad : (n, 6) float
        Joint angles that are nearly right: within some 0.3 rad, and no singular pose between.

    Returns
    -------
    (n, 6) float
    """
    q = np.array(start_rad, dtype=np.float64)
    for _ in range(N_NEWTON_STEPS):
        here = flange_transforms(q)
        shift = transforms[:, :3, 3] - here[:, :3, 3]
        turn = Rotation.from_matrix(transforms[:, :3, :3] @ np.swapaxes(here[:, :3, :3], 1, 2)).as_rotvec()
        q += np.linalg.solve(jacobians(q), np.concatenate([shift, turn], axis=1)[..., None])[..., 0]
    return q


def flange_poses(q_rad: Floats) -> Floats:
    """Return x, y, z (m) and the rotation vector (rad) of the flange in the base frame.

    Parameters
    ----------
    q_rad : (..., 6) float
        Joint angles, base to wrist 3.

    Returns
    -------
    (..., 6) float
        As a UR controller gives its TCP pose; the rotation vector is no longer than pi.
    """
    transforms = flange_transforms(q_rad)
    flat = transforms.reshape(-1, 4, 4)
    vectors = Rotation.from_matrix(flat[:, :3, :3]).as_rotvec()
    poses = np.concatenate([flat[:, :3, 3], vectors], axis=1)
    return poses.reshape(*transforms.shape[:-2], 6)


def _link(theta: Floats, d_m: float, a_m: float, alpha_rad: float) -> Floats:
    """Return Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    ct, st = np.cos(theta), np.sin(theta)
    ca, sa = np.cos(alpha_rad), np.sin(alpha_rad)
    link = np.zeros((*theta.shape, 4, 4))
    link[..., 0, :] = np.stack([ct, -st * ca, st * sa, a_m * ct], axis=-1)
    link[..., 1, :] = np.stack([st, ct * ca, -ct * sa, a_m * st], axis=-1)
    link[..., 2, 1:] = (sa, ca, d_m)
    link[..., 3, 3] = 1.0
    return link
