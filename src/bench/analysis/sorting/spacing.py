"""Where the markers sit on the cable, measured from the chords between neighbours: tape is off by millimetres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32
from bench.analysis.calibration.correlation import correlation_length
from bench.errors import AnalysisError

__all__ = ["MarkerPlaces", "measure_marker_places"]

FEWEST_FRAMES = 20
STRAIGHT_SHARE = 0.5
"""Share of the frames that is used for each spacing, the straightest: there the chord differs least from the cable."""

BEND_SHARE = 0.05
"""Of the lengthening, as a standard deviation: between markers a cable is no circle. Alike for all markers."""
FIXED_SIGMA_M = 5e-5
"""Of each spacing: the anchor's own place, and what no scatter shows."""


@dataclass(frozen=True, eq=False)
class MarkerPlaces:
    """Arc lengths of the cable's k markers."""

    arc_length_m: Floats
    """(k,): from the anchor."""
    sigma_m: Floats
    """(k,): standard deviation, from the chords' scatter and what bends hide; markers off the axis are not in it."""


def measure_marker_places(position_m: Floats32, usable: Bools, anchor_m: Floats | None, first_m: float) -> MarkerPlaces:
    """Measure the arc lengths of markers from frames in which they are sorted.

    A chord c over a cable of curvature kappa is shorter than the cable between its ends, by about c³ kappa² / 24:
    that is 2 / kappa asin(c kappa / 2), with the mean curvature of the circles through neighbouring markers. Each
    spacing is the median, over the half of the frames in which the cable is straightest there, of the chord so
    lengthened; a frame with a hidden marker tells of the others. From the anchor to the first marker it is a chord
    like the others, but no circle goes through the anchor: the centre of a rigid body lies beside the cable.

    Parameters
    ----------
    position_m : (F, k, 3)
        Sorted markers, NaN where not found.
    usable : (F,)
        Frames that are sorted without doubt.
    anchor_m : (F, 3) or None
        Where the cable starts; None for a cable without an anchor.
    first_m : float
        Arc length of the first marker where there is no anchor.

    Raises
    ------
    AnalysisError
        Two neighbours, and one beside them, are seen together in fewer than 20 usable frames, or there are
        only two places.
    """
    nodes = np.asarray(position_m[usable], dtype=np.float64)
    if anchor_m is not None:
        nodes = np.concatenate([anchor_m[usable][:, None], nodes], axis=1)
    if nodes.shape[1] < 3:
        raise AnalysisError(
            "Fewer than three places on the cable tell nothing of its bends, so nothing of its spacings."
        )
    chord = np.linalg.norm(np.diff(nodes, axis=1), axis=2)
    curvature = _mean_curvature(nodes, is_anchored=anchor_m is not None)
    n_known = np.isfinite(chord + curvature).sum(axis=0)
    if n_known.min(initial=len(nodes)) < FEWEST_FRAMES:
        raise AnalysisError(
            f"Two neighbouring markers are sorted without doubt in {n_known.min()} frames; at least {FEWEST_FRAMES} "
            "are needed to measure their spacing.",
            hint="Check marker_arc_length_m and the gates, or that the markers are in the cameras' view.",
        )
    spacing, variance, bend = np.array([_spacing(chord[:, i], curvature[:, i]) for i in range(chord.shape[1])]).T
    if anchor_m is None:
        spacing, variance, bend = (np.concatenate([[0.0], part]) for part in (spacing, variance, bend))
    start = first_m if anchor_m is None else 0.0
    sigma = np.sqrt(np.cumsum(variance) + (BEND_SHARE * np.cumsum(bend)) ** 2)
    return MarkerPlaces(start + np.cumsum(spacing), sigma)


def _mean_curvature(nodes: Floats, *, is_anchored: bool) -> Floats:
    """Return (F, n - 1): of each chord, the mean of the curvatures of the circles at its two ends, or of the known one.

    The first two chords of an anchored cable have that of the nearest circle through markers alone.
    """
    before, after = np.diff(nodes[:, :-1], axis=1), np.diff(nodes[:, 1:], axis=1)
    lengths = (np.linalg.norm(part, axis=2) for part in (before, after, before + after))
    product = np.prod(list(lengths), axis=0)
    circle = 2 * np.linalg.norm(np.cross(before, after), axis=2) / np.maximum(product, np.finfo(float).tiny)
    if is_anchored and circle.shape[1] > 1:
        circle[:, 0] = circle[:, 1]
    padded = np.concatenate([circle[:, :1], circle, circle[:, -1:]], axis=1)
    sides = np.stack([padded[:, :-1], padded[:, 1:]])
    n_known = np.isfinite(sides).sum(axis=0)
    return np.where(n_known > 0, np.nansum(sides, axis=0) / np.maximum(n_known, 1), np.nan)


def _spacing(chord: Floats, curvature: Floats) -> tuple[float, float, float]:
    """Return the arc length between two neighbours, its variance by scatter, and by how much the chord is shorter."""
    known = np.isfinite(chord + curvature)
    chord, curvature = chord[known], curvature[known]
    straight = curvature <= np.quantile(curvature, STRAIGHT_SHARE)
    half_angle = np.clip(chord * curvature / 2, 1e-6, 1.0)[straight]
    lengthened = chord[straight] * np.arcsin(half_angle) / half_angle
    # the median of normal numbers scatters by sqrt(pi / 2) times their mean's standard deviation
    variance = np.pi / 2 * lengthened.var() * correlation_length(lengthened[:, None]) / len(lengthened)
    return (
        float(np.median(lengthened)),
        float(variance) + FIXED_SIGMA_M**2,
        float(np.median(lengthened - chord[straight])),
    )
