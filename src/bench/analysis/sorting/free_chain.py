"""A cable without an anchor: the chain is found by its spacings alone."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Bools, Floats, Floats32, Indices
from bench.analysis.sorting.gates import SpacingGates
from bench.analysis.sorting.greedy import Chains, follow_chain

__all__ = ["FREE_CHAIN_CHUNK", "follow_from_every_point", "is_symmetric", "orient_alike"]

FREE_CHAIN_CHUNK = 200
"""Frames at once when every point is tried as the first marker: rows are frames times points."""


def follow_from_every_point(position: Floats, free: Bools, gates: SpacingGates) -> Chains:
    """Try every free point as marker 0 and keep each frame's best chain."""
    n_frames, n_points = free.shape
    first = np.tile(np.arange(n_points), n_frames)
    frame = np.repeat(np.arange(n_frames), n_points)
    others = free[frame]
    started = others[np.arange(len(first)), first]
    others[np.arange(len(first)), first] = False
    start = np.where(started[:, None], position[frame, first], np.nan)
    tried = follow_chain(position[frame], others, start, gates, first_marker=1)
    tried.slot[:, 0] = np.where(started, first, -1)
    length = np.where(started, tried.n_found + 1, 0).reshape(free.shape)
    error = (tried.spacing_error / np.maximum(tried.n_found, 1)).reshape(free.shape)
    longest = length == length.max(axis=1, keepdims=True)
    best = np.where(longest, error, np.inf).argmin(axis=1) + np.arange(n_frames) * n_points
    return Chains(tried.slot[best], length.ravel()[best], tried.ambiguous[best], tried.spacing_error[best])


def is_symmetric(gates: SpacingGates) -> bool:
    """Return whether a cable fits the gates from both ends, so that they do not tell which end is first."""
    nominal, low, high = gates.nominal_m[1:], gates.low_m[1:], gates.high_m[1:]
    return bool(np.all((nominal[::-1] >= low) & (nominal[::-1] <= high)))


def orient_alike(source: Indices, position_m: Floats32) -> Indices:
    """Give all complete frames (F, k) the direction of the first one, by the way their ends move; blank the others."""
    oriented = np.full_like(source, -1)
    complete = np.flatnonzero((source >= 0).all(axis=1))
    if len(complete) == 0:
        return oriented
    first, last = position_m[complete, 0].astype(np.float64), position_m[complete, -1].astype(np.float64)
    kept = np.linalg.norm(first[1:] - first[:-1], axis=1) + np.linalg.norm(last[1:] - last[:-1], axis=1)
    crossed = np.linalg.norm(first[1:] - last[:-1], axis=1) + np.linalg.norm(last[1:] - first[:-1], axis=1)
    turned = np.concatenate([[0], np.cumsum(crossed < kept)]) % 2 == 1
    oriented[complete] = np.where(turned[:, None], source[complete, ::-1], source[complete])
    return oriented
