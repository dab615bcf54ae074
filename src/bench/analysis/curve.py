"""The cable's curve through its sorted markers. An estimator is a function, chosen by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, chunks
from bench.analysis.spline import MIN_KNOTS, SplineMatrices, make_spline_matrices
from bench.errors import AnalysisError

__all__ = ["ESTIMATORS", "CurveEstimate", "CurveEstimator", "fit_spline", "get_estimator", "interpolate_curve"]

CHUNK = 500
"""Frames at once: 500 frames of 100 samples are 0.4 MB for each of the dozen arrays of the curvature formula."""


@dataclass(frozen=True, eq=False)
class CurveEstimate:
    """Curvature of F frames at G places along the cable."""

    curvature_per_m: Floats32
    """(F, G): magnitude, NaN where no curve could be drawn."""
    sigma_per_m: Floats32
    """(F, G): standard deviation from the markers' noise, first order; the method's own bias is not in it."""
    vector_per_m: Floats32 | None = None
    """(F, G, 3): curvature times the binormal, lab frame, where it was asked for."""


class CurveEstimator(Protocol):
    """Gives the curvature along the cable in every frame."""

    def __call__(
        self,
        position_m: Floats32,
        marker_arc_length_m: Floats,
        arc_length_m: Floats,
        noise_m: float,
        *,
        with_vector: bool = False,
    ) -> CurveEstimate:
        """Estimate the curvature at `arc_length_m` (G,) from markers (F, k, 3) at `marker_arc_length_m` (k,)."""
        ...


def fit_spline(
    position_m: Floats32,
    marker_arc_length_m: Floats,
    arc_length_m: Floats,
    noise_m: float,
    *,
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
    for seen, frames in _group_by_seen_markers(~np.isnan(position_m[:, :, 0])):
        if seen.sum() < MIN_KNOTS:
            continue
        matrices = make_spline_matrices(marker_arc_length_m[seen], arc_length_m)
        for start, stop in chunks(len(frames), CHUNK):
            rows = np.ix_(frames[start:stop], np.flatnonzero(matrices.inside))
            first, second = _derivatives(position_m[frames[start:stop]][:, seen], matrices)
            curvature[rows], sigma[rows] = _curvature(first, second, matrices, noise_m)
            if vector is not None:
                vector[rows] = _curvature_vector(first, second)
    return CurveEstimate(curvature, sigma, vector)


def interpolate_curve(position_m: Floats32, marker_arc_length_m: Floats, arc_length_m: Floats) -> Floats:
    """Return the spline's points (G, 3) through one frame's markers (k, 3), NaN outside the seen ones."""
    curve = np.full((len(arc_length_m), 3), np.nan)
    seen = ~np.isnan(position_m[:, 0])
    if seen.sum() >= MIN_KNOTS:
        matrices = make_spline_matrices(marker_arc_length_m[seen], arc_length_m)
        curve[matrices.inside] = matrices.value @ position_m[seen].astype(np.float64)
    return curve


def _group_by_seen_markers(seen: Bools) -> list[tuple[Bools, np.ndarray[tuple[int], np.dtype[np.intp]]]]:
    """Return each pattern of seen markers (k,) with the indices of its frames."""
    packed = np.ascontiguousarray(np.packbits(seen, axis=1))
    keys = packed.view(np.dtype((np.void, packed.shape[1]))).ravel()
    _, first, pattern = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(pattern, kind="stable")
    bounds = np.searchsorted(pattern[order], np.arange(len(first) + 1))
    return [(seen[first[i]], order[bounds[i] : bounds[i + 1]]) for i in range(len(first))]


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


ESTIMATORS: Mapping[str, CurveEstimator] = MappingProxyType({"spline": fit_spline})
"""Estimators by the names of `[analysis] curvature`."""
RECOMMENDED = "spline"


def get_estimator(name: str) -> tuple[str, CurveEstimator]:
    """Return the estimator of that name and its own name; 'auto' is the recommended one.

    Raises
    ------
    AnalysisError
        There is no estimator of that name.
    """
    chosen = RECOMMENDED if name == "auto" else name
    if chosen not in ESTIMATORS:
        known = ", ".join(ESTIMATORS)
        raise AnalysisError(f"There is no curvature method '{name}'.", hint=f"Choose one of: auto, {known}.")
    return chosen, ESTIMATORS[chosen]
