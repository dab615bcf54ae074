"""The paper's cubic spline. With shared knots it is a fixed matrix: value and derivatives are linear in the knots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, chunks
from bench.analysis.curvature.estimate import CURVE_CHUNK, ClampedEnds, CurveEstimate, group_by_seen_markers

__all__ = ["MIN_KNOTS", "SplineMatrices", "fit_spline", "interpolate_curve", "make_spline_matrices"]

MIN_KNOTS = 4
"""Not-a-knot conditions at both ends need four knots."""


@dataclass(frozen=True, eq=False)
class SplineMatrices:
    """Maps from values at m knots to the spline at the wanted places between them."""

    inside: Bools
    """(G,): places between the first and the last knot; the other rows leave the rest out."""
    value: Floats
    """(g, m): spline."""
    first: Floats
    """(g, m): first derivative."""
    second: Floats
    """(g, m): second derivative."""
    first2: Floats
    """(g,): sum over the knots of first squared."""
    mixed: Floats
    """(g,): sum of first times second."""
    second2: Floats
    """(g,): sum of second squared."""


def make_spline_matrices(knots: Floats, places: Floats) -> SplineMatrices:
    """Return the matrices of the cubic not-a-knot spline with `knots` (m,) ascending, m >= 4, at `places` (G,)."""
    step = 1e-9 * (knots[-1] - knots[0])
    inside = (places >= knots[0] - step) & (places <= knots[-1] + step)
    moments = _moments(knots)
    x = np.clip(places[inside], knots[0], knots[-1])
    left = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    width = (knots[left + 1] - knots[left])[:, None]
    b = (x - knots[left])[:, None] / width
    a = 1.0 - b
    unit = np.eye(len(knots))
    y0, y1, m0, m1 = unit[left], unit[left + 1], moments[left], moments[left + 1]
    value = a * y0 + b * y1 + ((a**3 - a) * m0 + (b**3 - b) * m1) * width**2 / 6
    first = (y1 - y0) / width + ((3 * b**2 - 1) * m1 - (3 * a**2 - 1) * m0) * width / 6
    second = a * m0 + b * m1
    sums = [(u * v).sum(axis=1) for u, v in ((first, first), (first, second), (second, second))]
    return SplineMatrices(inside, value, first, second, sums[0], sums[1], sums[2])


def _moments(knots: Floats) -> Floats:
    """Return the matrix (m, m) from the knots' values to the spline's second derivatives there."""
    m, h = len(knots), np.diff(knots)
    left, right = np.zeros((m, m)), np.zeros((m, m))
    for i in range(1, m - 1):
        left[i, i - 1 : i + 2] = h[i - 1] / 6, (h[i - 1] + h[i]) / 3, h[i] / 6
        right[i, i - 1 : i + 2] = 1 / h[i - 1], -1 / h[i - 1] - 1 / h[i], 1 / h[i]
    left[0, :3] = h[1], -h[0] - h[1], h[0]
    left[-1, -3:] = h[-1], -h[-2] - h[-1], h[-2]
    return np.asarray(np.linalg.solve(left, right), dtype=np.float64)


def fit_spline(
    position_m: Floats32,
    marker_arc_length_m: Floats,
    arc_length_m: Floats,
    noise_m: float,
    *,
    ends: ClampedEnds | None = None,  # noqa: ARG001 - the paper's spline knows no tangents
    with_vector: bool = False,
) -> CurveEstimate:
    """Estimate the curvature by the paper's cubic spline over nominal arc length, eq. (2).

    Not-a-knot ends, as the paper's own figures have: on a circle with 8 markers its radius errs by up to 15.5 %, on the
    paper's catenary by 12 %, both at the ends. Between a frame's first and last seen marker only: nothing is
    extrapolated, and a frame with fewer than 4 markers has no curve.

    Parameters
    ----------
    position_m : (F, k, 3)
        Sorted markers, lab frame, NaN where not found.
    marker_arc_length_m : (k,)
        Arc length of each marker.
    arc_length_m : (G,)
        Where the curvature is wanted.
    noise_m : float
        Standard deviation of a marker's position, for each coordinate.
    ends : ClampedEnds, optional
        Not used: the paper's spline ends freely.
    with_vector : bool
        Whether the curvature vector is wanted, too: three times the memory.

    References
    ----------
    Cable motion capture and analysis based on optical tracking system, eqs. (1) and (2). The standard deviation is the
    first-order propagation of independent marker noise through eq. (2).
    """
    shape = (len(position_m), len(arc_length_m))
    curvature, sigma = np.full(shape, np.nan, dtype=np.float32), np.full(shape, np.nan, dtype=np.float32)
    vector = np.full((*shape, 3), np.nan, dtype=np.float32) if with_vector else None
    for seen, frames in group_by_seen_markers(~np.isnan(position_m[:, :, 0])):
        if seen.sum() < MIN_KNOTS:
            continue
        matrices = make_spline_matrices(marker_arc_length_m[seen], arc_length_m)
        for start, stop in chunks(len(frames), CURVE_CHUNK):
            rows = np.ix_(frames[start:stop], np.flatnonzero(matrices.inside))
            first, second = _derivatives(position_m[frames[start:stop]][:, seen], matrices)
            curvature[rows], sigma[rows] = _curvature(first, second, matrices, noise_m)
            if vector is not None:
                vector[rows] = _curvature_vector(first, second)
    return CurveEstimate(curvature, sigma, vector, method="spline")


def interpolate_curve(position_m: Floats32, marker_arc_length_m: Floats, arc_length_m: Floats) -> Floats:
    """Return the spline's points (G, 3) through one frame's markers (k, 3), NaN outside the seen ones."""
    curve = np.full((len(arc_length_m), 3), np.nan)
    seen = ~np.isnan(position_m[:, 0])
    if seen.sum() >= MIN_KNOTS:
        matrices = make_spline_matrices(marker_arc_length_m[seen], arc_length_m)
        curve[matrices.inside] = matrices.value @ position_m[seen].astype(np.float64)
    return curve


def _derivatives(position_m: Floats32, matrices: SplineMatrices) -> tuple[Floats, Floats]:
    """Return r' and r'' as (3, C, G): one matrix product for all coordinates of all frames."""
    coordinates = position_m.astype(np.float64)
    coordinates = np.ascontiguousarray((coordinates - coordinates[:, :1]).transpose(2, 0, 1))
    return coordinates @ matrices.first.T, coordinates @ matrices.second.T


