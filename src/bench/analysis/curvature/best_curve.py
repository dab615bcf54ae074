"""The recommended curve: discrete bends between the markers, the heavy rod beside clamps that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints, chunks
from bench.analysis.curvature.elastica import FittedRod, fit_rod
from bench.analysis.curvature.estimate import ClampedEnds, CurveEstimate
from bench.analysis.curvature.menger import fit_menger_gp
from bench.analysis.curvature.rod_notes import DOUBTFUL
from bench.errors import AnalysisError

__all__ = ["estimate_best"]

REACHES = 3.0
"""Of sqrt(EI / tension): there a clamp's bend has fallen to a twentieth."""
NEAREST_M = 1e-3
"""A marker nearer to a clamp is in it."""
JOINED = "menger_gp, elastica beside the clamps"
FEWEST_FITTING = 0.5
"""Share of the frames with a rod that it must fit: below, those that it fits may do so by chance."""
COMPARED_FRAMES = 1000
"""Spread over the recording, to say how much the rod changes the largest curvature."""


def estimate_best(
    position_m: Floats32,
    marker_arc_length_m: Floats,
    arc_length_m: Floats,
    noise_m: float,
    *,
    ends: ClampedEnds | None = None,
    with_vector: bool = False,
) -> CurveEstimate:
    """Estimate the curvature by the best that is known of each place.

    Between the markers that is `fit_menger_gp`, which assumes nothing of the cable. Beside a clamp a cable bends within
    less than the markers' spacing, which no marker shows; there it is the heavy rod of `fit_elastica`, where both
    clamps are known and the rod misses the markers by no more than 2.5 times the noise: in the recording, and in the
    frame. From a clamp it reaches three times the length over which the clamp's bend decays, at least to the first
    marker off the clamp, and goes over into the other within one spacing of the markers.

    Parameters and result are those of every `CurveEstimator`; its notes say what was used where, and why. The standard
    deviation is of a mixture of the two: where they differ, it is wider.
    """
    given = position_m, marker_arc_length_m
    bends = fit_menger_gp(*given, arc_length_m, noise_m, ends=ends, with_vector=with_vector)
    try:
        rod = fit_rod(*given, noise_m, ends)
    except AnalysisError as error:
        return _without_rod(bends, str(error), [])
    share = _share_of_rod(rod, marker_arc_length_m, arc_length_m)
    near = np.flatnonzero(share > 0)
    beside = rod.read(arc_length_m[near], with_vector=with_vector)
    missed = np.asarray(beside.residual_m)
    fits = missed <= DOUBTFUL * rod.law.model.noise_m
    if fits.sum() <= FEWEST_FITTING * np.isfinite(missed).sum():
        return _without_rod(bends, "The heavy rod does not fit this cable.", beside.warnings)
    told = _tell(rod, _compare(bends, beside, near, fits), fits)
    _join(bends, beside, near, share[near], fits)
    notes, warnings = [*bends.notes, *beside.notes, told], [*bends.warnings, *beside.warnings]
    return replace(bends, residual_m=beside.residual_m, method=JOINED, notes=notes, warnings=warnings)


def _without_rod(bends: CurveEstimate, why: str, warnings: list[str]) -> CurveEstimate:
    note = f"{why} So bends beside the clamps are read from the markers alone, which do not show the short ones."
    return replace(bends, notes=[*bends.notes, note], warnings=[*bends.warnings, *warnings])


def _tell(rod: FittedRod, ratio: float, fits: Bools) -> str:
    reach = f"{1e3 * REACHES * rod.law.clamp_reach_m:.0f} mm"
    return (
        f"Beside the clamps, over {reach} and at least to the first marker, the curvature is a heavy rod's, in "
        f"{fits.mean():.1%} of the frames: usually {ratio:.2f} times what the markers alone show there."
    )


def _share_of_rod(rod: FittedRod, marker_m: Floats, arc_length_m: Floats) -> Floats:
    """Return how much of the curve (G,) is the rod's: all beside the clamps, nothing a spacing further on."""
    spacing, length_m = float(np.median(np.diff(marker_m))), rod.frames.length_m
    share = np.zeros(len(arc_length_m))
    for from_clamp, markers in ((arc_length_m, marker_m), (length_m - arc_length_m, length_m - marker_m)):
        first = float(markers[markers > NEAREST_M].min())
        beyond = (from_clamp - max(REACHES * rod.law.clamp_reach_m, first)) / spacing
        inside = np.where(from_clamp >= 0, 0.5 + 0.5 * np.cos(np.pi * np.clip(beyond, 0.0, 1.0)), 0.0)
        share = np.maximum(share, inside)
    return share


def _join(bends: CurveEstimate, beside: CurveEstimate, near: Ints, share: Floats, fits: Bools) -> None:
    """Put the rod's curve into the other, in the frames that it fits."""
    for start, stop in chunks(len(fits)):
        frames = start + np.flatnonzero(fits[start:stop])
        rows = np.ix_(frames, near)
        apart = beside.curvature_per_m[frames] - bends.curvature_per_m[rows]
        sigma = share * beside.sigma_per_m[frames] + (1 - share) * bends.sigma_per_m[rows]
        bends.curvature_per_m[rows] += share * apart
        bends.sigma_per_m[rows] = np.sqrt(sigma**2 + share * (1 - share) * apart**2)
        if bends.vector_per_m is not None and beside.vector_per_m is not None:
            bends.vector_per_m[rows] += share[:, None] * (beside.vector_per_m[frames] - bends.vector_per_m[rows])


def _compare(bends: CurveEstimate, beside: CurveEstimate, near: Ints, fits: Bools) -> float:
    """Return the usual ratio of the largest curvature beside the clamps by the rod and by the markers alone."""
    frames = np.flatnonzero(fits)
    frames = frames[:: -(-len(frames) // COMPARED_FRAMES)]
    rod, markers = beside.curvature_per_m[frames], bends.curvature_per_m[np.ix_(frames, near)]
    return float(np.nanmedian(rod.max(axis=1) / markers.max(axis=1)))
