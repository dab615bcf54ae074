"""The preprogrammed path: a closed curve of joint angles that moves and turns the flange in one vertical plane.

Shoulder, elbow and wrist 1 have parallel axes, and with wrist 2 at -90 degrees the tool points along the plane that
is normal to them. So the flange stays in one vertical plane, and a cable between it and a pole in that plane is a
planar rod, which is what `bench.simulation.elastica` solves.

For a calibration the plane itself swings about a vertical axis through the pole, and the tool turns about its own axis:
rotations about three axes, positions in space.

Plane coordinates: x is horizontal, along the base frame's x axis turned by the base joint, y is up; both are zero on
the base joint's axis at the height of the base.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from bench.simulation.kinematics import A_M, D_M, flange_poses, flange_transforms, jacobians, solve_joints

__all__ = ["BASE_JOINT_RAD", "FLANGE_CENTRE_M", "JointPath", "Swing", "place_at_phase", "rate_at_phase"]

Floats = npt.NDArray[np.float64]

BASE_JOINT_RAD = 0.35
"""Turns the plane off the base frame's axes, so that no code works by accident."""
WRIST_2_RAD = -np.pi / 2
FLANGE_CENTRE_M = (-0.52, 0.48)
"""Middle of the flange's curve: at half of the arm's reach, where no joint is near its limit."""
LARGEST_SEMI_AXES_M = (0.15, 0.07)
"""Of the curve at amplitude 1: 0.7 m around, at most 0.7 m/s for a cycle of 2 s, near a cobot's usual speed."""
TOOL_CENTRE_RAD = np.pi + 0.35
TOOL_SWING_RAD = 0.7
TWIST_RAD = 0.9
"""Largest turn of the tool about its own axis in a calibration: well inside a wrist's range."""
N_STEPS = 4096
"""Linear interpolation between this many places is good to 0.2 micrometres."""


def place_at_phase(phase: float) -> float:
    """Return the place on the path, 0 to 1, for a share of the cycle's duration: the minimum-jerk law."""
    return phase * phase * phase * (10.0 + phase * (6.0 * phase - 15.0))


def rate_at_phase(phase: float) -> float:
    """Return the derivative of `place_at_phase`; 1.875 in the middle, 0 at both ends."""
    rest = phase * (1.0 - phase)
    return 30.0 * rest * rest


@dataclass(frozen=True, slots=True)
class PathPoint:
    """One place on the path and how it changes per unit of place."""

    q_rad: list[float]
    pose: list[float]
    q_rate: list[float]
    pose_rate: list[float]


@dataclass(frozen=True, slots=True)
class Swing:
    """What a calibration adds to the path: its plane turns to and fro about a vertical axis, the tool about its own."""

    pivot_m: tuple[float, float]
    """Where the axis is: x, y in the base frame."""
    amplitude_rad: float
    """Largest turn of the plane."""


