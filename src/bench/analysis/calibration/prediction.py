"""Where a hidden marker is: where it was when last seen, moved as its neighbours along the cable moved since."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats

__all__ = ["predict_position"]


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
