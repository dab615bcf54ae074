"""What settled rods say about frames near them: one linear step from the shape to the frame, and its curvature."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats, Floats32, Ints
from bench.analysis.kernels.compiling import compiled
from bench.analysis.kernels.normal import backward, forward
from bench.analysis.kernels.rod import expect_clamps, pull_clamps, weigh_clamps
from bench.analysis.kernels.rod_balance import N_CLAMPS, N_LAW, STRAIGHT

__all__ = ["read_bends", "read_frames"]


@compiled
def read_bends(
    way: Floats, turned: Floats, apart: Floats, index: Ints, weight: Floats, bend: Floats, bend_slope: Floats
) -> None:
    """Fill in the curvature vectors (R, G, 3) at places, and how they change (R, G, 3, 13).

    They are weighed sums, by `weight` (G, 4), of those between the ways, at the nodes `index` (G, 4).
    """
    normal, change = np.empty(3), np.empty(3)
    node, node_slope = np.empty((len(apart), 3)), np.empty((len(apart), 3, N_CLAMPS + N_LAW))
    for r in range(len(way)):
        for j in range(len(apart)):
            cosine, sine = 0.0, 0.0
            for axis in range(3):
                p, q = (axis + 1) % 3, (axis + 2) % 3
                normal[axis] = way[r, j, p] * way[r, j + 1, q] - way[r, j, q] * way[r, j + 1, p]
                cosine += way[r, j, axis] * way[r, j + 1, axis]
                sine += normal[axis] ** 2
            sine = np.sqrt(sine)
            ratio, by_cosine = 1.0, -1.0 / 3.0
            if sine > STRAIGHT:
                turn = np.arctan2(sine, cosine)
                ratio, by_cosine = turn / sine, (turn * cosine - sine) / sine**3
            for axis in range(3):
                node[j, axis] = normal[axis] * ratio / apart[j]
            for c in range(N_CLAMPS + N_LAW):
                closer = 0.0
                for axis in range(3):
                    p, q = (axis + 1) % 3, (axis + 2) % 3
                    closer += turned[r, j, axis, c] * way[r, j + 1, axis] + way[r, j, axis] * turned[r, j + 1, axis, c]
                    change[axis] = turned[r, j, p, c] * way[r, j + 1, q] - turned[r, j, q, c] * way[r, j + 1, p]
                    change[axis] += way[r, j, p] * turned[r, j + 1, q, c] - way[r, j, q] * turned[r, j + 1, p, c]
                for axis in range(3):
                    node_slope[j, axis, c] = (change[axis] * ratio + normal[axis] * by_cosine * closer) / apart[j]
        for g in range(len(index)):
            for axis in range(3):
                bend[r, g, axis] = 0.0
                for c in range(N_CLAMPS + N_LAW):
                    bend_slope[r, g, axis, c] = 0.0
                for i in range(4):
                    j = index[g, i]
                    bend[r, g, axis] += weight[g, i] * node[j, axis]
                    for c in range(N_CLAMPS + N_LAW):
                        bend_slope[r, g, axis, c] += weight[g, i] * node_slope[j, axis, c]


@compiled
def learn_law(slope: Floats, off: Floats, noise_m: float, matrix: Floats, by_law: Floats) -> None:
    """Fill in what a change of the law does to the clamps' right side, behind the factor (3, 10)."""
    for c in range(N_LAW):
        for a in range(N_CLAMPS):
            by_law[c, a] = 0.0
            for m in range(len(off)):
                if not np.isnan(off[m, 0]):
                    for axis in range(3):
                        by_law[c, a] += slope[m, axis, a] * slope[m, axis, N_CLAMPS + c] / noise_m**2
        forward(matrix, by_law[c])


