"""Cubic splines with shared knots are fixed matrices: value and derivatives are linear in the knots' values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis.arrays import Bools, Floats

__all__ = ["MIN_KNOTS", "SplineMatrices", "make_spline_matrices"]

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
