"""Forward kinematics of a UR5e from its published Denavit-Hartenberg parameters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

__all__ = ["ALPHA_RAD", "A_M", "D_M", "flange_poses", "flange_transforms"]

Floats = npt.NDArray[np.float64]

# Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR5e
D_M = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
A_M = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
ALPHA_RAD = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)


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
    q = np.asarray(q_rad, dtype=np.float64)
    pose = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
    for joint in range(6):
        pose = pose @ _link(q[..., joint], D_M[joint], A_M[joint], ALPHA_RAD[joint])
    return np.asarray(pose, dtype=np.float64)


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
