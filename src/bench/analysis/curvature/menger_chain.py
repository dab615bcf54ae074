"""A chain of nodes with a tangent at either end: what its bends are of the cable's curvature, as fixed matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats, Ints
from bench.analysis.curvature.menger_prior import Layout, Prior

__all__ = ["Chain", "CurveMatrices", "make_chain", "make_curve_matrices"]

WIDER_AT_END = 2.0
"""An end without tangent is beyond the last bend that is seen, and a cable bends more quickly there than the process,
which is alike all along, would have it: clamped rods, with the clamp at the end or up to a spacing beyond it, were off
by twice as much as it says (measured 2026-11, bending stiffness 0.002 to 0.3 N m^2, 7 to 30 markers on 1.5 m)."""


@dataclass(frozen=True, eq=False)
class Chain:
    """What is known alike in many frames: m nodes, and which of the two tangents; b bends follow from it."""

    seen: Ints
    """(m,): indices of the nodes among all n, ascending."""
    held: Bools
    """(2,): which tangents are known."""
    reach_m: Floats
    """(2,): cable between each clamp and its nearest node; 0 where the clamp is that node, or not held."""
    share: Floats
    """(2,): of the angle between tangent and chord, what half the chord's arc turns."""
    bend_s_m: Floats
    """(b,): arc length at the middle of what each bend is an average of; the clamp itself at a held end."""
    difference: Floats
    """(b, n + 2): the bends of a gently bent cable from its nodes' offsets across it and its tangents' slopes."""
    noise: Floats
    """(b, b): covariance of the bends' errors."""
    node_noise: Floats
    """(b, m): covariance of the bends' errors with those of the nodes."""
    first_m: float
    """Arc length at which the chain begins: a clamp whose tangent is known, or the first node."""
    last_m: float


@dataclass(frozen=True, eq=False)
class CurveMatrices:
    """The curve at G places from b bends."""

    weight: Floats
    """(b, G): NaN at places outside the chain."""
    sigma_per_m: Floats
    """(G,): standard deviation of each component, NaN outside."""
    offset_m2: Floats
    """(b, m): how far, in metres for bends per metre, each node lies off the curve."""


def make_chain(layout: Layout, seen: Bools, held: Bools) -> Chain:
    """Describe the chain of the nodes (n,) that are seen, at least 2, with the tangents (2,) that are held."""
    index = np.flatnonzero(seen)
    s = layout.node_s_m[index]
    reach = np.where(held, [s[0] - layout.clamp_s_m[0], layout.clamp_s_m[1] - s[-1]], 0.0)
    half = 0.5 * np.array([s[1] - s[0], s[-1] - s[-2]])
    slope = np.zeros((len(s) + 1, len(layout.variance)))
    steps = np.arange(len(s) - 1)
    slope[steps + 1, index[1:]], slope[steps + 1, index[:-1]] = 1 / np.diff(s), -1 / np.diff(s)
    slope[0, -2] = slope[-1, -1] = 1.0
    apart = np.concatenate([[reach[0] + half[0]], 0.5 * (s[2:] - s[:-2]), [reach[1] + half[1]]])
    kept = np.concatenate([held[:1], np.ones(len(s) - 2, dtype=bool), held[1:]])
    difference = (np.diff(slope, axis=0) / apart[:, None])[kept]
    first_m, last_m = float(s[0] - reach[0]), float(s[-1] + reach[1])
    return Chain(
        seen=index,
        held=held,
        reach_m=reach,
        share=half / (reach + half),
        bend_s_m=np.concatenate([[first_m], (s[2:] + s[1:-1] + s[:-2]) / 3, [last_m]])[kept],
        difference=difference,
        noise=(difference * layout.variance) @ difference.T,
        node_noise=(difference * layout.variance)[:, index],
        first_m=first_m,
        last_m=last_m,
    )


def make_curve_matrices(chain: Chain, prior: Prior, places: Floats) -> CurveMatrices:
    """Return the posterior mean and standard deviation of the curvature at `places` (G,).

    The prior of each component is an unknown constant plus the process; the bends are double differences of its double
    integral, and so is their covariance. Of what the data say, the constant takes its best linear unbiased estimate.
    """
    of_bends = chain.difference @ prior.node_covariance @ chain.difference.T + chain.noise
    of_places = chain.difference @ prior.place_covariance.T
    solved = np.linalg.solve(of_bends, np.column_stack([of_places, chain.node_noise, np.ones(len(of_bends))]))
    solved, offset, constant = np.split(solved, [len(places), -1], axis=1)
    left = (1.0 - solved.sum(axis=0)) / constant.sum()
    variance = prior.variance - np.einsum("bg,bg->g", of_places, solved) + left**2 * constant.sum()
    sigma = np.sqrt(np.maximum(variance, 0.0)) * _widen_ends(chain, places)
    weight = solved + constant * left
    offset = offset - constant * offset.sum(axis=0) / constant.sum()
    step = 1e-9 * (chain.last_m - chain.first_m)
    outside = (places < chain.first_m - step) | (places > chain.last_m + step)
    weight[:, outside], sigma[outside] = np.nan, np.nan
    return CurveMatrices(weight, sigma, offset)


def _widen_ends(chain: Chain, places: Floats) -> Floats:
    """Return by how much the band is wider (G,): most at an end without tangent, no more at the first bend from it."""
    factor = np.ones(len(places))
    for is_held, end_m, bend_m in zip(
        chain.held, (chain.first_m, chain.last_m), (chain.bend_s_m[0], chain.bend_s_m[-1]), strict=True
    ):
        if not is_held:
            factor += (WIDER_AT_END - 1.0) * np.clip(1.0 - np.abs((places - end_m) / (bend_m - end_m)), 0.0, 1.0)
    return factor
