"""The loop that gives points to markers by where each of them was at the same place of the robot's path."""

from __future__ import annotations

import math
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
    pairs = np.empty((PAIRS_PER_MARKER * k, 3))
    for f in range(len(order)):
        _expect(memory, place[f], time_s[f], seen_s, stray, planned, expected, gate)
        _compare_neighbours(memory, time_s[f], seen_s, planned, expected, beside, is_known)
        low, high = offsets[order[f]], offsets[order[f] + 1]
        n_pairs = _list_pairs(
            points[low:high], usable[low:high], memory.beside_gate_m, expected, gate, beside, is_known, pairs
        )
        _give(pairs, n_pairs, high - low, source[f], misfit[f], rival[f])
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
def _list_pairs(
    points: Floats32,
    usable: Bools,
    beside_gate: Floats,
    expected: Floats,
    gate: Floats,
    beside: Floats,
    is_known: Bools,
    pairs: Floats,
) -> int:
    """Write the pairs of a marker and a point in its gates, the best first, and return their number.

    A marker that was hidden longer than its neighbours is expected where they put it: that is nearer by then.
    """
    n_pairs = 0
    for j in range(len(gate)):
        widest = beside_gate[j] if is_known[j] else np.inf
        if gate[j] > widest:
            gate[j] = widest
            expected[j, 0], expected[j, 1], expected[j, 2] = beside[j, 0], beside[j, 1], beside[j, 2]
        for p in range(len(points)):
            if usable[p] and n_pairs < len(pairs):
                far = _distance(points[p], expected[j])
                if far <= gate[j] and _distance(points[p], beside[j]) <= widest:
                    _insert(pairs, n_pairs, far / gate[j], j, p)
                    n_pairs += 1
    return n_pairs


@compiled
def _insert(pairs: Floats, n_pairs: int, misfit: float, marker: int, point: int) -> None:
    at = n_pairs
    while at > 0 and pairs[at - 1, 0] > misfit:
        pairs[at, 0], pairs[at, 1], pairs[at, 2] = pairs[at - 1, 0], pairs[at - 1, 1], pairs[at - 1, 2]
        at -= 1
    pairs[at, 0], pairs[at, 1], pairs[at, 2] = misfit, marker, point


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
def _give(pairs: Floats, n_pairs: int, n_points: int, source: Indices, misfit: Floats32, rival: Floats32) -> None:
    """Give the points of one frame, the best pair first; then look for points that are left and fit as well."""
    source[:] = -1
    misfit[:] = 1.0
    rival[:] = 1.0
    taken = np.zeros(n_points, np.bool_)
    for pair in range(n_pairs):
        j, p = int(pairs[pair, 1]), int(pairs[pair, 2])
        if source[j] < 0 and not taken[p]:
            source[j], misfit[j], taken[p] = p, pairs[pair, 0], True
    for pair in range(n_pairs):
        j, p = int(pairs[pair, 1]), int(pairs[pair, 2])
        if not taken[p] and pairs[pair, 0] < rival[j]:
            rival[j] = pairs[pair, 0]


@compiled
def _distance(a: Floats | Floats32, b: Floats) -> float:
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
