"""A frame carried along the chain of markers without twist, and a curvature vector seen in it."""

from __future__ import annotations

import math

import numpy as np

from bench.analysis.arrays import Floats, Floats32
from bench.analysis.kernels.compiling import compiled

__all__ = ["carry_frames"]


@compiled
def _turn(x: Floats, axis: Floats, angle: float) -> None:
    """Turn a vector about a unit axis (Rodrigues)."""
    c, s = math.cos(angle), math.sin(angle)
    along = (axis[0] * x[0] + axis[1] * x[1] + axis[2] * x[2]) * (1.0 - c)
    a = c * x[0] + s * (axis[1] * x[2] - axis[2] * x[1]) + along * axis[0]
    b = c * x[1] + s * (axis[2] * x[0] - axis[0] * x[2]) + along * axis[1]
    d = c * x[2] + s * (axis[0] * x[1] - axis[1] * x[0]) + along * axis[2]
    x[0], x[1], x[2] = a, b, d


@compiled
def _find_turn(start: Floats, end: Floats, axis: Floats) -> float:
    """Write the unit axis of the shortest turn between two directions and return its angle; 0 where there is none."""
    axis[0] = start[1] * end[2] - start[2] * end[1]
    axis[1] = start[2] * end[0] - start[0] * end[2]
    axis[2] = start[0] * end[1] - start[1] * end[0]
    sine = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    angle = math.atan2(sine, start[0] * end[0] + start[1] * end[1] + start[2] * end[2])
    if sine == 0.0:
        return 0.0
    axis /= sine
    return angle


@compiled
def _list_directions(nodes_m: Floats32, s_m: Floats, tangent: Floats, direction: Floats, at_m: Floats) -> int:
    """Write the known directions of one frame and their arc lengths; return how many there are."""
    n, last = 0, -1
    if not math.isnan(tangent[0]):
        direction[0, 0], direction[0, 1], direction[0, 2] = tangent[0], tangent[1], tangent[2]
        at_m[0], n = 0.0, 1
    for i in range(len(s_m)):
        if math.isnan(nodes_m[i, 0]):
            continue
        if last >= 0:
            x = float(nodes_m[i, 0]) - nodes_m[last, 0]
            y = float(nodes_m[i, 1]) - nodes_m[last, 1]
            z = float(nodes_m[i, 2]) - nodes_m[last, 2]
            length = math.sqrt(x * x + y * y + z * z)
            if length > 0.0:
                direction[n, 0], direction[n, 1], direction[n, 2] = x / length, y / length, z / length
                at_m[n] = 0.5 * (s_m[i] + s_m[last])
                n += 1
        last = i
    return n


@compiled
def carry_frames(
    position_m: Floats32,
    marker_s_m: Floats,
    tangent: Floats,
    reference: Floats,
    across: Floats,
    vector: Floats32,
    places: Floats,
    components: Floats32,
) -> None:
    """Write the two components of the curvature vectors in a frame carried along each cable without twist.

    Parameters
    ----------
    position_m : (F, k, 3)
    marker_s_m : (k,)
    tangent : (F, 3)
        Direction of the cable at arc length 0, NaN where unknown.
    reference, across : (3,)
        A direction, and a unit vector across it: the frame of a cable that begins in that direction.
    vector : (F, G, 3)
        Curvature times the binormal.
    places : (G,)
        Ascending.
    components : (F, G, 2)
        Result, NaN where nothing is known.
    """
    most = len(marker_s_m) + 1
    direction, at_m = np.empty((most, 3)), np.empty(most)
    side, axis, here, now = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for f in range(len(position_m)):
        n = _list_directions(position_m[f], marker_s_m, tangent[f], direction, at_m)
        if n == 0:
            components[f] = np.float32(np.nan)
            continue
        side[0], side[1], side[2] = across[0], across[1], across[2]
        _turn(side, axis, _find_turn(reference, direction[0], axis))
        j, angle = 0, 0.0
        if n > 1:
            angle = _find_turn(direction[0], direction[1], axis)
        for g in range(len(places)):
            while j + 1 < n and places[g] >= at_m[j + 1]:
                _turn(side, axis, angle)
                j += 1
                angle = _find_turn(direction[j], direction[j + 1], axis) if j + 1 < n else 0.0
            for c in range(3):
                here[c], now[c] = direction[j, c], side[c]
            if j + 1 < n and places[g] > at_m[j]:
                share = angle * (places[g] - at_m[j]) / (at_m[j + 1] - at_m[j])
                _turn(here, axis, share)
                _turn(now, axis, share)
            x, y, z = vector[f, g, 0], vector[f, g, 1], vector[f, g, 2]
            components[f, g, 0] = (
                x * (here[1] * now[2] - here[2] * now[1])
                + y * (here[2] * now[0] - here[0] * now[2])
                + z * (here[0] * now[1] - here[1] * now[0])
            )
            components[f, g, 1] = -(x * now[0] + y * now[1] + z * now[2])