class JointPath:
    """Joint angles and flange poses along a closed path, tabulated once and interpolated.

    Parameters
    ----------
    amplitude : float
        Size of the flange's curve; 1 is 300 mm wide and 140 mm high. Less than 1 for short cables.
    swing : Swing, optional
        Left out, the path stays in its plane.
    """

    def __init__(self, amplitude: float = 1.0, swing: Swing | None = None) -> None:
        self.amplitude = amplitude
        self.swing = swing
        place = np.linspace(0.0, 1.0, N_STEPS + 1)
        q = _joints(self.flange_in_plane(place))
        if swing is not None:
            q = _swung(q, swing.pivot_m, self.swing_rad(place), _twist_rad(place))
        self._table = _tabulate(place, q)

    def flange_in_plane(self, place: Floats) -> Floats:
        """Return x, y (m) and the direction of the tool axis (rad) in plane coordinates.

        Parameters
        ----------
        place : (n,) float
            Place on the path, 0 to 1; 0 and 1 are the same pose.

        Returns
        -------
        (n, 3) float
        """
        turn = 2.0 * np.pi * np.asarray(place, dtype=np.float64)
        x = FLANGE_CENTRE_M[0] + self.amplitude * LARGEST_SEMI_AXES_M[0] * np.cos(turn)
        y = FLANGE_CENTRE_M[1] - self.amplitude * LARGEST_SEMI_AXES_M[1] * np.sin(turn)
        tool = TOOL_CENTRE_RAD + TOOL_SWING_RAD * np.sin(turn - 0.5)
        return np.stack([x, y, tool], axis=-1)

    def swing_rad(self, place: Floats) -> Floats:
        """Return the turn of the plane (n,) at n places, 0 where it does not swing."""
        amplitude_rad = 0.0 if self.swing is None else self.swing.amplitude_rad
        return np.asarray(amplitude_rad * np.sin(4.0 * np.pi * np.asarray(place, dtype=np.float64)))

    def at(self, place: float) -> PathPoint:
        """Return joints, flange pose (base frame) and their derivatives by place."""
        scaled = min(max(place, 0.0), 1.0) * N_STEPS
        step = min(int(scaled), N_STEPS - 1)
        here = self._table[step]
        row = (here + (self._table[step + 1] - here) * (scaled - step)).tolist()
        return PathPoint(row[0:6], row[6:12], row[12:18], row[18:24])


def _joints(flange: Floats) -> Floats:
    """Solve the arm's three parallel joints for poses in the plane; the elbow is up."""
    x, y, tool = flange.T
    upper, fore = -A_M[1], -A_M[2]
    wrist_x = x - D_M[5] * np.cos(tool) - D_M[4] * np.sin(tool)
    wrist_y = y - D_M[5] * np.sin(tool) + D_M[4] * np.cos(tool) - D_M[0]
    elbow = np.arccos((wrist_x**2 + wrist_y**2 - upper**2 - fore**2) / (2.0 * upper * fore))
    shoulder = np.arctan2(-wrist_y, -wrist_x) - np.arctan2(fore * np.sin(elbow), upper + fore * np.cos(elbow))
    fixed = np.ones_like(x)
    wrist_1 = tool - shoulder - elbow
    return np.stack([fixed * BASE_JOINT_RAD, shoulder, elbow, wrist_1, fixed * WRIST_2_RAD, 0.0 * fixed], axis=-1)


def _twist_rad(place: Floats) -> Floats:
    # Three turns to and fro against the plane's two and the path's one: no two of the three axes move together.
    return np.asarray(TWIST_RAD * np.sin(6.0 * np.pi * place))


def _swung(q: Floats, pivot_m: tuple[float, float], swing_rad: Floats, twist_rad: Floats) -> Floats:
    """Return joints (n, 6) for poses that are turned with their plane about the pivot, and about their tool axis."""
    wanted = flange_transforms(q)
    pivot = np.array([*pivot_m, 0.0])
    turns = Rotation.from_euler("z", swing_rad[:, None])
    wanted[:, :3, 3] = turns.apply(wanted[:, :3, 3] - pivot) + pivot
    wanted[:, :3, :3] = (turns * Rotation.from_matrix(wanted[:, :3, :3])).as_matrix()
    twisted = q + np.stack([0.0 * twist_rad] * 5 + [twist_rad], axis=-1)
    wanted[:, :3, :3] = wanted[:, :3, :3] @ Rotation.from_euler("z", twist_rad[:, None]).as_matrix()
    return solve_joints(wanted, twisted)


def _tabulate(place: Floats, q: Floats) -> Floats:
    """Return rows of joints, pose and their derivatives by place."""
    closed = q.copy()
    closed[-1] = closed[0]
    q_rate = np.asarray(CubicSpline(place, closed, bc_type="periodic").derivative()(place))
    pose_rate = (jacobians(q) @ q_rate[:, :, None])[:, :, 0]
    return np.concatenate([q, flange_poses(q), q_rate, pose_rate], axis=1)
