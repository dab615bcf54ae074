"""Discrete curvature of a chain of nodes, and the curve's curvature as a fixed matrix times it, frame by frame."""

from __future__ import annotations

import math

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Ints
from bench.analysis.kernels.compiling import compiled

__all__ = ["apply_weights", "measure_bends"]


@compiled
def _bend_at_clamp(
    tangent: Floats32, clamp: Floats32, inner: Floats32, reach_m: float, share: float, way: float, bend_per_m: Floats
) -> None:
    """Write the curvature of the circle that leaves the clamp along its tangent and ends in the chord's direction.

    The angle between the two is the turn over the reach and half the chord's arc; where the reach is zero, the
    curvature is 2 (t x e) / |e|^2, whatever the arc lengths.
    """
    tx, ty, tz = float(tangent[0]), float(tangent[1]), float(tangent[2])
    ex, ey, ez = float(inner[0]) - clamp[0], float(inner[1]) - clamp[1], float(inner[2]) - clamp[2]
    cx, cy, cz = ty * ez - tz * ey, tz * ex - tx * ez, tx * ey - ty * ex
    across = math.sqrt(cx * cx + cy * cy + cz * cz)
    chord = math.sqrt(ex * ex + ey * ey + ez * ez)
    angle = math.atan2(across, tx * ex + ty * ey + tz * ez)
    half = share * angle
    half_arc = 0.5 * chord * (half / math.sin(half) if half > 0.0 else 1.0)
    turned = angle / across if across > 0.0 else (0.0 if angle == 0.0 else math.nan)
    scale = way * turned / (reach_m + half_arc) if chord > 0.0 else math.nan
    bend_per_m[0], bend_per_m[1], bend_per_m[2] = scale * cx, scale * cy, scale * cz


@compiled
def _bend_frame(
    nodes_m: Floats32, tangent: Floats32, seen: Ints, held: Bools, reach_m: Floats, share: Floats, bend_per_m: Floats
) -> None:
    row, last = 0, len(seen) - 1
    if held[0]:
        _bend_at_clamp(tangent[0], nodes_m[seen[0]], nodes_m[seen[1]], reach_m[0], share[0], 1.0, bend_per_m[0])
        row = 1
    for i in range(1, last):
        a, b, c = nodes_m[seen[i - 1]], nodes_m[seen[i]], nodes_m[seen[i + 1]]
        ux, uy, uz = float(b[0]) - a[0], float(b[1]) - a[1], float(b[2]) - a[2]
        vx, vy, vz = float(c[0]) - b[0], float(c[1]) - b[1], float(c[2]) - b[2]
        wx, wy, wz = ux + vx, uy + vy, uz + vz
        cx, cy, cz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        u2, v2, w2 = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
        longer2, size = max(u2, v2), u2 * v2 * w2
        if longer2 > min(u2, v2) + w2:  # folded back: a circle through the three would go round the long way
            size = longer2 * (cx * cx + cy * cy + cz * cz)
        scale = 2.0 / math.sqrt(size) if size > 0.0 else math.nan
        bend_per_m[row, 0], bend_per_m[row, 1], bend_per_m[row, 2] = scale * cx, scale * cy, scale * cz
        row += 1
    if held[1]:
        # Seen from this end the binormal points the other way.
        outer, inner = nodes_m[seen[last]], nodes_m[seen[last - 1]]
        _bend_at_clamp(tangent[1], outer, inner, reach_m[1], share[1], -1.0, bend_per_m[row])


@compiled
def measure_bends(
    nodes_m: Floats32,
    tangent: Floats32,
    frames: Ints,
    seen: Ints,
    held: Bools,
    reach_m: Floats,
    share: Floats,
    bend_per_m: Floats,
) -> None:
    """Write the bends of some frames: at the start, if it is held, at each inner node, and at the end, if it is held.

    Parameters
    ----------
    nodes_m : (F, n, 3)
    tangent : (F, 2, 3)
        Unit vectors from both clamps into the free cable.
    frames : (C,)
        Which frames: all have the same nodes and tangents.
    seen : (m,)
        Indices of their nodes, ascending, m >= 2.
    held : (2,)
        Which of their tangents are known.
    reach_m : (2,)
        Length of cable between each clamp and its nearest node.
    share : (2,)
        The part of the angle between tangent and chord that half the chord's arc turns.
    bend_per_m : (C, b, 3)
        Result: curvature times the binormal, NaN where two nodes are at one place.

    References
    ----------
    2 (u x v) / (|u| |v| |u + v|) of two neighbouring chords is the curvature of the circle through their three points
    (Menger), so any spacing of markers on a circle gives its curvature. Where the second chord goes back beside the
    first, so that the three are less than a half circle in another order, it is that of the smallest circle around
    them: wrongly sorted markers on a line must not read as a straight cable.
    """
    for i in range(len(frames)):
        _bend_frame(nodes_m[frames[i]], tangent[frames[i]], seen, held, reach_m, share, bend_per_m[i])


@compiled
def _sum_squares(offset_m2: Floats, bend: Floats) -> float:
    total = 0.0
    for node in range(offset_m2.shape[1]):
        for axis in range(3):
            apart = 0.0
            for b in range(len(bend)):
                apart += offset_m2[b, node] * bend[b, axis]
            total += apart * apart
    return total


@compiled
def apply_weights(
    nodes_m: Floats32,
    tangent: Floats32,
    frames: Ints,
    seen: Ints,
    held: Bools,
    reach_m: Floats,
    share: Floats,
    weight: Floats32,
    sigma_per_m: Floats32,
    offset_m2: Floats,
    curvature: Floats32,
    sigma: Floats32,
    residual_m: Floats32,
    vector: Floats32,
) -> None:
    """Write the curve of some frames: `weight` (b, G) times their bends, and its magnitude.

    Parameters
    ----------
    nodes_m, tangent, frames, seen, held, reach_m, share
        As of `measure_bends`.
    weight : (b, G)
    sigma_per_m : (G,)
        Standard deviation, the same in all these frames.
    offset_m2 : (b, m)
        Makes the nodes' distances from the curve of the bends.
    curvature, sigma : (F, G)
        Result.
    residual_m : (F,)
        Result: root mean square of these distances, for each of the two directions across the cable.
    vector : (F, G, 3)
        Result; left alone where it has no rows.
    """
    n_bends, n_places = weight.shape
    bend = np.empty((n_bends, 3))
    total = np.empty((3, n_places), dtype=np.float32)
    with_vector = len(vector) > 0
    for frame in frames:
        _bend_frame(nodes_m[frame], tangent[frame], seen, held, reach_m, share, bend)
        x, y, z = total[0], total[1], total[2]
        total[:] = np.float32(0.0)
        for b in range(n_bends):
            bx, by, bz = np.float32(bend[b, 0]), np.float32(bend[b, 1]), np.float32(bend[b, 2])
            row = weight[b]
            for g in range(n_places):
                x[g] += bx * row[g]
                y[g] += by * row[g]
                z[g] += bz * row[g]
        out, out_sigma = curvature[frame], sigma[frame]
        for g in range(n_places):
            out[g] = np.sqrt(x[g] * x[g] + y[g] * y[g] + z[g] * z[g])
            out_sigma[g] = sigma_per_m[g] if out[g] == out[g] else np.float32(np.nan)
        residual_m[frame] = math.sqrt(_sum_squares(offset_m2, bend) / (2 * len(seen)))
        if with_vector:
            for g in range(n_places):
                vector[frame, g, 0], vector[frame, g, 1], vector[frame, g, 2] = x[g], y[g], z[g]
