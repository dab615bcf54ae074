"""The cheapest chain of points in each frame: a second-order search over pairs of points, with its max-marginals.

A state is a pair: point j is marker m and the marker seen before it, m - g, is point i. The cost of the next pair
depends on both, by the angle in which the cable turns. Only pairs whose distance the cable allows are made, and only
while they can still belong to a chain that is within `CAP` of the best.
"""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Indices, Ints
from bench.analysis.chain_costs import MOST_GAP
from bench.analysis.kernels.compiling import compiled

__all__ = ["CAP", "search_chains"]

CAP = 8.0
"""Largest margin that is told apart, in nats: odds of one to 3000."""
MOST_POINTS = 200
"""Points within the cable's reach in one frame; with more, the frame is left unsorted."""
MOST_PAIRS = 20_000
"""Pairs kept of one frame; a search that needs more is in doubt everywhere."""
FAR = 1e9
NONE = -1
BEFORE, POINT, AT, STEP, NEXT, BACK = range(6)
"""Columns of a pair: its two points, the second one's marker, the step to it, the next pair with the same second point
as the same marker, and the pair before it in the cheapest chain that ends with it."""
FORWARD, BACKWARD, OWN, CLOSING = range(4)
"""Costs of a pair: of the cheapest chain up to it and from it on, of itself, of a chain that ends with it."""


@compiled
def bend_cost(x: float, sigma: float, scale: float, knee: float) -> float:
    """Return the nats that a distance shorter than the cable by x costs: normal about 0, exponential beyond a knee."""
    if x <= knee:
        return 0.5 * x * x / (sigma * sigma)
    return x / scale - 0.5 * sigma * sigma / (scale * scale)


@compiled
def turn_cost(way: Floats, first: int, middle: int, last: int, concentration: float) -> float:
    """Return the nats that the turn at `middle` costs."""
    cosine = (
        way[first, middle, 0] * way[middle, last, 0]
        + way[first, middle, 1] * way[middle, last, 1]
        + way[first, middle, 2] * way[middle, last, 2]
    )
    return float(concentration * (1.0 - cosine))


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
def follow_cheapest(n: int, distance: Floats, way: Floats, spans: Floats, turns: Floats, hidden: Floats) -> float:
    """Return the cost of the chain from the anchor (place n) that takes the cheapest step each time."""
    m, come, before, j, cost = 0, 0, NONE, n, 0.0
    while m < len(hidden) - 1:
        least, step, point = hidden[m], 0, NONE
        for g in range(1, min(MOST_GAP, len(hidden) - 1 - m) + 1):
            for c in range(n):
                apart = distance[j, c]
                if apart < spans[m + g, g, 4] or apart > spans[m + g, g, 5] or c in (j, before):
                    continue
                span = spans[m + g, g]
                taken = span[6] + turns[m, come, g, 1] + bend_cost(span[0] - apart, span[1], span[2], span[3])
                if come > 0:
                    taken += turn_cost(way, before, j, c, turns[m, come, g, 0])
                if taken < least:
                    least, step, point = taken, g, c
        cost += least
        if point == NONE:
            break
        before, j, m, come = j, point, m + step, step
    return cost


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
def closing_cost(apart: float, sigma_m: float, end: Floats) -> float:
    """Return the nats that the distance from the last marker to the cable's end costs."""
    sigma = np.sqrt(end[1] * end[1] + sigma_m * sigma_m)
    scale = end[2] if apart < end[0] else sigma
    return float(min(bend_cost(abs(end[0] - apart), sigma, scale, sigma * sigma / scale), end[4]))


@compiled
def uses_point(pairs: Ints, pair: int, point: int) -> bool:
    """Return whether the cheapest chain that ends with a pair goes through a point."""
    while pair != NONE:
        if pairs[pair, BEFORE] == point:
            return True
        pair = pairs[pair, BACK]
    return False


@compiled
def find_origin(
    pairs: Ints, costs: Floats, pair: int, point: int, gap: int, most: float, way: Floats, turns: Floats
) -> tuple[float, int]:
    """Return the cheapest chain that ends with one of a list of pairs, with the turn to a further point."""
    least, origin = most, NONE
    while pair != NONE:
        if costs[pair, FORWARD] < least:
            come = pairs[pair, STEP]
            cost = costs[pair, FORWARD] + turns[come, gap, 1]
            if come > 0:
                cost += turn_cost(way, pairs[pair, BEFORE], pairs[pair, POINT], point, turns[come, gap, 0])
            if cost < least and not uses_point(pairs, pair, point):
                least, origin = cost, pair
        pair = pairs[pair, NEXT]
    return least, origin