@compiled
def spread_along(along: Floats, matrix: Floats, by_law: Floats, law_spread: Floats) -> float:
    """Return the standard deviation of what changes by `along` (13,) with clamps and law; `along` is used up."""
    forward(matrix, along)
    variance = 0.0
    for a in range(N_CLAMPS):
        variance += along[a] ** 2
        for c in range(N_LAW):
            along[N_CLAMPS + c] -= along[a] * by_law[c, a]
    for c in range(N_LAW):
        told = 0.0
        for b in range(N_LAW):
            told += along[N_CLAMPS + b] * law_spread[b, c]
        variance += told**2
    return float(np.sqrt(variance))


@compiled
def read_frames(
    markers: Floats32,
    clamps: Floats,
    sigma: Floats,
    noise_m: float,
    shape: Ints,
    turned: Floats,
    place: Floats,
    near: Floats,
    slope: Floats,
    bend: Floats,
    bend_slope: Floats,
    law_spread: Floats,
    curvature: Floats,
    deviation: Floats,
    vector: Floats,
    off: Floats,
) -> None:
    """Step from each frame's settled shape to the frame, and fill in its curvature.

    `markers` and `clamps` are the frames' (F, ...), `shape` (F,) each one's row in the settled shapes; `sigma` (R, 4),
    `turned`, `place`, `near`, `slope` are those of `settle_rods`, `bend` and `bend_slope` (R, G, ...) those of
    `read_bends` at the wanted places. `law_spread` (3, 3): lower factor of the law's covariance. Filled in:
    `curvature`, `deviation` (F, G), `vector` (F, G, 3) or (0, G, 3) where it is not wanted, and `off` (F, k, 3):
    markers less rod. Frames that follow one of the same shape with the same markers seen are quick: they share its
    matrix and its deviation.
    """
    k = markers.shape[1]
    expected, step, matrix = np.empty(N_CLAMPS), np.empty(N_CLAMPS), np.empty((N_CLAMPS, N_CLAMPS))
    bent, along, by_law = np.empty(3), np.empty(N_CLAMPS + N_LAW), np.empty((N_LAW, N_CLAMPS))
    for f in range(len(markers)):
        r = shape[f]
        alike = f > 0 and r == shape[f - 1]
        for m in range(k):
            for axis in range(3):
                off[f, m, axis] = markers[f, m, axis] - near[r, m, axis]
            alike = alike and np.isnan(off[f, m, 0]) == np.isnan(off[f - 1, m, 0])
        expect_clamps(clamps[f], place[r], turned[r], expected)
        if not alike:
            weigh_clamps(slope[r], off[f], sigma[r], noise_m, matrix)
        pull_clamps(slope[r], off[f], expected, sigma[r], noise_m, step)
        forward(matrix, step)
        backward(matrix, step)
        for g in range(bend.shape[1]):
            square = 0.0
            for axis in range(3):
                bent[axis] = bend[r, g, axis]
                for a in range(N_CLAMPS):
                    bent[axis] += bend_slope[r, g, axis, a] * step[a]
                square += bent[axis] ** 2
                if len(vector) > 0:
                    vector[f, g, axis] = bent[axis]
            curvature[f, g] = np.sqrt(square)
        if alike:
            for g in range(bend.shape[1]):
                deviation[f, g] = deviation[f - 1, g]
        else:
            learn_law(slope[r], off[f], noise_m, matrix, by_law)
            for g in range(bend.shape[1]):
                length = np.sqrt(bend[r, g, 0] ** 2 + bend[r, g, 1] ** 2 + bend[r, g, 2] ** 2)
                for c in range(N_CLAMPS + N_LAW):
                    along[c] = 0.0
                    for axis in range(3):
                        along[c] += bend[r, g, axis] * bend_slope[r, g, axis, c] / max(length, 1e-12)
                deviation[f, g] = spread_along(along, matrix, by_law, law_spread)
        for m in range(k):
            for axis in range(3):
                for a in range(N_CLAMPS):
                    off[f, m, axis] -= slope[r, m, axis, a] * step[a]
