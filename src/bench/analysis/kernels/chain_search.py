"""The cheapest chain of points in each frame: a second-order search over pairs of points, with its max-marginals.

A state is a pair: point j is marker m and the marker seen before it, m - g, is point i. The cost of the next pair
depends on both, by the angle in which the cable turns. Only steps whose distance the cable allows are listed; what the
rest of a chain costs at least, whatever its angles, follows from them, so that only those pairs are made which can
belong to a chain that is within `CAP` of the best.
"""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Indices, Ints
from bench.analysis.kernels.chain_places import MOST_POINTS, gather_points, measure_pairs, sort_neighbours
from bench.analysis.kernels.chain_tables import BINS, MOST_END_COST, MOST_GAP
from bench.analysis.kernels.compiling import compiled

__all__ = ["CAP", "search_chains"]

CAP = 8.0
"""Largest margin that is told apart, in nats: odds of one to 3000."""
MOST_PAIRS = 20_000
MOST_STEPS = 100_000
"""Pairs, and steps from a marker to a next one, kept of one frame; a frame that has more is in doubt everywhere."""
FAR = 1e9
NONE = -1
BEFORE, POINT, AT, STEP, NEXT, BACK = range(6)
"""Columns of a pair: its two points, the second one's marker, the step to it, the next pair with the same second point
as the same marker, and the pair before it in the cheapest chain that ends with it."""
FORWARD, BACKWARD, OWN = range(3)
"""Costs of a pair: of the cheapest chain up to it and from it on, and of itself."""


@compiled
def look_up(table: Floats, at: float) -> float:
    """Return a table's value between its points."""
    first = min(int(at), len(table) - 2)
    return float(table[first] + (at - first) * (table[first + 1] - table[first]))


@compiled
def turn_cost(way: Floats, first: int, middle: int, last: int, table: Floats) -> float:
    """Return the nats that the turn at `middle` costs."""
    cosine = (
        way[first, middle, 0] * way[middle, last, 0]
        + way[first, middle, 1] * way[middle, last, 1]
        + way[first, middle, 2] * way[middle, last, 2]
    )
    return look_up(table, np.sqrt(max(0.5 - 0.5 * cosine, 0.0)) * BINS)


@compiled
def close_chains(
    n: int, ends_known: bool, distance: Floats, ends: Floats, end_costs: Floats, hidden: Floats, closing: Floats
) -> None:
    """Fill what it costs (k + 1, n) that a point is the last marker seen: those hidden, the distance to the end."""
    for m in range(len(hidden)):
        closing[m, : n + 1] = hidden[m]
        if ends_known and m > 0:
            for j in range(n):
                apart = distance[j, n + 1]
                if apart < ends[m, 0] or apart > ends[m, 1]:
                    closing[m, j] += MOST_END_COST
                else:
                    closing[m, j] += look_up(end_costs[m], (apart - ends[m, 0]) * ends[m, 2])


@compiled
def list_steps(
    n: int,
    distance: Floats,
    near: Ints,
    near_m: Floats,
    spans: Floats,
    span_costs: Floats,
    reach_m: Floats,
    closing: Floats,
    steps: Ints,
    own: Floats,
    ahead: Floats,
    first: Ints,
) -> int:
    """List the steps from each point as each marker to a next one; return how many there are.

    The steps from point j as marker m are those of index ``first[m, j]`` to ``first[m, j + 1]``, each with its gap,
    its point and its cost; ``ahead[m, j]`` is the least cost of all that can follow.
    """
    count = 0
    for m in range(len(reach_m) - 1, -1, -1):
        start = n if m == 0 else 0
        for j in range(start, n + 1 if m == 0 else n):
            first[m, j], ahead[m, j] = count, FAR
            if distance[n, j] > reach_m[m]:
                continue
            least, at = closing[m, j], 0
            for g in range(1, min(MOST_GAP, len(reach_m) - 1 - m) + 1):
                to = m + g
                low, high, scale, turn = spans[to, g, 0], spans[to, g, 1], spans[to, g, 2], spans[to, g, 3]
                table = span_costs[to, g]
                while at > 0 and near_m[j, at - 1] >= low:
                    at -= 1
                while at < n and near_m[j, at] < low:
                    at += 1
                for place in range(at, n):
                    apart, c = near_m[j, place], near[j, place]
                    if not apart <= high or count == MOST_STEPS:  # from an unknown anchor it is NaN
                        break
                    if c == j or ahead[to, c] == FAR:
                        continue
                    cost = look_up(table, (apart - low) * scale)
                    least = min(least, cost + turn + ahead[to, c])
                    own[count], steps[count, 0], steps[count, 1] = cost, g, c
                    count += 1
            ahead[m, j] = least
        first[m, n if m > 0 else n + 1] = count
    return count