@compiled
def add_pair(n_pairs: int, before: int, point: int, at: int, step: int, origin: int, head: Ints, pairs: Ints) -> None:
    """Write down a pair, as the first of those with this point as this marker."""
    pair = pairs[n_pairs]
    pair[BEFORE], pair[POINT], pair[AT], pair[STEP] = before, point, at, step
    pair[NEXT], pair[BACK] = head[at, point], origin
    head[at, point] = n_pairs


@compiled
def start_pairs(
    n: int,
    anchored: bool,
    distance: Floats,
    spans: Floats,
    turns: Floats,
    hidden: Floats,
    head: Ints,
    pairs: Ints,
    costs: Floats,
) -> int:
    """Make the pairs from the anchor (place n) to each point in reach, or to any point if there is no anchor."""
    n_pairs = 0
    for g in range(1, min(MOST_GAP, len(hidden) - 1) + 1):
        span = spans[g, g]
        for c in range(n):
            cost = hidden[0] - hidden[g - 1]
            if anchored:
                if distance[n, c] < span[4] or distance[n, c] > span[5]:
                    continue
                cost = turns[0, 0, g, 1] + span[6] + bend_cost(span[0] - distance[n, c], span[1], span[2], span[3])
            add_pair(n_pairs, n, c, g, g if anchored else 0, NONE, head, pairs)
            costs[n_pairs, FORWARD] = costs[n_pairs, OWN] = cost
            n_pairs += 1
    return n_pairs


@compiled
def close_chains(
    first: int,
    last: int,
    end_m: int,
    end_sigma_m: float,
    distance: Floats,
    ends: Floats,
    hidden: Floats,
    pairs: Ints,
    costs: Floats,
) -> float:
    """Fill what a chain costs that ends with each of some pairs; return the least cost of a whole chain."""
    best = FAR
    for p in range(first, last):
        costs[p, CLOSING] = hidden[pairs[p, AT]]
        if end_sigma_m >= 0:
            costs[p, CLOSING] += closing_cost(distance[pairs[p, POINT], end_m], end_sigma_m, ends[pairs[p, AT]])
        best = min(best, costs[p, FORWARD] + costs[p, CLOSING])
    return best


@compiled
def make_pairs(
    n: int,
    n_pairs: int,
    bound: float,
    end_sigma_m: float,
    distance: Floats,
    way: Floats,
    spans: Floats,
    turns: Floats,
    ends: Floats,
    hidden: Floats,
    head: Ints,
    pairs: Ints,
    costs: Floats,
) -> int:
    """Continue chains by all pairs that can be within `CAP` of the best; return how many pairs there are.

    They are made in order of their first marker, so that all pairs into a marker are there when it is left. `bound` is
    the cost of some whole chain, and `CAP`.
    """
    k = len(hidden) - 1
    for m in range(1, k):
        for j in range(n):
            if head[m, j] == NONE:
                continue
            first = n_pairs
            for g in range(1, min(MOST_GAP, k - m) + 1):
                span = spans[m + g, g]
                for c in range(n):
                    apart = distance[j, c]
                    if apart < span[4] or apart > span[5] or c == j:
                        continue
                    cost = span[6] + bend_cost(span[0] - apart, span[1], span[2], span[3])
                    least, origin = find_origin(pairs, costs, head[m, j], c, g, bound - cost, way, turns[m])
                    if origin == NONE or n_pairs == MOST_PAIRS:
                        continue
                    add_pair(n_pairs, j, c, m + g, g, origin, head, pairs)
                    costs[n_pairs, FORWARD], costs[n_pairs, OWN] = least + cost, cost
                    n_pairs += 1
            whole = close_chains(first, n_pairs, n + 1, end_sigma_m, distance, ends, hidden, pairs, costs)
            bound = min(bound, whole + CAP)
    return n_pairs


@compiled
def weigh_states(
    n_pairs: int, best: float, way: Floats, turns: Floats, head: Ints, pairs: Ints, costs: Floats, through: Floats
) -> None:
    """Fill the cost (k + 1, n + 1) of the best chain in which a marker has each point, and in the last column none."""
    k, none = through.shape[0] - 1, through.shape[1] - 1
    for p in range(n_pairs - 1, -1, -1):
        whole = costs[p, FORWARD] + costs[p, BACKWARD]
        if whole > best + CAP:
            continue
        m, c, g = pairs[p, AT], pairs[p, POINT], pairs[p, STEP]
        first = m - g if g > 0 else 0
        through[m, c] = min(through[m, c], whole)
        for q in range(first + 1, m):
            through[q, none] = min(through[q, none], whole)
        for q in range(m + 1, k + 1):
            through[q, none] = min(through[q, none], costs[p, FORWARD] + costs[p, CLOSING])
        q = head[first, pairs[p, BEFORE]] if first > 0 else NONE
        while q != NONE:
            come, before = pairs[q, STEP], pairs[q, BEFORE]
            if before != c:
                cost = turns[first, come, g, 1] + costs[p, OWN] + costs[p, BACKWARD]
                if come > 0:
                    cost += turn_cost(way, before, pairs[p, BEFORE], c, turns[first, come, g, 0])
                costs[q, BACKWARD] = min(costs[q, BACKWARD], cost)
            q = pairs[q, NEXT]


