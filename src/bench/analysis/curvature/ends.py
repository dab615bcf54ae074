"""Where the cable ends and which way it leaves its clamp, from the pose of what holds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats
from bench.analysis.calibration.correlation import correlation_length
from bench.analysis.calibration.rigid import RigidTransform, lever
from bench.errors import AnalysisError

__all__ = ["CableEnd", "ClampDirection", "estimate_clamp_direction", "place_end"]

FEWEST_FRAMES = 20
FRAMES_APART = 3
"""Frames whose noise is another while the cable is bent alike: 30 ms at 100 Hz."""
BEND_SHARE = 0.1
"""Of the angle by which the bends turn the cable away, as a standard deviation: a cable is no sum of two circles."""
MOST_SIGMA_RAD = float(np.deg2rad(10.0))
"""A direction known no better says less than the clamp's drawing does."""


@dataclass(frozen=True, eq=False)
class ClampDirection:
    """The direction in which a clamp holds the cable, in the clamp's own frame."""

    direction: Floats
    """(3,): unit vector from the clamp into the free cable."""
    sigma_rad: float
    """Standard deviation of its angle."""


@dataclass(frozen=True, eq=False)
class CableEnd:
    """The clamped end of the cable in F frames, lab frame; NaN where the holder's pose is unknown."""

    position_m: Floats
    """(F, 3)"""
    position_sigma_m: Floats
    """(F,): standard deviation in the worst direction, from the calibration of space."""
    tangent: Floats
    """(F, 3): unit vector from the clamp into the free cable; NaN where no direction is given."""
    tangent_sigma_rad: Floats
    """(F,): standard deviation of its angle, from the clamp's and the calibration's."""


def estimate_clamp_direction(markers_m: Floats) -> ClampDirection:
    """Estimate the clamp's direction from the markers beside it, over frames in which the cable bends differently.

    The direction from the clamp to the nearest marker turns away from the clamp's own as the cable bends beside it. So
    it is fitted as a constant plus a multiple of each of the two curvatures that three markers and the clamp show; the
    constant is the clamp's direction, for it is what is left of a straight cable. The more the bend varies in the run,
    the better this is told. The standard deviation is of the scatter, neighbours that err together counted once, and a
    tenth of the usual angle between clamp and nearest marker.

    Parameters
    ----------
    markers_m : (F, 3, 3)
        The three markers nearest to the clamp, nearest first, in the clamp's frame with the clamp at its origin; NaN
        where unknown. In order of time.

    Raises
    ------
    AnalysisError
        Too few frames, or the cable bends beside the clamp alike in all of them.
    """
    known = np.isfinite(markers_m).all(axis=(1, 2))
    if known.sum() < FEWEST_FRAMES:
        raise AnalysisError(
            f"The three markers beside the clamp are known in {int(known.sum())} frames; at least {FEWEST_FRAMES} are "
            "needed for its direction."
        )
    nodes = np.concatenate([np.zeros((int(known.sum()), 1, 3)), markers_m[known]], axis=1)
    step = np.diff(nodes, axis=1)
    length = np.linalg.norm(step, axis=2, keepdims=True)
    way = step / length
    bends = 2 * np.diff(way, axis=1) / (length[:, 1:] + length[:, :-1])
    held = np.broadcast_to(np.eye(3), (len(way), 3, 3))
    matrix = np.concatenate([held, np.swapaxes(bends, 1, 2)], axis=2)
    # The bends are as noisy as what they explain, by the same noise. Those of other frames close by have another one.
    told = np.concatenate([held, np.swapaxes(np.roll(bends, FRAMES_APART, axis=0), 1, 2)], axis=2)
    flat, instruments = matrix.reshape(-1, 5), told.reshape(-1, 5)
    back = np.linalg.pinv(instruments.T @ flat, rcond=1e-9)
    found = back @ (instruments.T @ way[:, 0].ravel())
    left = way[:, 0] - matrix @ found
    covariance = (back @ (instruments.T @ instruments) @ back.T)[:3, :3] * left.var() * correlation_length(left)
    direction = found[:3] / np.linalg.norm(found[:3])
    turned = np.arccos(np.clip(way[:, 0] @ direction, -1.0, 1.0))
    sigma_rad = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1] + BEND_SHARE**2 * np.mean(turned**2)))
    if not sigma_rad <= MOST_SIGMA_RAD:
        raise AnalysisError(
            "The clamp's direction cannot be told: the cable bends beside it alike in all frames (standard deviation "
            f"{np.rad2deg(sigma_rad):.2g} degrees)."
        )
    return ClampDirection(direction, sigma_rad)


def place_end(
    holder_turn: Floats,
    holder_m: Floats,
    clamp_m: Floats,
    clamp: ClampDirection | None,
    lab_from_holder: RigidTransform,
    covariance: Floats,
) -> CableEnd:
    """Place the cable's end in the lab frame.

    Parameters
    ----------
    holder_turn, holder_m : (F, 3, 3), (F, 3)
        Pose of what holds the clamp (the TCP, a rigid body) in its base frame; NaN where unknown.
    clamp_m : (3,)
        The clamp in the holder's frame.
    clamp : ClampDirection or None
        Its direction in the holder's frame.
    lab_from_holder : RigidTransform
        Maps the holder's base frame into the lab frame.
    covariance : (6, 6)
        Of this map.
    """
    at_base = holder_m + holder_turn @ clamp_m
    reach = lab_from_holder.turn(at_base)
    slopes = lever(reach)
    spread = np.einsum("nij,jk,nlk->nil", slopes, covariance, slopes)
    known = np.isfinite(reach).all(axis=1)
    position_sigma = np.full(len(reach), np.nan)
    position_sigma[known] = np.sqrt(np.linalg.eigvalsh(spread[known])[:, -1])
    tangent, sigma = np.full((len(reach), 3), np.nan), np.full(len(reach), np.nan)
    if clamp is not None:
        tangent = lab_from_holder.turn(holder_turn @ clamp.direction)
        turning = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
        sigma[known] = np.sqrt(clamp.sigma_rad**2 + turning)
    return CableEnd(reach + lab_from_holder.shift_m, position_sigma, tangent, sigma)
