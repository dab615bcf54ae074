"""The heavy rod fitted to a frame: its equilibrium, how that moves with the clamps, and the step towards the markers.

The rod is a row of unit directions: the first clamp's, one in the middle of each segment, the last clamp's. Between
neighbours sits a bending moment, on every direction pull the weight beyond it and the force that holds the end in its
place. The equilibrium's matrix is block tridiagonal, 2 by 2 in the plane across each direction. What the rod does when
a clamp moves, or the law of bending changes, are further right-hand sides of that same matrix.
"""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats
from bench.analysis.kernels.compiling import compiled

__all__ = ["COLUMNS", "N_CLAMPS", "N_LAW", "STRAIGHT", "bend_rod", "carry_bases", "hold_end", "load_rod", "solve_chain"]

N_CLAMPS = 10
"""What a frame leaves open: place of start (3) and end (3), direction at start (2) and end (2)."""
N_LAW = 3
"""What the recording leaves open: stiffness, friction moment and its curvature, all over the weight per metre."""
COLUMNS = 11
"""Right-hand sides: out of balance, end's force or place (3), direction at start (2) and end (2), law (3)."""
STRAIGHT = 1e-4
"""Sine of a turn below which its series is used."""


@compiled
def carry_bases(way: Floats, base: Floats) -> None:
    """Fill in two directions across each way (n, 3), turned along the rod without twist."""
    least = 0
    for axis in range(1, 3):
        if abs(way[0, axis]) < abs(way[0, least]):
            least = axis
    norm = np.sqrt(1.0 - way[0, least] ** 2)
    for axis in range(3):
        base[0, 0, axis] = ((1.0 if axis == least else 0.0) - way[0, least] * way[0, axis]) / norm
    for i in range(len(way)):
        if i > 0:
            cosine, along = 0.0, 0.0
            for axis in range(3):
                cosine += way[i - 1, axis] * way[i, axis]
                along += base[i - 1, 0, axis] * way[i, axis]
            share = along / max(1.0 + cosine, 1e-6)
            for axis in range(3):
                base[i, 0, axis] = base[i - 1, 0, axis] - share * (way[i - 1, axis] + way[i, axis])
        for axis in range(3):
            p, q = (axis + 1) % 3, (axis + 2) % 3
            base[i, 1, axis] = way[i, p] * base[i, 0, q] - way[i, q] * base[i, 0, p]


@compiled
def bend_rod(
    way: Floats, base: Floats, law: Floats, apart: Floats, diagonal: Floats, upper: Floats, right: Floats
) -> None:
    """Add the bending between neighbours to the matrix and to its right-hand sides."""
    stiff, friction, knee = law[0], law[1], law[2]
    side, towards = np.empty(2), np.empty(2)
    for j in range(len(apart)):
        cosine, side[0], side[1], towards[0], towards[1] = 0.0, 0.0, 0.0, 0.0, 0.0
        for axis in range(3):
            cosine += way[j, axis] * way[j + 1, axis]
            for p in range(2):
                side[p] += base[j, p, axis] * way[j + 1, axis]
                towards[p] += base[j + 1, p, axis] * way[j, axis]
        sine = np.sqrt(side[0] ** 2 + side[1] ** 2)
        curvature = np.arctan2(sine, cosine) / apart[j]
        slid = np.tanh(curvature / knee)
        moment = stiff * curvature + friction * slid
        slope = (stiff + friction * (1.0 - slid**2) / knee) / apart[j]
        by_knee = -friction * (1.0 - slid**2) / knee**2
        if sine > STRAIGHT:
            first, second = -moment / sine, (slope * sine - moment * cosine) / sine**3
            by_stiff, by_friction, by_knee = curvature / sine, slid / sine, by_knee * curvature / sine
        else:
            first, second = -slope, slope / 3.0
            by_stiff, by_friction, by_knee = 1.0 / apart[j], 1.0 / (knee * apart[j]), by_knee / apart[j]
        for p in range(2):
            diagonal[j, p, p] -= first * cosine
            diagonal[j + 1, p, p] -= first * cosine
            for q in range(2):
                both = 0.0
                for axis in range(3):
                    both += base[j, p, axis] * base[j + 1, q, axis]
                diagonal[j, p, q] += second * side[p] * side[q]
                diagonal[j + 1, p, q] += second * towards[p] * towards[q]
                upper[j, p, q] = second * side[p] * towards[q] + first * both
            right[j, p, 0] -= first * side[p]
            right[j + 1, p, 0] -= first * towards[p]
            right[j, p, 8] += by_stiff * side[p]
            right[j + 1, p, 8] += by_stiff * towards[p]
            right[j, p, 9] += by_friction * side[p]
            right[j + 1, p, 9] += by_friction * towards[p]
            right[j, p, 10] += by_knee * side[p]
            right[j + 1, p, 10] += by_knee * towards[p]


