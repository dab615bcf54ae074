"""The search for the most probable chain of each frame, and what it expects of a cable, learnt from some frames."""

from __future__ import annotations

import numpy as np

from bench.analysis.arrays import Floats, Floats32, Indices
from bench.analysis.chain_costs import ChainPrior, make_costs
from bench.analysis.gates import SortSettings
from bench.analysis.markers import PointFrames, gather_positions

__all__ = ["DOUBT_NATS", "FEWEST_FREE_MARKERS", "is_alike_from_both_ends", "known_places", "learn_prior", "search"]

DOUBT_NATS = 3.0
"""A marker whose next best explanation is less than 20 times as improbable is ambiguous."""
FEWEST_BENDS = 20
"""Fewer tell less than the guess."""
SPREAD = 1.6
"""The bends of one marker are no normal number: the cable rests in one pose and passes through another."""
LEAST_CURVATURE = 0.25
"""Of the guess: where the cable hung straight in the sample, it may bend in another frame."""
MOST_MISSES = 0.3
FEWEST_FREE_MARKERS = 3
"""Two markers without an anchor are two points at a distance."""


def search(
    frames: PointFrames, settings: SortSettings, prior: ChainPrior, *, starts_anywhere: bool = False
) -> tuple[Indices, Floats32]:
    """Return the most probable chain of each frame (F, k), and by how many nats each marker is sure (F, k)."""
    from bench.analysis.kernels.chain_search import search_chains

    costs, n_frames = make_costs(settings, prior), len(frames)
    source = np.full((n_frames, settings.n_markers), -1, dtype=np.int16)
    margin = np.zeros(source.shape, dtype=np.float32)
    anchor, end = known_places(frames.anchor_m, n_frames), known_places(frames.end_m, n_frames)
    if not np.isfinite(settings.length_m):
        end = np.full((n_frames, 3), np.nan)
    sigma = np.zeros(n_frames) if frames.end_sigma_m is None else frames.end_sigma_m
    tells_ends = starts_anywhere or not is_alike_from_both_ends(settings)
    is_free = (np.isfinite(end[:, 0]) | tells_ends) & (settings.n_markers >= FEWEST_FREE_MARKERS)
    search_chains(
        frames.points_m,
        frames.offsets,
        frames.usable,
        anchor,
        is_free,
        end,
        np.nan_to_num(np.asarray(sigma, dtype=np.float64)),
        costs.spans,
        costs.turns,
        costs.ends,
        costs.hidden,
        costs.reach_m,
        source,
        margin,
    )
    return source, margin


def learn_prior(frames: PointFrames, settings: SortSettings) -> ChainPrior:
    """Return the bends and the share of hidden markers that some frames show when sorted by the guess."""
    guess = ChainPrior.guess(settings)
    source, margin = search(frames, settings, guess)
    position = np.array(gather_positions(frames.points_m, frames.offsets, source), dtype=np.float64)
    position[margin < DOUBT_NATS] = np.nan
    curvature = _usual_curvature(position, frames.anchor_m, settings)
    started = (source >= 0).any(axis=1)
    if not started.any():
        return guess
    guessed = guess.curvature_per_m[0]
    usual = np.where(np.isfinite(curvature), np.maximum(SPREAD * curvature, LEAST_CURVATURE * guessed), guessed)
    return ChainPrior(tuple(usual.tolist()), float(np.clip((source[started] < 0).mean(), guess.miss, MOST_MISSES)))


def _usual_curvature(position_m: Floats, anchor_m: Floats | None, settings: SortSettings) -> Floats:
    """Return the curvature (k + 1,) of one direction, root mean square, NaN where too few frames show it."""
    start = known_places(anchor_m, len(position_m))
    nodes = np.concatenate([start[:, None], position_m], axis=1)
    step = np.diff(nodes, axis=1)
    way = step / np.maximum(np.linalg.norm(step, axis=2, keepdims=True), 1e-9)
    turn = 1.0 - (way[:, 1:] * way[:, :-1]).sum(axis=2)
    seen = np.isfinite(turn)
    enough = seen.sum(axis=0) >= FEWEST_BENDS
    mean = np.where(seen, turn, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    span = np.diff(settings.arc_length_m, prepend=0.0)
    curvature = np.sqrt(mean) / np.maximum((span[1:] + span[:-1]) / 2, 1e-3)
    return np.concatenate([[np.nan], np.where(enough, curvature, np.nan), [np.nan]])


def is_alike_from_both_ends(settings: SortSettings) -> bool:
    """Return whether the spacings are the same from both ends, as far as they are known."""
    spacing = np.diff(settings.arc_length_m)
    return bool((np.abs(spacing - spacing[::-1]) <= max(settings.tolerance_m, 4 * settings.noise_m)).all())


def known_places(place_m: Floats | None, n_frames: int) -> Floats:
    if place_m is None:
        return np.full((n_frames, 3), np.nan)
    return np.ascontiguousarray(place_m, dtype=np.float64)
