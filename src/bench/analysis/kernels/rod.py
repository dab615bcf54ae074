"""The heavy rod fitted to markers and clamps: from a first guess to the shape in balance that suits them best."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Bools, Floats
from bench.analysis.kernels.compiling import compiled
from bench.analysis.kernels.normal import backward, factor, forward
from bench.analysis.kernels.rod_balance import (
    COLUMNS,
    N_CLAMPS,
    N_LAW,
    bend_rod,
    carry_bases,
    hold_end,
    load_rod,
    solve_chain,
)

__all__ = ["expect_clamps", "pull_clamps", "settle_rods", "weigh_clamps"]

LARGEST_STEP_RAD = 0.3
"""A longer step is shortened to this, so that the rod cannot jump to another shape."""
SMALL_STEP_RAD = 3e-5
"""The linear step that follows a settled shape makes up for what is left: its square."""
CREEP_RAD = 1e-3
"""Steps still so small at the end creep along what neither markers nor clamps tell, within its standard deviation."""
MOST_STEPS = 25
DOUBTFUL = 3.0
"""A shape that misses the markers by so many times their noise may be another one than the cable's: a second start."""


@compiled
def weigh_clamps(slope: Floats, off: Floats, sigma: Floats, noise_m: float, matrix: Floats) -> None:
    """Fill in the factor of the normal matrix (10, 10) of the clamps.

    `slope` (k, 3, 13), `off` (k, 3) NaN where unseen: the markers less the rod; `sigma` (4,) of start's place, end's
    place, start's direction, end's direction.
    """
    for a in range(N_CLAMPS):
        for b in range(a + 1):
            matrix[a, b] = 0.0
        matrix[a, a] = 1.0 / sigma[a // 3 if a < 6 else a // 2 - 1] ** 2
    for m in range(len(off)):
        for axis in range(3):
            if np.isnan(off[m, axis]):
                continue
            for a in range(N_CLAMPS):
                for b in range(a + 1):
                    matrix[a, b] += slope[m, axis, a] * slope[m, axis, b] / noise_m**2
    factor(matrix)


@compiled
def pull_clamps(slope: Floats, off: Floats, expected: Floats, sigma: Floats, noise_m: float, step: Floats) -> None:
    """Fill in the right side (10,) that goes with it: `expected` (10,) are the clamps less the rod's."""
    for a in range(N_CLAMPS):
        step[a] = expected[a] / sigma[a // 3 if a < 6 else a // 2 - 1] ** 2
    for m in range(len(off)):
        for axis in range(3):
            if not np.isnan(off[m, axis]):
                for a in range(N_CLAMPS):
                    step[a] += slope[m, axis, a] * off[m, axis] / noise_m**2


@compiled
def guess_rod(
    markers: Floats,
    clamps: Floats,
    marker_at: Floats,
    at: Floats,
    weight: Floats,
    end: Floats,
    way: Floats,
    force: Floats,
    place: Floats,
) -> None:
    """Fill in the ways, from the clamps and the chords between markers, and the force that suits them best."""
    last, k = len(way) - 1, len(markers)
    for axis in range(3):
        place[axis], place[3 + axis] = 0.0, clamps[axis]
        way[0, axis], way[last, axis] = clamps[3 + axis], clamps[6 + axis]
    knot_at, knot = np.empty(k + 3), np.empty((k + 3, 3))
    knot_at[0], n_knots, before = at[0], 1, at[0]
    point = np.zeros(3)
    for axis in range(3):
        knot[0, axis] = way[0, axis]
    for m in range(k + 1):
        here = at[last] if m == k else marker_at[m]
        if here - before < 1e-6 or (m < k and np.isnan(markers[m, 0])):
            continue
        for axis in range(3):
            seen = clamps[axis] if m == k else markers[m, axis]
            knot[n_knots, axis] = seen - point[axis]
            point[axis] = seen
        knot_at[n_knots] = 0.5 * (before + here)
        n_knots += 1
        before = here
    knot_at[n_knots] = at[last]
    for axis in range(3):
        knot[n_knots, axis] = way[last, axis]
    for j in range(n_knots + 1):
        length = np.sqrt(knot[j, 0] ** 2 + knot[j, 1] ** 2 + knot[j, 2] ** 2)
        for axis in range(3):
            knot[j, axis] /= max(length, 1e-9)
    j = 0
    balance, loaded = np.zeros((3, 3)), np.zeros(3)
    for i in range(1, last):
        while j < n_knots - 1 and at[i] > knot_at[j + 1]:
            j += 1
        share = (at[i] - knot_at[j]) / (knot_at[j + 1] - knot_at[j])
        length = 0.0
        for axis in range(3):
            way[i, axis] = (1.0 - share) * knot[j, axis] + share * knot[j + 1, axis]
            length += way[i, axis] ** 2
        for axis in range(3):
            way[i, axis] /= max(np.sqrt(length), 1e-9)
        for p in range(3):
            for q in range(3):
                across = (1.0 if p == q else 0.0) - way[i, p] * way[i, q]
                balance[p, q] += end[i] ** 2 * across
                loaded[p] += end[i] * across * weight[i, q]
    for p in range(3):
        balance[p, p] += 1e-9
    factor(balance)
    for p in range(3):
        force[p] = loaded[p]
    forward(balance, force)
    backward(balance, force)


@compiled
def balance_rod(
    way: Floats,
    force: Floats,
    place: Floats,
    law: Floats,
    apart: Floats,
    end: Floats,
    weight: Floats,
    base: Floats,
    diagonal: Floats,
    upper: Floats,
    right: Floats,
    pull: Floats,
) -> None:
    """Fill in `right` (N + 2, 2, 11) with how each way turns: to its balance, with the end's place, clamps and law."""
    n = len(way)
    carry_bases(way, base)
    diagonal[:], upper[:], right[:] = 0.0, 0.0, 0.0
    bend_rod(way, base, law, apart, diagonal, upper, right)
    load_rod(way, base, force, weight, end, diagonal, right)
    for p in range(2):
        for q in range(2):
            right[1, p, 4 + q] = -upper[0, q, p]
            right[n - 2, p, 6 + q] = -upper[n - 2, p, q]
    solve_chain(diagonal, upper, right)
    right[0], right[n - 1] = 0.0, 0.0
    for p in range(2):
        right[0, p, 4 + p], right[n - 1, p, 6 + p] = 1.0, 1.0
    gap = np.empty(3)
    for axis in range(3):
        gap[axis] = place[axis] - place[3 + axis]
        for i in range(n):
            gap[axis] += end[i] * way[i, axis]
    hold_end(base, end, gap, right, pull)


@compiled
def see_markers(
    way: Floats,
    place: Floats,
    base: Floats,
    right: Floats,
    reach: Floats,
    near: Floats,
    slope: Floats,
    turned: Floats,
    shift: Floats,
) -> None:
    """Fill in where the rod is at the markers, by how much the balance shifts it, and how that changes."""
    column, k = np.empty(COLUMNS), len(near)
    slope[:], shift[:] = 0.0, 0.0
    for m in range(k):
        for axis in range(3):
            near[m, axis], slope[m, axis, axis] = place[axis], 1.0
    for i in range(len(way)):
        for axis in range(3):
            for c in range(COLUMNS):
                column[c] = base[i, 0, axis] * right[i, 0, c] + base[i, 1, axis] * right[i, 1, c]
            for c in range(3):
                turned[i, axis, c], turned[i, axis, 3 + c] = -column[1 + c], column[1 + c]
            for c in range(4, COLUMNS):
                turned[i, axis, 2 + c] = column[c]
            for m in range(k):
                near[m, axis] += reach[m, i] * way[i, axis]
                shift[m, axis] += reach[m, i] * column[0]
                for c in range(N_CLAMPS + N_LAW):
                    slope[m, axis, c] += reach[m, i] * turned[i, axis, c]


@compiled
def expect_clamps(clamps: Floats, place: Floats, turned: Floats, expected: Floats) -> None:
    """Fill in the clamps as their holders say (9,) less the rod's (10,)."""
    last = len(turned) - 1
    for axis in range(3):
        expected[axis], expected[3 + axis] = -place[axis], clamps[axis] - place[3 + axis]
    for p in range(2):
        expected[6 + p], expected[8 + p] = 0.0, 0.0
        for axis in range(3):
            expected[6 + p] += turned[0, axis, 6 + p] * clamps[3 + axis]
            expected[8 + p] += turned[last, axis, 8 + p] * clamps[6 + axis]


@compiled
def move_rod(
    step: Floats, base: Floats, right: Floats, pull: Floats, way: Floats, force: Floats, place: Floats
) -> float:
    """Turn the rod by the clamps' step and towards its balance, unless it is there; return the largest turn."""
    moved, turn, largest = np.zeros(COLUMNS), np.zeros((len(way), 2)), 0.0
    moved[0] = 1.0
    for axis in range(3):
        moved[1 + axis] = step[3 + axis] - step[axis]
    for c in range(4):
        moved[4 + c] = step[6 + c]
    for i in range(len(way)):
        for p in range(2):
            for c in range(COLUMNS):
                turn[i, p] += right[i, p, c] * moved[c]
            largest = max(largest, abs(turn[i, p]))
    if not np.isfinite(largest) or largest < SMALL_STEP_RAD:
        return largest
    scale = min(1.0, LARGEST_STEP_RAD / largest)
    for i in range(len(way)):
        length = 0.0
        for axis in range(3):
            way[i, axis] += scale * (base[i, 0, axis] * turn[i, 0] + base[i, 1, axis] * turn[i, 1])
            length += way[i, axis] ** 2
        for axis in range(3):
            way[i, axis] /= np.sqrt(length)
    for axis in range(3):
        for c in range(COLUMNS):
            force[axis] += scale * pull[axis, c] * moved[c]
        place[axis] += scale * step[axis]
        place[3 + axis] += scale * step[3 + axis]
    return largest


@compiled
def copy_shape(
    way: Floats, force: Floats, place: Floats, new_way: Floats, new_force: Floats, new_place: Floats
) -> None:
    """Copy a shape."""
    for axis in range(3):
        new_force[axis], new_place[axis], new_place[3 + axis] = force[axis], place[axis], place[3 + axis]
        for i in range(len(way)):
            new_way[i, axis] = way[i, axis]


@compiled
def settle_rods(
    markers: Floats,
    clamps: Floats,
    sigma: Floats,
    noise_m: float,
    law: Floats,
    marker_at: Floats,
    at: Floats,
    apart: Floats,
    reach: Floats,
    end: Floats,
    weight: Floats,
    started: Bools,
    way: Floats,
    force: Floats,
    place: Floats,
    near: Floats,
    slope: Floats,
    turned: Floats,
) -> Bools:
    """Find the rod in balance that suits the markers and the clamps of each shape best; tell where one was found.

    Parameters
    ----------
    markers : (R, k, 3)
        Seen from the start of the rod as its holder places it; NaN where not seen.
    clamps : (R, 9)
        Place of the end, direction at the start, direction at the end (along the rod), as the holders say.
    sigma : (R, 4)
        Standard deviations: place of start and end, direction at start and end.
    law : (3,)
        Moment over weight per metre: ``law[0] k + law[1] tanh(k / law[2])``.
    marker_at, at : (k,), (N + 2,)
        Arc lengths of the markers and of the ways.
    apart : (N + 1,)
        Length over which the rod turns from one way to the next.
    reach, end, weight : (k, N + 2), (N + 2,), (N + 2, 3)
        Markers and end from the ways; what gravity does to each.
    started : (R,)
        Whether `way`, `force` and `place` hold a shape to start from.
    way, force, place : (R, N + 2, 3), (R, 3), (R, 6)
        The shape; force on the end over weight per metre; places of start and end.
    near : (R, k, 3)
        The rod at the markers.
    slope, turned : (R, k, 3, 13), (R, N + 2, 3, 13)
        By how much they, and the ways, change with the clamps and the law.
    """
    n_shapes, k, n = len(markers), markers.shape[1], len(at)
    found, cost = np.zeros(n_shapes, dtype=np.bool_), np.empty(2)
    kept_way, kept_force, kept_place = np.empty((n, 3)), np.empty(3), np.empty(6)
    base, right, pull = np.empty((n, 2, 3)), np.empty((n, 2, COLUMNS)), np.empty((3, COLUMNS))
    diagonal, upper = np.empty((n, 2, 2)), np.empty((n - 1, 2, 2))
    off, expected, step = np.empty((k, 3)), np.empty(N_CLAMPS), np.empty(N_CLAMPS)
    matrix = np.empty((N_CLAMPS, N_CLAMPS))
    for r in range(n_shapes):
        known = started[r] or (r > 0 and found[r - 1])
        if known and not started[r]:
            copy_shape(way[r - 1], force[r - 1], place[r - 1], way[r], force[r], place[r])
        for attempt in range(0 if known else 1, 3):
            # First from a neighbour, then from the markers, then again from the better of the two.
            if attempt == 1:
                guess_rod(markers[r], clamps[r], marker_at, at, weight, end, way[r], force[r], place[r])
            elif attempt == 2:
                if not known or cost[1] <= cost[0]:
                    break
                copy_shape(kept_way, kept_force, kept_place, way[r], force[r], place[r])
            found[r] = False
            for _ in range(MOST_STEPS):
                balance_rod(way[r], force[r], place[r], law, apart, end, weight, base, diagonal, upper, right, pull)
                see_markers(way[r], place[r], base, right, reach, near[r], slope[r], turned[r], off)
                missed = 0.0
                for m in range(k):
                    for axis in range(3):
                        off[m, axis] = markers[r, m, axis] - near[r, m, axis] - off[m, axis]
                        if not np.isnan(off[m, axis]):
                            missed += off[m, axis] ** 2
                expect_clamps(clamps[r], place[r], turned[r], expected)
                weigh_clamps(slope[r], off, sigma[r], noise_m, matrix)
                pull_clamps(slope[r], off, expected, sigma[r], noise_m, step)
                forward(matrix, step)
                backward(matrix, step)
                largest = move_rod(step, base, right, pull, way[r], force[r], place[r])
                found[r] = largest < CREEP_RAD
                if largest < SMALL_STEP_RAD or not np.isfinite(largest):
                    break
            if attempt < 2:
                cost[attempt] = missed if found[r] else np.inf
            if attempt == 0:
                if cost[0] <= 3 * k * (DOUBTFUL * noise_m) ** 2:
                    break
                copy_shape(way[r], force[r], place[r], kept_way, kept_force, kept_place)
    return found
