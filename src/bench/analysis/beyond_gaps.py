"""Markers beyond a hidden one: the chain ends there, but from frame to frame each is where it was, almost."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Indices, Ints

__all__ = ["follow_beyond_gaps", "predict_position"]

REACH_SHARE = 0.3
"""Of the distance to the nearer neighbour along the cable: beyond half of it a marker could be taken for another."""


def follow_beyond_gaps(
    points_m: Floats32,
    offsets: Ints,
    usable: Bools,
    source: Indices,
    anchor_m: Floats | None,
    arc_length_m: Floats,
) -> Indices:
    """Give points to markers that a chain could not reach, by where they were in the frames around.

    A marker is expected where it was last seen, moved along with its neighbours since. It gets the nearest point that
    no other marker has, if that lies within 0.3 of the distance to its nearer neighbour along the cable. First forward
    in time, then backward, for those that are hidden at the beginning. What the chain found stays. Meant for a slow
    cycle: a marker must not go further than that in one frame relative to its neighbours.

    Parameters
    ----------
    points_m : (N, 3)
        Points of all frames, lab frame.
    offsets : (F + 1,)
        Where each frame's points begin; frames in order of time.
    usable : (N,)
        Points that may be the cable's.
    source : (F, k)
        Points that a chain gave to the markers, -1 where it gave none.
    anchor_m : (F, 3) or None
        Start of the cable, NaN where unknown; None for a cable without one.
    arc_length_m : (k,)
        Of the markers from the anchor.

    Returns
    -------
    (F, k)
        `source`, with fewer -1.
    """
    filled = source.copy()
    gaps_m = np.diff(arc_length_m, prepend=0.0 if anchor_m is not None else -np.inf, append=np.inf)
    reach_m = REACH_SHARE * np.minimum(gaps_m[:-1], gaps_m[1:])
    n_frames = len(offsets) - 1
    for frames in (range(n_frames), range(n_frames - 1, -1, -1)):
        follower = _Follower(reach_m, anchor_m is not None)
        for frame in frames:
            part = slice(offsets[frame], offsets[frame + 1])
            anchor = np.empty((0, 3)) if anchor_m is None else anchor_m[frame]
            follower.fill(points_m[part].astype(np.float64), usable[part].copy(), filled[frame], anchor)
    return filled


def predict_position(before_m: Floats, now_m: Floats, node: int) -> Floats:
    """Return where a node of the cable is, from where it was and how its neighbours moved since.

    Between two neighbours it moved as they did, the nearer one counting more. At the end of what is known it keeps its
    distance from the last one, turned as the chord before that has turned.

    Parameters
    ----------
    before_m : (n, 3)
        All nodes, in order along the cable, when this one was seen.
    now_m : (n, 3)
        The same now, NaN where not seen.
    node : int
        Which one.
    """
    known = np.flatnonzero(np.isfinite(before_m[:, 0]) & np.isfinite(now_m[:, 0]))
    left, right = known[known < node][::-1], known[known > node]
    if len(left) and len(right):
        beside = np.array([left[0], right[0]])
        moved = np.average(now_m[beside] - before_m[beside], axis=0, weights=1.0 / np.abs(beside - node))
        return np.asarray(before_m[node] + moved)
    beside = left if len(left) else right
    if not len(beside):
        return np.asarray(before_m[node])
    offset = before_m[node] - before_m[beside[0]]
    if len(beside) > 1:
        offset = _turn(offset, before_m[beside[0]] - before_m[beside[1]], now_m[beside[0]] - now_m[beside[1]])
    return np.asarray(now_m[beside[0]] + offset)


def _turn(vector: Floats, old: Floats, new: Floats) -> Floats:
    """Turn a vector (3,) by the smallest rotation that turns one direction into another (Rodrigues)."""
    old, new = old / np.linalg.norm(old), new / np.linalg.norm(new)
    axis, cosine = np.cross(old, new), float(old @ new)
    if cosine < 0:  # by more than a right angle no cable turns between two looks at it
        return vector
    across = np.cross(axis, vector)
    return np.asarray(vector + across + np.cross(axis, across) / (1.0 + cosine))


class _Follower:
    """Goes through frames in one direction and remembers where each marker was last."""

    def __init__(self, reach_m: Floats, has_anchor: bool) -> None:
        self._reach_m = reach_m
        self._first = int(has_anchor)
        n_nodes = len(reach_m) + self._first
        self._last_m = np.full((n_nodes, n_nodes, 3), np.nan)  # for each node all nodes, when it was last seen

    def fill(self, points_m: Floats, free: Bools, source: Indices, anchor_m: Floats) -> None:
        """Give points of one frame to the markers that have none in `source`; changes `source` and `free`."""
        now_m = np.full(self._last_m.shape[1:], np.nan)
        now_m[: self._first] = anchor_m
        found = np.flatnonzero(source >= 0)
        now_m[found + self._first] = points_m[source[found]]
        free[source[found]] = False
        for marker in map(int, np.flatnonzero(source < 0)):
            node = marker + self._first
            point = self._find(points_m, free, now_m, node, float(self._reach_m[marker]))
            if point >= 0:
                source[marker], free[point], now_m[node] = point, False, points_m[point]
        self._last_m[np.isfinite(now_m[:, 0])] = now_m

    def _find(self, points_m: Floats, free: Bools, now_m: Floats, node: int, reach_m: float) -> int:
        before_m = self._last_m[node]
        if np.isnan(before_m[node, 0]) or not free.any():
            return -1
        distance = np.linalg.norm(points_m - predict_position(before_m, now_m, node), axis=1)
        best = int(np.where(free, distance, np.inf).argmin())
        return best if distance[best] <= reach_m else -1