@compiled
def follow_cheapest(
    n: int, way: Floats, turns: Floats, closing: Floats, steps: Ints, own: Floats, ahead: Floats, first: Ints
) -> float:
    """Return the cost of the chain from the anchor (place n) that takes, each time, what seems the cheapest step."""
    m, come, before, j, cost = 0, 0, NONE, n, 0.0
    while True:
        least, taken, chosen = closing[m, j], 0.0, NONE
        for s in range(first[m, j], first[m, j + 1]):
            g, c = steps[s, 0], steps[s, 1]
            turn = turn_cost(way, before, j, c, turns[m, come, g]) if come > 0 else turns[m, 0, g, 0]
            step = own[s] + turn
            if step + ahead[m + g, c] < least and c != before:
                least, taken, chosen = step + ahead[m + g, c], step, s
        if chosen == NONE:
            return float(cost + closing[m, j])
        cost += taken
        before, j, come = j, steps[chosen, 1], steps[chosen, 0]
        m += come


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
            before, middle = pairs[pair, BEFORE], pairs[pair, POINT]
            turn = turn_cost(way, before, middle, point, turns[come, gap]) if come > 0 else turns[0, gap, 0]
            cost = costs[pair, FORWARD] + turn
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
def start_anywhere(n: int, hidden: Floats, head: Ints, pairs: Ints, costs: Floats) -> int:
    """Make each point a start of chains, as one of the first markers; return how many pairs there are."""
    n_pairs = 0
    for g in range(1, min(MOST_GAP, len(hidden) - 1) + 1):
        for c in range(n):
            add_pair(n_pairs, n, c, g, 0, NONE, head, pairs)
            costs[n_pairs, FORWARD] = costs[n_pairs, OWN] = hidden[0] - hidden[g - 1]
            n_pairs += 1
    return n_pairs


@compiled
def start_at_anchor(
    n: int, turns: Floats, steps: Ints, own: Floats, first: Ints, head: Ints, pairs: Ints, costs: Floats
) -> int:
    """Make the pairs from the anchor (place n) to each first marker; return how many there are."""
    n_pairs = 0
    for s in range(first[0, n], first[0, n + 1]):
        g = steps[s, 0]
        add_pair(n_pairs, n, steps[s, 1], g, g, NONE, head, pairs)
        costs[n_pairs, FORWARD] = costs[n_pairs, OWN] = own[s] + turns[0, 0, g, 0]
        n_pairs += 1
    return n_pairs


@compiled
def make_pairs(
    n: int,
    n_pairs: int,
    bound: float,
    way: Floats,
    turns: Floats,
    closing: Floats,
    steps: Ints,
    own: Floats,
    ahead: Floats,
    first: Ints,
    head: Ints,
    pairs: Ints,
    costs: Floats,
) -> int:
    """Continue chains by all pairs that can belong to one of a cost up to `bound`; return how many pairs there are.

    They are made in order of their first marker, so that all pairs into a marker are there when it is left.
    """
    for m in range(1, len(head) - 1):
        for j in range(n):
            if head[m, j] == NONE:
                continue
            for s in range(first[m, j], first[m, j + 1]):
                g, c = steps[s, 0], steps[s, 1]
                rest = own[s] + ahead[m + g, c]
                least, origin = find_origin(pairs, costs, head[m, j], c, g, bound - rest, way, turns[m])
                if origin == NONE or n_pairs == MOST_PAIRS:
                    continue
                add_pair(n_pairs, j, c, m + g, g, origin, head, pairs)
                costs[n_pairs, FORWARD], costs[n_pairs, OWN] = least + own[s], own[s]
                n_pairs += 1
                bound = min(bound, least + own[s] + closing[m + g, c] + CAP)
    return n_pairs