def _curvature(first: Floats, second: Floats, matrices: SplineMatrices, noise_m: float) -> tuple[Floats, Floats]:
    """Return the curvature, eq. (2), and its standard deviation, each (C, G).

    With t, n the tangent and normal, the gradients of eq. (2) are -2 k t / |r'| - (r''.t) n / |r'|^3 with respect to
    r', and n / |r'|^2 with respect to r''.
    """
    speed2 = np.einsum("icg,icg->cg", first, first)
    along = np.einsum("icg,icg->cg", first, second)
    across2 = np.maximum(np.einsum("icg,icg->cg", second, second) * speed2 - along**2, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.sqrt(across2) / speed2**1.5
        variance = matrices.first2 * (4 * curvature**2 + (along / speed2) ** 2 / speed2) / speed2
        variance += matrices.second2 / speed2**2 - 2 * matrices.mixed * along / speed2**3
    return curvature, noise_m * np.sqrt(np.maximum(variance, 0.0))


def _curvature_vector(first: Floats, second: Floats) -> Floats:
    speed = np.sqrt(np.einsum("icg,icg->cg", first, first))
    with np.errstate(divide="ignore", invalid="ignore"):
        vector = np.cross(first, second, axis=0).transpose(1, 2, 0) / speed[:, :, None] ** 3
    return np.asarray(vector, dtype=np.float64)