@compiled
def read_chain(
    pairs: Ints, last: int, through: Floats, best: float, index: Ints, slot: Indices, margin: Floats32
) -> None:
    """Fill the points (k,) of the chain that ends with a pair, and how much worse each marker's next best state is."""
    while last != NONE:
        slot[pairs[last, AT] - 1] = pairs[last, POINT]
        last = pairs[last, BACK]
    for m in range(len(slot)):
        mine, other = slot[m] if slot[m] != NONE else through.shape[1] - 1, best + CAP
        for c in range(through.shape[1]):
            if c != mine:
                other = min(other, through[m + 1, c])
        margin[m] = other - best
        if slot[m] != NONE:
            slot[m] = index[slot[m]]


@compiled
def search_chains(
    points_m: Floats32,
    offsets: Ints,
    usable: Bools,
    anchor_m: Floats,
    is_free: Bools,
    end_m: Floats,
    end_sigma_m: Floats,
    spans: Floats,
    turns: Floats,
    ends: Floats,
    hidden: Floats,
    reach_m: float,
    slot: Indices,
    margin: Floats32,
) -> None:
    """Search each of F frames for the cheapest chain of the k markers.

    Parameters
    ----------
    points_m, offsets, usable : (N, 3), (F + 1,), (N,)
        The points of all frames.
    anchor_m, is_free : (F, 3), (F,)
        Where the chain starts; NaN leaves a frame unsorted, or where `is_free` lets it start at any point.
    end_m, end_sigma_m : (F, 3), (F,)
        Where the cable ends, NaN where unknown.
    spans, turns, ends, hidden, reach_m
        `ChainCosts`.
    slot, margin : (F, k)
        Filled: the point of each marker or -1, and by how many nats the best chain is better than the best in which
        this marker has another point or none; 0 where the frame has too many points to tell.
    """
    k, most = len(hidden) - 1, MOST_POINTS + 2
    place, index = np.zeros((most, 3)), np.empty(most, np.int64)
    distance, way, through = np.empty((most, most)), np.empty((most, most, 3)), np.empty((k + 1, most))
    head, pairs, costs = (
        np.empty((k + 1, most), np.int64),
        np.empty((MOST_PAIRS, 6), np.int64),
        np.empty((MOST_PAIRS, 4)),
    )
    for frame in range(len(offsets) - 1):
        slot[frame, :], margin[frame, :] = NONE, 0.0
        anchored = np.isfinite(anchor_m[frame]).all()
        if not (anchored or is_free[frame]):
            continue
        rows = offsets[frame], offsets[frame + 1]
        n = gather_points(points_m, usable, rows[0], rows[1], anchor_m[frame], reach_m, place, index)
        if n > MOST_POINTS:
            continue
        sigma_m = end_sigma_m[frame] if np.isfinite(end_m[frame]).all() else -1.0
        place[n], place[n + 1] = anchor_m[frame], end_m[frame]
        measure_pairs(place, n + 2, distance, way)
        head[:, :n] = NONE
        n_pairs = start_pairs(n, anchored, distance, spans, turns, hidden, head, pairs, costs)
        bound = CAP + min(hidden[0], close_chains(0, n_pairs, n + 1, sigma_m, distance, ends, hidden, pairs, costs))
        if anchored:
            bound = min(bound, follow_cheapest(n, distance, way, spans, turns, hidden) + ends[0, 4] + CAP)
        n_pairs = make_pairs(n, n_pairs, bound, sigma_m, distance, way, spans, turns, ends, hidden, head, pairs, costs)
        best, last = hidden[0], NONE
        for p in range(n_pairs):
            costs[p, BACKWARD] = costs[p, CLOSING]
            if costs[p, FORWARD] + costs[p, CLOSING] < best:
                best, last = costs[p, FORWARD] + costs[p, CLOSING], p
        through[:, : n + 1] = FAR
        through[:, n] = hidden[0]
        weigh_states(n_pairs, best, way, turns, head, pairs, costs, through[:, : n + 1])
        read_chain(pairs, last, through[:, : n + 1], best, index, slot[frame], margin[frame])
        if n_pairs == MOST_PAIRS:
            margin[frame, :] = 0.0
