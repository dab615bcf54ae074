"""The loop that gives points to markers by where each of them was at the same place of the robot's path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Indices, Ints
from bench.analysis.kernels.compiling import compiled

__all__ = ["CycleMemory", "follow_phase"]

NEVER_S = -1e18
NOISE_SHARE = 0.5
"""Of the variance from one frame to the next: so much of a new difference from the template is not followed."""
FRESH_BINS = 3.0
"""A neighbour that was seen no longer ago than that tells how the cable strays now."""
PAIRS_PER_MARKER = 8
"""Most points in the gates of a frame, for each marker; more of them are no cable."""


class CycleMemory(NamedTuple):
    """What is known of a cycle: `PhaseTemplate`, its deviations as gates, in metres."""

    position_m: Floats
    """(B + 1, k, 3)"""
    gate_m: Floats
    """(k, n): after so many bins without a point; the last one is that of a marker that was never seen."""
    bin_s: float
    left: Ints
    right: Ints
    weight: Floats
    beside_gate_m: Floats
    """(k,)"""
    doubt: float
    """Of squared misfits: where two points differ by less, nothing is learnt from either."""


@compiled
def follow_phase(
    points: Floats32,
    offsets: Ints,
    usable: Bools,
    order: Ints,
    time_s: Floats,
    place: Floats,
    memory: CycleMemory,
    source: Indices,
    misfit: Floats32,
    rival: Floats32,
) -> None:
    """Give points to the k markers of some frames, in order of time.

    Each marker is expected where the template has it, moved by what it strayed from it when it was last seen. The gate
    about that place grows with the time since. A point must also lie where the neighbours' straying puts the marker, if
    both have just been seen: so a marker does not run away with a ghost that rides beside it. Of all points in gates,
    the nearest are given first, in units of the gate.

    Parameters
    ----------
    points, offsets, usable
        The point lists of all frames.
    order : (C,)
        Indices of the frames, in order of time.
    time_s, place : (C,)
        Of these frames: capture time, and phase in bins, 0…B.
    memory : CycleMemory
    source : (C, k) int16
        Written: the point of each marker, -1 where none lies in its gate.
    misfit : (C, k) float32
        Written: its distance from where it is expected, in gates.
    rival : (C, k) float32
        Written: that of the best other point nobody has, at most 1.
    """
    k = memory.position_m.shape[1]
    seen_s = np.full(k, NEVER_S)
    stray, planned, expected, beside = np.zeros((k, 3)), np.empty((k, 3)), np.empty((k, 3)), np.empty((k, 3))
    gate, is_known = np.empty(k), np.empty(k, np.bool_)
    pair_marker = np.empty(PAIRS_PER_MARKER * k, np.int64)
    pair_point, pair_misfit = np.empty_like(pair_marker), np.empty(len(pair_marker))
    for f in range(len(order)):
        _expect(memory, place[f], time_s[f], seen_s, stray, planned, expected, gate)
        _compare_neighbours(memory, time_s[f], seen_s, planned, expected, beside, is_known)
        low, high = offsets[order[f]], offsets[order[f] + 1]
        n_pairs = 0
        for j in range(k):
            beside_gate = memory.beside_gate_m[j] if is_known[j] else np.inf
            if gate[j] > beside_gate:
                gate[j], expected[j] = beside_gate, beside[j]
            for p in range(low, high):
                if not usable[p]:
                    continue
                far = _distance(points[p], expected[j])
                if far <= gate[j] and n_pairs < len(pair_marker) and _distance(points[p], beside[j]) <= beside_gate:
                    at = n_pairs
                    while at > 0 and pair_misfit[at - 1] > far / gate[j]:
                        pair_misfit[at], pair_marker[at] = pair_misfit[at - 1], pair_marker[at - 1]
                        pair_point[at] = pair_point[at - 1]
                        at -= 1
                    pair_misfit[at], pair_marker[at], pair_point[at] = far / gate[j], j, p - low
                    n_pairs += 1
        _give(
            pair_marker[:n_pairs],
            pair_point[:n_pairs],
            pair_misfit[:n_pairs],
            high - low,
            source[f],
            misfit[f],
            rival[f],
        )
        for j in range(k):
            if source[f, j] >= 0 and rival[f, j] ** 2 - misfit[f, j] ** 2 > memory.doubt:
                gain = 1.0 - NOISE_SHARE * min(1.0, memory.gate_m[j, 1] / gate[j]) ** 2
                for c in range(3):
                    innovation = points[low + source[f, j], c] - expected[j, c]
                    stray[j, c] = expected[j, c] - planned[j, c] + gain * innovation
                seen_s[j] = time_s[f]
            elif is_known[j] and not _distance(expected[j], beside[j]) <= memory.beside_gate_m[j]:
                seen_s[j] = NEVER_S


@compiled
def _expect(
    memory: CycleMemory,
    place: float,
    now_s: float,
    seen_s: Floats,
    stray: Floats,
    planned: Floats,
    expected: Floats,
    gate: Floats,
) -> None:
    """Write where each marker is by the template, where it is expected, and how far from there it may be."""
    below = min(int(place), len(memory.position_m) - 2)
    share, longest = place - below, memory.gate_m.shape[1] - 1
    for j in range(len(seen_s)):
        widest = memory.gate_m[j, longest]
        lag = (now_s - seen_s[j]) / memory.bin_s
        gate[j] = widest
        if lag < longest:
            i = int(lag)
            gate[j] = memory.gate_m[j, i] + (lag - i) * (memory.gate_m[j, i + 1] - memory.gate_m[j, i])
        kept = max(0.0, 1.0 - 0.5 * (gate[j] / widest) ** 2)  # how alike straying then and now are, by their difference
        for c in range(3):
            planned[j, c] = (1.0 - share) * memory.position_m[below, j, c] + share * memory.position_m[below + 1, j, c]
            expected[j, c] = planned[j, c] + kept * stray[j, c]


@compiled
def _compare_neighbours(
    memory: CycleMemory,
    now_s: float,
    seen_s: Floats,
    planned: Floats,
    expected: Floats,
    beside: Floats,
    is_known: Bools,
) -> None:
    """Write where each marker is if it strays as its neighbours do, and whether both have just been seen."""
    oldest_s = now_s - FRESH_BINS * memory.bin_s
    for j in range(len(seen_s)):
        left, right = memory.left[j], memory.right[j]
        is_known[j] = (left < 0 or seen_s[left] >= oldest_s) and seen_s[right] >= oldest_s
        for c in range(3):
            beside[j, c] = planned[j, c] + memory.weight[j, 1] * (expected[right, c] - planned[right, c])
            if left >= 0:
                beside[j, c] += memory.weight[j, 0] * (expected[left, c] - planned[left, c])


@compiled
def _give(
    pair_marker: Ints,
    pair_point: Ints,
    pair_misfit: Floats,
    n_points: int,
    source: Indices,
    misfit: Floats32,
    rival: Floats32,
) -> None:
    """Give the points of one frame, the best pair first; then look for points that are left and fit as well."""
    source[:], misfit[:], rival[:] = -1, 1.0, 1.0
    taken = np.zeros(n_points, np.bool_)
    for pair in range(len(pair_marker)):
        j, p = pair_marker[pair], pair_point[pair]
        if source[j] < 0 and not taken[p]:
            source[j], misfit[j], taken[p] = p, pair_misfit[pair], True
    for pair in range(len(pair_marker)):
        j, p = pair_marker[pair], pair_point[pair]
        if not taken[p] and pair_misfit[pair] < rival[j]:
            rival[j] = pair_misfit[pair]


@compiled
def _distance(a: Floats | Floats32, b: Floats) -> float:
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