@compiled
def weigh_states(
    n_pairs: int,
    best: float,
    way: Floats,
    turns: Floats,
    closing: Floats,
    head: Ints,
    pairs: Ints,
    costs: Floats,
    through: Floats,
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
            through[q, none] = min(through[q, none], costs[p, FORWARD] + closing[m, c])
        q = head[first, pairs[p, BEFORE]] if first > 0 else NONE
        while q != NONE:
            come, before = pairs[q, STEP], pairs[q, BEFORE]
            if before != c:
                middle, table = pairs[p, BEFORE], turns[first, come, g]
                turn = turn_cost(way, before, middle, c, table) if come > 0 else table[0]
                cost = turn + costs[p, OWN] + costs[p, BACKWARD]
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
    spans: Floats,
    span_costs: Floats,
    turns: Floats,
    ends: Floats,
    end_costs: Floats,
    hidden: Floats,
    reach_m: Floats,
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
    end_m : (F, 3)
        Where the cable ends, NaN where unknown.
    spans, span_costs, turns, ends, end_costs, hidden, reach_m
        `ChainCosts`.
    slot, margin : (F, k)
        Filled: the point of each marker or -1, and by how many nats the best chain is better than the best in which
        this marker has another point or none; 0 where the frame has too many points to tell.
    """
    k, most = len(hidden) - 1, MOST_POINTS + 2
    place, index = np.zeros((most, 3)), np.empty(most, np.int64)
    distance, way, through = np.empty((most, most)), np.empty((most, most, 3)), np.empty((k + 1, most))
    near, near_m = np.empty((most, most), np.int64), np.empty((most, most))
    closing, ahead, first = np.empty((k + 1, most)), np.empty((k + 1, most)), np.empty((k + 1, most), np.int64)
    steps, own = np.empty((MOST_STEPS, 2), np.int64), np.empty(MOST_STEPS)
    head, pairs, costs = (
        np.empty((k + 1, most), np.int64),
        np.empty((MOST_PAIRS, 6), np.int64),
        np.empty((MOST_PAIRS, 3)),
    )
    for frame in range(len(offsets) - 1):
        slot[frame, :], margin[frame, :] = NONE, 0.0
        anchored = np.isfinite(anchor_m[frame]).all()
        if not (anchored or is_free[frame]):
            continue
        rows = offsets[frame], offsets[frame + 1]
        n = gather_points(points_m, usable, rows[0], rows[1], anchor_m[frame], reach_m[k], place, index)
        if n > MOST_POINTS:
            continue
        for c in range(3):
            place[n, c], place[n + 1, c] = anchor_m[frame, c], end_m[frame, c]
        measure_pairs(place, n + 2, distance, way)
        close_chains(n, np.isfinite(end_m[frame]).all(), distance, ends, end_costs, hidden, closing)
        sort_neighbours(n, distance, near, near_m)
        n_steps = list_steps(n, distance, near, near_m, spans, span_costs, reach_m, closing, steps, own, ahead, first)
        head[:, :n] = NONE
        bound = hidden[0] + CAP
        if anchored:
            n_pairs = start_at_anchor(n, turns, steps, own, first, head, pairs, costs)
            bound = min(bound, follow_cheapest(n, way, turns, closing, steps, own, ahead, first) + CAP)
        else:
            n_pairs = start_anywhere(n, hidden, head, pairs, costs)
        n_pairs = make_pairs(n, n_pairs, bound, way, turns, closing, steps, own, ahead, first, head, pairs, costs)
        best, last = hidden[0], NONE
        for p in range(n_pairs):
            costs[p, BACKWARD] = closing[pairs[p, AT], pairs[p, POINT]]
            if costs[p, FORWARD] + costs[p, BACKWARD] < best:
                best, last = costs[p, FORWARD] + costs[p, BACKWARD], p
        through[:, : n + 1] = FAR
        through[:, n] = hidden[0]
        weigh_states(n_pairs, best, way, turns, closing, head, pairs, costs, through[:, : n + 1])
        read_chain(pairs, last, through[:, : n + 1], best, index, slot[frame], margin[frame])
        if n_pairs == MOST_PAIRS or n_steps == MOST_STEPS:
            margin[frame, :] = 0.0
