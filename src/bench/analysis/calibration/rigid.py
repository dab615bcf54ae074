"""Rigid transforms between two frames of reference, and the one that maps one set of points onto another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from bench.analysis.arrays import Bools, Floats
from bench.errors import AnalysisError

__all__ = [
    "RigidFit",
    "RigidTransform",
    "align_points",
    "estimate_sigma",
    "fit_rigid",
    "invert_information",
    "kabsch",
    "lever",
    "verify_told",
]

MOST_SIGMA_M = 0.005
MOST_SIGMA_RAD = float(np.deg2rad(1.0))
"""A transform known no better is not told at all: 5 mm is a marker in the wrong place, 1 degree is 17 mm at 1 m."""
REJECT_SIGMAS = 4.5
"""Of 10 000 good points with noise in three coordinates, fewer than one lies further out."""
MEDIAN_OF_CHI3 = 1.5382
"""Median length of a vector with three standard normal components."""
ROUNDS = 30
"""Reweighting settles in 5 to 15 rounds; with a third of the points wrong in up to 25."""
NO_INFORMATION = 1e-12
"""A standard deviation of a million radians, metres or seconds."""
SMALLEST_SIGMA_M = 1e-9
"""Below a nanometre a spread is rounding: points without noise."""


@dataclass(frozen=True, eq=False)
class RigidTransform:
    """Maps points of one frame of reference into another: turned, then shifted."""

    rotation: Floats
    """(3, 3)"""
    shift_m: Floats
    """(3,): where the origin goes."""

    def apply(self, points_m: Floats) -> Floats:
        """Map points (..., 3)."""
        return np.asarray(points_m @ self.rotation.T + self.shift_m, dtype=np.float64)

    def turn(self, vectors: Floats) -> Floats:
        """Map directions (..., 3)."""
        return np.asarray(vectors @ self.rotation.T, dtype=np.float64)

    def changed_by(self, step: Floats) -> RigidTransform:
        """Return the transform after a small step (6,): turned further about the target's axes (rad), shifted (m)."""
        turn = scipy.spatial.transform.Rotation.from_rotvec(step[:3]).as_matrix()
        return RigidTransform(turn @ self.rotation, self.shift_m + step[3:])


@dataclass(frozen=True, eq=False)
class RigidFit:
    """A transform found from paired points."""

    transform: RigidTransform
    covariance: Floats
    """(6, 6): of a step as in `RigidTransform.changed_by`: rad about the target's axes, then m."""
    residual_m: Floats
    """(n,): distance of each mapped point from its partner; NaN where one of both is unknown."""
    used: Bools
    """(n,): pairs that are no outliers."""


def lever(points_m: Floats) -> Floats:
    """Return (n, 3, 6): how points (n, 3), already turned, move with a step as in `RigidTransform.changed_by`."""
    x, y, z = points_m.T
    zero = np.zeros_like(x)
    cross = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]])
    shift = np.broadcast_to(np.eye(3)[:, :, None], cross.shape)
    return np.moveaxis(np.concatenate([cross, shift], axis=1), 2, 0)


def fit_rigid(source_m: Floats, target_m: Floats, weight: Floats | None = None) -> RigidFit:
    """Find the rigid transform that maps points onto their partners, whatever a minority of wrong pairs says.

    First the sum of distances is made small, by reweighted least squares, which wrong pairs hardly move; then pairs
    further away than 4.5 robust standard deviations are left out, and the rest is fitted by least squares.

    Parameters
    ----------
    source_m, target_m : (n, 3)
        Paired points; pairs with a NaN are left out.
    weight : (n,), optional
        How much each pair counts: its inverse variance, up to a common factor.

    Returns
    -------
    RigidFit
        With the covariance of the six parameters from the scatter of the pairs that were used.

    Raises
    ------
    AnalysisError
        Fewer than three pairs, or points on one line: a rotation about it cannot be told.

    References
    ----------
    W. Kabsch, Acta Crystallographica A32 (1976) 922: the rotation from the singular values of the correlation matrix.
    """
    known = np.isfinite(source_m).all(axis=1) & np.isfinite(target_m).all(axis=1)
    given = np.where(known, 1.0 if weight is None else weight, 0.0)
    if np.count_nonzero(given) < 3:
        raise AnalysisError(f"{np.count_nonzero(given)} pairs of points give no transform: at least 3 are needed.")
    source, target = np.nan_to_num(source_m), np.nan_to_num(target_m)
    transform, used = align_points(source, target, given)
    covariance = _covariance(transform, source, target, np.where(used, given, 0.0))
    what = "The transform between the points"
    verify_told(covariance, what, "They lie on one line or too close together: use points spread in three directions.")
    residual = np.where(known, np.linalg.norm(transform.apply(source) - target, axis=1), np.nan)
    return RigidFit(transform, covariance, residual, used)


