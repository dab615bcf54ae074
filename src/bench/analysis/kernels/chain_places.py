"""One frame's points as the chain search needs them: those in reach, their distances, directions and neighbours."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints
from bench.analysis.kernels.compiling import compiled

__all__ = ["MOST_POINTS", "gather_points", "measure_pairs", "sort_neighbours"]

MOST_POINTS = 200
"""Points within the cable's reach in one frame; with more, the frame is left unsorted."""


@compiled
def gather_points(
    points_m: Floats32,
    usable: Bools,
    first: int,
    last: int,
    anchor_m: Floats,
    reach_m: float,
    place: Floats,
    index: Ints,
) -> int:
    """Fill in the places and rows of the points that may be the cable's; return how many there are."""
    n = 0
    for row in range(first, last):
        x, y, z = points_m[row, 0], points_m[row, 1], points_m[row, 2]
        if not (usable[row] and np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
            continue
        # against an unknown anchor, a NaN, nothing is too far
        if (x - anchor_m[0]) ** 2 + (y - anchor_m[1]) ** 2 + (z - anchor_m[2]) ** 2 > reach_m * reach_m:
            continue
        if n < MOST_POINTS:
            place[n, 0], place[n, 1], place[n, 2] = x, y, z
            index[n] = row - first
        n += 1
    return n


@compiled
def measure_pairs(place: Floats, n: int, distance: Floats, way: Floats) -> None:
    """Fill the distances (n, n) and unit vectors (n, n, 3) between n places."""
    for i in range(n):
        distance[i, i] = 0.0
        for j in range(i):
            x, y, z = place[j, 0] - place[i, 0], place[j, 1] - place[i, 1], place[j, 2] - place[i, 2]
            length = np.sqrt(x * x + y * y + z * z)
            distance[i, j] = distance[j, i] = length
            scale = 1.0 / max(length, 1e-9)
            way[i, j, 0], way[i, j, 1], way[i, j, 2] = x * scale, y * scale, z * scale
            way[j, i, 0], way[j, i, 1], way[j, i, 2] = -x * scale, -y * scale, -z * scale


@compiled
def sort_neighbours(n: int, distance: Floats, near: Ints, near_m: Floats) -> None:
    """List for each of n + 1 places the n points by distance, and these distances."""
    for j in range(n + 1):
        for c in range(n):
            apart, at = distance[j, c], c
            while at > 0 and near_m[j, at - 1] > apart:
                near_m[j, at], near[j, at] = near_m[j, at - 1], near[j, at - 1]
                at -= 1
            near_m[j, at], near[j, at] = apart, c