@compiled
def load_rod(
    way: Floats, base: Floats, force: Floats, weight: Floats, end: Floats, diagonal: Floats, right: Floats
) -> None:
    """Add weight and end force, and what the force's three components and the clamps' directions do."""
    for i in range(1, len(way) - 1):
        along = 0.0
        for axis in range(3):
            along += (weight[i, axis] - end[i] * force[axis]) * way[i, axis]
        for p in range(2):
            diagonal[i, p, p] -= along
            for axis in range(3):
                right[i, p, 0] -= base[i, p, axis] * (weight[i, axis] - end[i] * force[axis])
                right[i, p, 1 + axis] = end[i] * base[i, p, axis]


@compiled
def solve_chain(diagonal: Floats, upper: Floats, right: Floats) -> None:
    """Solve the block tridiagonal system between the two clamps in place."""
    last = len(diagonal) - 2
    for i in range(1, last + 1):
        if i > 1:
            # upper[i - 1] transposed times the inverse of the block before it.
            for p in range(2):
                u, v = upper[i - 1, 0, p], upper[i - 1, 1, p]
                left = u * diagonal[i - 1, 0, 0] + v * diagonal[i - 1, 1, 0]
                below = u * diagonal[i - 1, 0, 1] + v * diagonal[i - 1, 1, 1]
                for q in range(2):
                    diagonal[i, p, q] -= left * upper[i - 1, 0, q] + below * upper[i - 1, 1, q]
                for c in range(COLUMNS):
                    right[i, p, c] -= left * right[i - 1, 0, c] + below * right[i - 1, 1, c]
        a, b, c2, d = diagonal[i, 0, 0], diagonal[i, 0, 1], diagonal[i, 1, 0], diagonal[i, 1, 1]
        determinant = a * d - b * c2
        diagonal[i, 0, 0], diagonal[i, 0, 1] = d / determinant, -b / determinant
        diagonal[i, 1, 0], diagonal[i, 1, 1] = -c2 / determinant, a / determinant
    for i in range(last, 0, -1):
        for c in range(COLUMNS):
            if i < last:
                right[i, 0, c] -= upper[i, 0, 0] * right[i + 1, 0, c] + upper[i, 0, 1] * right[i + 1, 1, c]
                right[i, 1, c] -= upper[i, 1, 0] * right[i + 1, 0, c] + upper[i, 1, 1] * right[i + 1, 1, c]
            x, y = right[i, 0, c], right[i, 1, c]
            right[i, 0, c] = diagonal[i, 0, 0] * x + diagonal[i, 0, 1] * y
            right[i, 1, c] = diagonal[i, 1, 0] * x + diagonal[i, 1, 1] * y


@compiled
def hold_end(base: Floats, end: Floats, gap: Floats, right: Floats, pull: Floats) -> None:
    """Replace the end's force by the end's place: what the force must do follows from where the end must be."""
    reach = np.zeros((3, COLUMNS))
    for i in range(len(base)):
        for p in range(2):
            for axis in range(3):
                for c in range(COLUMNS):
                    reach[axis, c] += end[i] * base[i, p, axis] * right[i, p, c]
    inverse = np.empty((3, 3))
    determinant = 0.0
    for p in range(3):
        for q in range(3):
            p1, p2, q1, q2 = (p + 1) % 3, (p + 2) % 3, (q + 1) % 3, (q + 2) % 3
            inverse[q, p] = reach[p1, 1 + q1] * reach[p2, 1 + q2] - reach[p1, 1 + q2] * reach[p2, 1 + q1]
        determinant += reach[p, 1] * inverse[0, p]
    for axis in range(3):
        reach[axis, 0] += gap[axis]
    for p in range(3):
        for c in range(COLUMNS):
            pull[p, c] = 0.0
        for q in range(3):
            share = inverse[p, q] / determinant
            for c in range(COLUMNS):
                pull[p, c] -= share * reach[q, c]
            pull[p, 1 + q] = share
    forced = np.empty(3)
    for i in range(1, len(base) - 1):
        for p in range(2):
            for axis in range(3):
                forced[axis] = right[i, p, 1 + axis]
                right[i, p, 1 + axis] = 0.0
            for axis in range(3):
                for c in range(COLUMNS):
                    right[i, p, c] += forced[axis] * pull[axis, c]