def align_points(source_m: Floats, target_m: Floats, weight: Floats) -> tuple[RigidTransform, Bools]:
    """Return the transform of `fit_rigid` for pairs (n, 3) with weights (n,), 0 for none, and the pairs used."""
    balance = weight
    for _ in range(ROUNDS):
        transform = kabsch(source_m, target_m, balance)
        distance = np.linalg.norm(transform.apply(source_m) - target_m, axis=1)
        sigma = estimate_sigma(distance[weight > 0])
        balance = weight / np.maximum(distance, sigma)
    used = (weight > 0) & (distance <= REJECT_SIGMAS * sigma)
    return kabsch(source_m, target_m, np.where(used, weight, 0.0)), used


def estimate_sigma(distance_m: Floats) -> float:
    """Return the standard deviation of each coordinate from the median length of three-dimensional residuals (n,)."""
    return max(float(np.median(distance_m)) / MEDIAN_OF_CHI3, SMALLEST_SIGMA_M)


def verify_told(covariance: Floats, what: str, hint: str) -> None:
    """Raise `AnalysisError` if a step's covariance (6, 6) leaves a direction untold: `what` cannot be told."""
    turn, shift = (np.sqrt(np.linalg.eigvalsh(block)[-1]) for block in (covariance[:3, :3], covariance[3:, 3:]))
    if turn <= MOST_SIGMA_RAD and shift <= MOST_SIGMA_M:
        return
    if shift <= MOST_SIGMA_M:
        sigma, limit = f"{min(np.rad2deg(turn), 180.0):.2g}", f"{np.rad2deg(MOST_SIGMA_RAD):g} degree"
    else:
        sigma, limit = f"{shift * 1e3:.3g}" if shift < 1.0 else "over 1000", f"{MOST_SIGMA_M * 1e3:g} mm"
    raise AnalysisError(f"{what} cannot be told (standard deviation {sigma}, at most {limit}).", hint=hint)


def kabsch(source: Floats, target: Floats, weight: Floats) -> RigidTransform:
    """Return the transform with the least weighted squares between n pairs of points (n, 3); wrong pairs count too."""
    share = weight / weight.sum()
    middle, goal = share @ source, share @ target
    u, _, vt = np.linalg.svd((source - middle).T @ ((target - goal) * share[:, None]))
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    rotation = (u @ handed @ vt).T
    return RigidTransform(rotation, goal - rotation @ middle)


def _covariance(transform: RigidTransform, source: Floats, target: Floats, weight: Floats) -> Floats:
    used = weight > 0
    share = weight[used] / weight[used].mean()
    matrix = lever(transform.turn(source[used]))
    information = np.einsum("n,nij,nik->jk", share, matrix, matrix)
    misfit = transform.apply(source[used]) - target[used]
    freedom = max(3 * int(used.sum()) - 6, 1)
    variance = max(float(share @ np.square(misfit).sum(axis=1)) / freedom, SMALLEST_SIGMA_M**2)
    return invert_information(information) * variance


def invert_information(information: Floats) -> Floats:
    """Return the covariance of an information matrix; what it does not tell gets a variance beyond all limits."""
    scale = np.sqrt(np.maximum(np.diag(information), NO_INFORMATION))
    value, vector = np.linalg.eigh(information / np.outer(scale, scale))
    value = np.maximum(value, value[-1] * 1e-13)
    return np.asarray((vector / value) @ vector.T / np.outer(scale, scale))
