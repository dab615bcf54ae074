"""Curvature from neighbouring markers' circles, smoothed as the recording itself tells, with the clamps' tangents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Floats, Floats32, Ints
from bench.analysis.curvature.estimate import ClampedEnds, CurveEstimate, group_by_seen_markers
from bench.analysis.curvature.menger_chain import Chain, make_chain, make_curve_matrices
from bench.analysis.curvature.menger_prior import Layout, make_prior
from bench.analysis.curvature.menger_smoothness import (
    Sighting,
    Smoothness,
    Widening,
    learn_smoothness,
    measure_widening,
)

__all__ = ["fit_menger_gp"]

FEWEST_NODES = 3
"""Three points are the least that have a bend."""
SAMPLED_CHAINS, SAMPLED_FRAMES = 3, 200
"""From so many patterns of missing markers, the most frequent ones, and so many frames of each smoothness is learnt: it
is two numbers, and this takes some milliseconds."""
NEAREST_M = 1e-3
"""A clamp this near to a marker tells no more than the marker; the chord between them would have no direction."""
FEWEST_SPACINGS = 5.0
"""Over which the curvature stays alike. Clamped rods had their peak read up to 80 % too low below this, and above it,
with tangents, up to 15 % (measured 2026-11, bending stiffness 0.005 to 0.3 N m^2, 7 to 30 markers on 1.5 m)."""
WIDEST = 2.0
"""Widening of the band above which the largest bends of the same rods lay outside it."""
ROUNDING_M = 1e-7
"""Of a position of some metres in single precision: no noise is smaller."""


@dataclass(frozen=True, eq=False)
class _Nodes:
    """The markers of F frames, and what is known of the two ends."""

    position_m: Floats32
    """(F, n, 3)"""
    tangent: Floats32
    """(F, 2, 3)"""
    layout: Layout

    def group(self) -> list[tuple[Chain, Ints]]:
        """Return what is known alike with the frames in which it is, for all frames from which a curve follows."""
        known = np.concatenate([np.isfinite(self.position_m[:, :, 0]), np.isfinite(self.tangent[:, :, 0])], axis=1)
        return [
            (make_chain(self.layout, pattern[:-2], pattern[-2:]), frames)
            for pattern, frames in group_by_seen_markers(known)
            if pattern[:-2].sum() >= FEWEST_NODES
        ]


def fit_menger_gp(
    position_m: Floats32,
    marker_arc_length_m: Floats,
    arc_length_m: Floats,
    noise_m: float,
    *,
    ends: ClampedEnds | None = None,
    with_vector: bool = False,
) -> CurveEstimate:
    """Estimate the curvature from discrete bends, with a posterior band.

    Each marker between two others has the curvature of the circle through the three; a clamp whose tangent is known has
    that of the circle from the tangent to the chord. Each is an average of the curvature about its place. The curve is
    the posterior mean of a Matern-5/2 process about an unknown constant, for each component of the curvature vector
    alone, given these averages and their noise. How strongly and over which length the curvature changes is learnt from
    the recording's frames together. So a curve is a fixed matrix times a frame's bends, one for each pattern of what is
    known.

    Circles are exact whatever the spacing. Errors of the arc lengths move a bend along the cable and change none.
    Between the first and the last marker (or clamp whose place or tangent is known) only; a frame with fewer than three
    has no curve, nor has one with two neighbours at the same place.

    Parameters
    ----------
    position_m : (F, k, 3)
        Sorted markers, lab frame, NaN where not found.
    marker_arc_length_m : (k,)
        Arc length of each marker, ascending.
    arc_length_m : (G,)
        Where the curvature is wanted.
    noise_m : float
        Standard deviation of a marker's position, for each coordinate.
    ends : ClampedEnds, optional
        Places and tangents of the clamps, with their standard deviations, the recording's median of which is used.
    with_vector : bool
        Whether the curvature vector is wanted, too: three times the memory.

    Returns
    -------
    CurveEstimate
        The magnitude of the posterior mean vector, and the posterior standard deviation of a component, widened where
        bends differ from what all others make of them by more than they should, and at ends without tangent, twice
        as wide there and no wider at the first bend. It holds noise and what lies between markers as far as the rest
        of the recording tells; it does not hold bends beside clamps that are shorter than anything the markers show.
        On a straight cable the magnitude is noise's own: up to two standard deviations, never below zero. The residual
        is how far the markers lie off the curve, across the cable: a part of their noise. It is far more where markers
        are dense and one is not what it is taken for.

    References
    ----------
    K. Menger, Untersuchungen ueber allgemeine Metrik, 1930 (curvature of three points). C. E. Rasmussen and C. K. I.
    Williams, Gaussian Processes for Machine Learning, 2006, 2.7 (unknown mean) and 5.4 (marginal likelihood).
    """
    from bench.analysis.kernels.menger import apply_weights

    nodes = _gather_nodes(position_m, marker_arc_length_m, noise_m, ends)
    shape = (len(position_m), len(arc_length_m))
    curvature, sigma = np.full(shape, np.nan, dtype=np.float32), np.full(shape, np.nan, dtype=np.float32)
    residual = np.full(len(position_m), np.nan, dtype=np.float32)
    vector = np.full((*shape, 3) if with_vector else (0, 0, 3), np.nan, dtype=np.float32)
    groups, notes, warnings = nodes.group(), [], []
    sightings = _sample(nodes, groups)
    if sightings:
        smoothness = learn_smoothness(sightings, nodes.layout)
        widening = measure_widening(sightings[0], nodes.layout, smoothness)
        wider = np.interp(arc_length_m, widening.at_m, widening.factor)
        notes = [_describe(smoothness)]
        warnings = _warn_of_coarse(smoothness, widening, marker_arc_length_m)
        prior = make_prior(nodes.layout, arc_length_m, smoothness.amplitude_per_m, smoothness.length_m)
        for chain, frames in groups:
            matrices = make_curve_matrices(chain, prior, arc_length_m)
            known = nodes.position_m, nodes.tangent, frames, chain.seen, chain.held, chain.reach_m, chain.share
            weight, own = matrices.weight.astype(np.float32), (wider * matrices.sigma_per_m).astype(np.float32)
            apply_weights(*known, weight, own, matrices.offset_m2, curvature, sigma, residual, vector)
    return CurveEstimate(curvature, sigma, vector if with_vector else None, residual, "menger_gp", notes, warnings)


def _gather_nodes(position_m: Floats32, marker_s_m: Floats, noise_m: float, ends: ClampedEnds | None) -> _Nodes:
    """Add the ends whose places are known to the markers."""
    length_m = ends.length_m if ends else float(marker_s_m[-1])
    clamp_s_m = np.array([0.0, max(length_m, marker_s_m[-1])])
    position, node_s = [position_m.astype(np.float32, copy=False)], [marker_s_m]
    variance = [np.full(len(marker_s_m), noise_m**2 + ROUNDING_M**2)]
    tangent, angle_variance = np.full((len(position_m), 2, 3), np.nan, dtype=np.float32), np.full(2, np.nan)
    for side, end in enumerate((ends.anchor, ends.end) if ends else ()):
        if end is None:
            continue
        at, beyond = (0, marker_s_m[0]) if side == 0 else (len(position), clamp_s_m[1] - marker_s_m[-1])
        if beyond > NEAREST_M:
            position.insert(at, end.position_m.astype(np.float32)[:, None])
            node_s.insert(at, clamp_s_m[side : side + 1])
            variance.insert(at, np.array([_usual_variance(end.position_sigma_m, noise_m) + ROUNDING_M**2]))
        angle_variance[side] = _usual_variance(end.tangent_sigma_rad, np.nan)
        if np.isfinite(angle_variance[side]):
            tangent[:, side] = end.tangent
    angle_variance = np.nan_to_num(angle_variance)
    layout = Layout(np.concatenate(node_s), clamp_s_m, np.concatenate([*variance, angle_variance]))
    joined = position[0] if len(position) == 1 else np.concatenate(position, axis=1)
    return _Nodes(np.ascontiguousarray(joined), tangent, layout)


def _usual_variance(sigma: Floats, otherwise: float) -> float:
    """Return the square of the median, so that one matrix serves all frames."""
    known = sigma[np.isfinite(sigma)]
    return float(np.median(known) if len(known) else otherwise) ** 2


def _sample(nodes: _Nodes, groups: list[tuple[Chain, Ints]]) -> list[Sighting]:
    """Return frames of the most frequent chains, evenly over the recording."""
    from bench.analysis.kernels.menger import measure_bends

    sightings = []
    for chain, frames in sorted(groups, key=lambda group: -len(group[1]))[:SAMPLED_CHAINS]:
        chosen = frames[np.linspace(0, len(frames) - 1, min(len(frames), SAMPLED_FRAMES)).astype(np.intp)]
        bend = np.empty((len(chosen), len(chain.difference), 3))
        known = nodes.position_m, nodes.tangent, chosen, chain.seen, chain.held, chain.reach_m, chain.share
        measure_bends(*known, bend)
        sightings.append(Sighting(chain, bend[np.isfinite(bend).all(axis=(1, 2))]))
    return [sighting for sighting in sightings if len(sighting.bend_per_m)]


def _describe(smoothness: Smoothness) -> str:
    return (
        f"Learnt from the frames: curvature differs along the cable by {smoothness.amplitude_per_m:.2g} per metre "
        f"(standard deviation), over {smoothness.length_m * 1e3:.0f} mm."
    )


def _warn_of_coarse(smoothness: Smoothness, widening: Widening, marker_s_m: Floats) -> list[str]:
    """Return what to say where the markers are too far apart for the bends that occur."""
    spacing_m, widest = float(np.median(np.diff(marker_s_m))), float(widening.factor.max())
    too_short = smoothness.length_m <= FEWEST_SPACINGS * spacing_m
    if smoothness.is_even or not (too_short or widest > WIDEST):
        return []
    sentence = (
        f"The markers, {spacing_m * 1e3:.0f} mm apart, are too far apart for this cable's sharpest bends (its "
        f"curvature changes over {smoothness.length_m * 1e3:.0f} mm): the largest curvature, beside a clamp above all, "
        "may be read too low by more than its interval says."
    )
    return [sentence]
